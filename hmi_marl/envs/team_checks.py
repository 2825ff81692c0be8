"""Checks of arrays that say which teams, and with which seeds."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray


def check_mask(which: NDArray[np.bool_] | None, count: int) -> NDArray[np.bool_]:
    """Return the marks of teams, bool, shape (count,): all by default; or raise ValueError."""
    mask = np.ones(count, np.bool_) if which is None else np.asarray(which)
    if mask.shape != (count,) or mask.dtype != np.bool_:
        raise ValueError(
            f"which= marks teams by bools of shape ({count},), but got {mask.dtype} of shape "
            f"{mask.shape}"
        )
    return np.require(mask, np.bool_, ("C", "W"))


def check_team_numbers(teams: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """Return numbers of teams as int64, or raise if one is none or stands there twice."""
    which = np.require(teams, np.int64, ("C", "W"))
    if which.ndim != 1 or len(np.unique(which)) != len(which):
        raise ValueError(f"teams= are different numbers in one row, not {teams!r}")
    if len(which) and not 0 <= which.min() <= which.max() < count:
        raise ValueError(f"teams= are numbers from 0 to {count - 1}, not {teams!r}")
    return which


def check_seeds(seeds: ArrayLike, fresh: NDArray[np.bool_]) -> NDArray[np.uint64]:
    """Return seeds of N teams as uint64, or raise; those that are not ``fresh`` are not read."""
    given = np.asarray(seeds)
    if given.shape != fresh.shape:
        raise ValueError(f"seeds have shape {fresh.shape}, not {given.shape}")
    if not np.issubdtype(given.dtype, np.integer):
        raise TypeError(f"seeds are integers, best an array of uint64, but got {given.dtype}")
    if (given[fresh] < 0).any():
        raise ValueError(f"a seed lies in [0, 2^64), but got {given[fresh].min()}")
    return given.astype(np.uint64)
