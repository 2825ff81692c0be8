"""Checks of arrays that say which teams, and with which seeds, and of those that loops take."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hmi_marl.envs.drivers import TRAIT_NAMES
from hmi_marl.envs.series import Series
from hmi_marl.envs.team_step import SUMS

_INT64, _UINT64, _FLOAT64 = map(np.dtype, (np.int64, np.uint64, np.float64))


def check_mask(which: NDArray[np.bool_] | None, count: int) -> NDArray[np.bool_]:
    """Return the marks of teams, bool, shape (count,): all by default; or raise ValueError."""
    mask = np.ones(count, np.bool_) if which is None else np.asarray(which)
    if mask.shape != (count,) or mask.dtype != np.bool_:
        raise ValueError(
            f"which= marks teams by bools of shape ({count},), but got {mask.dtype} of shape "
            f"{mask.shape}"
        )
    return np.require(mask, np.bool_, ("C", "A", "W"))


def check_team_numbers(teams: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """Return numbers of teams as int64, or raise if one is none or stands there twice."""
    which = np.require(teams, np.int64, ("C", "A", "W"))
    if which.ndim != 1 or len(np.unique(which)) != len(which):
        raise ValueError(f"teams= are different numbers in one row, not {teams!r}")
    if len(which) and not 0 <= which.min() <= which.max() < count:
        raise ValueError(f"teams= are numbers from 0 to {count - 1}, not {teams!r}")
    return which


def check_actions(agent: str, actions: ArrayLike, count: int) -> NDArray[np.int64]:
    """Return actions as int64 that loops take as they are, shape (count,).

    Raises:
        ValueError, TypeError: they have another shape or type.
    """
    given = np.asarray(actions)
    if given.dtype == np.int64 and given.shape == (count,) and given.flags.carray:
        return given
    if given.shape != (count,):
        raise ValueError(f"{agent} actions have shape ({count},), but got {given.shape}")
    if given.dtype.kind not in "iu":
        raise TypeError(f"{agent} actions are integers, but got {given.dtype}")
    return np.require(given, np.int64, ("C", "A", "W"))


def check_array(
    name: str, array: NDArray[Any], dtype: np.dtype[Any], shape: tuple[int, ...]
) -> NDArray[Any]:
    """Return an array that compiled loops take as it is, or raise ValueError if they cannot.

    They look at nothing but its address.
    """
    is_array = isinstance(array, np.ndarray)
    if not is_array or array.dtype != dtype or array.shape != shape or not array.flags.carray:
        found = f"{array.dtype} of shape {array.shape}" if is_array else type(array).__name__
        raise ValueError(
            f"{name} is a writable array of {dtype} and shape {shape}, row by row in memory, but "
            f"got {found}"
        )
    return array


def check_columns(columns: Sequence[int]) -> NDArray[np.int64]:
    """Return columns of a step's table, or raise ValueError if it has no such column."""
    if min(columns, default=0) < 0 or max(columns, default=0) >= SUMS:
        raise ValueError(f"columns of rewards lie in [0, {SUMS - 1}], but got {tuple(columns)}")
    return np.array(columns, np.int64)


def check_series(series: Series, count: int) -> None:
    """Check the arrays of a :class:`Series`, to go with N teams.

    Raises:
        ValueError: it is of another number of teams, or one has been replaced by another type.
    """
    check_array("series.episodes", series.episodes, _INT64, (count,))
    check_array("series.seeds", series.seeds, _UINT64, (count, Series.AHEAD))
    check_array("series.traits", series.traits, _FLOAT64, (count, Series.AHEAD, len(TRAIT_NAMES)))


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
