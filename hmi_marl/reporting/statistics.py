"""Means and shares with their 95 % intervals."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

CONFIDENCE = 0.95


@dataclass(frozen=True)
class Estimate:
    """A number and its 95 % interval. NaN where the data do not tell."""

    mean: float
    low: float
    high: float

    def agrees(self, other: float, share: float) -> bool:
        """Whether ``other`` lies in the interval, or the mean within this share of ``other``."""
        return self.low <= other <= self.high or abs(self.mean - other) <= share * abs(other)

    def as_json(self) -> dict[str, float | None]:
        """With None for what is not known, as JSON has no NaN."""
        return {name: value if math.isfinite(value) else None for name, value in vars(self).items()}


def mean(values: ArrayLike, lowest: float = -math.inf) -> Estimate:
    """The mean and Student's t interval of independent values, shape (E,).

    Values that are not finite are left out (an episode in which nobody was ever ahead has no
    shortest headway). One value alone has no interval; none at all has no mean.

    Args:
        values: shape (E,).
        lowest: no value can be lower; the interval ends there if Student's t goes beyond.
    """
    finite = np.asarray(values, np.float64)
    finite = finite[np.isfinite(finite)]
    if len(finite) == 0:
        return Estimate(math.nan, math.nan, math.nan)
    middle = float(finite.mean())
    if len(finite) == 1:
        return Estimate(middle, math.nan, math.nan)
    from scipy import stats  # takes half a second, which settings that hold an Estimate need not

    error = float(finite.std(ddof=1)) / math.sqrt(len(finite))
    half = float(stats.t.ppf((1 + CONFIDENCE) / 2, len(finite) - 1)) * error
    return Estimate(middle, max(middle - half, lowest), middle + half)


def share(successes: int, trials: int) -> Estimate:
    """A share of yes-or-no trials and its Wilson interval, which is honest near 0 and 1.

    Raises:
        ValueError: no trials, or more successes than trials.
    """
    if not 0 <= successes <= trials or trials == 0:
        raise ValueError(f"{successes} successes in {trials} trials make no share")
    from scipy import stats

    interval = stats.binomtest(successes, trials).proportion_ci(CONFIDENCE, method="wilson")
    return Estimate(successes / trials, float(interval.low), float(interval.high))


def accuracy(right: NDArray[np.bool_], trials: int) -> Estimate:
    """The share of right guesses, its interval that of so many trials, rounded outwards.

    Args:
        right: of each guess, whether it was right, shape (P,).
        trials: as many of them as are independent, at most P.
    """
    hits, count = int(right.sum()), len(right)
    low = share(hits * trials // count, trials).low
    high = share(-(-hits * trials // count), trials).high
    return Estimate(hits / count, low, high)
