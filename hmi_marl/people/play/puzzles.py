"""The second task: find a number among others. Each one found is worth points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

NUMBERS = 16
"""Numbers of a search, in a square."""
LOWEST, HIGHEST = 10, 99
POINTS = 25
"""Points of a number found; a step of a trip without distraction is worth about 15."""


@dataclass(frozen=True)
class Puzzle:
    """One number search."""

    index: int
    """Counted from 0 within a trip."""
    numbers: tuple[int, ...]
    """Different numbers of two digits."""
    target: int
    """The one to find."""


def puzzle(seed: int, index: int) -> Puzzle:
    """Return the number search of a trip.

    Args:
        seed: of the trip.
        index: counted from 0.
    """
    rng = np.random.default_rng([seed, index])
    numbers = rng.permutation(np.arange(LOWEST, HIGHEST + 1))[:NUMBERS].tolist()
    return Puzzle(index, tuple(numbers), numbers[int(rng.integers(NUMBERS))])
