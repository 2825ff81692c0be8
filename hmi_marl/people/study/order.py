"""Counterbalanced order of clips.

A rater sees blocks, in each of which every driver and control comes once. The orders within blocks
are rows of a Williams design: with k conditions, over k raters (2 k if k is odd) every condition
comes equally often in every place and directly after every other one. Clips go round, so that over
the raters every clip is shown equally often, and no rater sees one twice.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from hmi_marl.checks import Whole
from hmi_marl.envs.streams import check_seed

_NUMBER = Whole(0, 10**9)
_DESIGN, _PLACES = 1, 2
"""Streams of random numbers."""


def williams(conditions: int) -> NDArray[np.int64]:
    """Return a Williams design.

    Args:
        conditions: k, 1 or more.

    Returns:
        Orders of the conditions 0 to k - 1, shape (k, k), or (2 k, k) if k is odd and above 1.
    """
    steps = np.arange(conditions)
    # 0, 1, k-1, 2, k-2, ...: all differences between neighbours differ
    first = np.where(steps % 2 == 1, (steps + 1) // 2, (conditions - steps // 2) % conditions)
    square = (first + steps[:, None]) % conditions
    if conditions % 2 and conditions > 1:
        return np.concatenate([square, square[:, ::-1]])
    return square


@lru_cache(maxsize=256)
def _shuffled(count: int, *seed: int) -> tuple[int, ...]:
    """Return the numbers below a count in an order drawn from a seed."""
    return tuple(np.random.default_rng(seed).permutation(count).tolist())


@dataclass(frozen=True)
class Place:
    """One of a rater's clips, or the attention check."""

    condition: int
    """Number of the condition; -1 for the attention check."""
    clip: int
    """Number of the clip among the condition's."""


CHECK = Place(-1, 0)


def order(number: int, conditions: int, clips: int, shown: int, seed: int = 0) -> list[Place]:
    """Return what a rater sees, with the attention check in the second half.

    Args:
        number: of the rater, counted from 0.
        conditions: k, number of drivers and controls.
        clips: of each condition.
        shown: clips of each condition that the rater sees, at most ``clips``.
        seed: of the study; draws which condition is which of the design.

    Raises:
        ValueError, TypeError: a number or a seed out of range.
    """
    design = williams(conditions)
    cycle, row = divmod(_NUMBER("number", number), len(design))
    names = _shuffled(conditions, check_seed(seed), _DESIGN)
    apart = clips // shown  # so that a rater's blocks have different clips
    found = []
    for block in range(shown):
        # the next rows in further blocks; clips move on when all rows have had a turn
        for place in design[(row + block) % len(design)].tolist():
            start = _shuffled(clips, seed, _DESIGN, names[place])
            found.append(Place(names[place], start[(cycle + row + block * apart) % clips]))
    rng = np.random.default_rng([seed, _PLACES, number])
    least = len(found) // 2
    found.insert(int(rng.integers(least, max(least + 1, len(found)))), CHECK)
    return found
