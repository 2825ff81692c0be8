"""Means and shares with their 95 % intervals, and how they are written."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

CONFIDENCE = 0.95


@dataclass(frozen=True)
class Estimate:
    """Number and its 95 % interval. NaN where it is not known."""

    mean: float
    low: float
    high: float

    def agrees(self, other: float, share: float) -> bool:
        """Check that ``other`` is in the interval, or the mean within this share of ``other``."""
        return self.low <= other <= self.high or abs(self.mean - other) <= share * abs(other)

    def as_json(self) -> dict[str, float | None]:
        """JSON content, with None for what is not known."""
        return {name: value if math.isfinite(value) else None for name, value in vars(self).items()}

    def shown(self, form: str = "z.1f") -> str:
        """Write as ``mean [low, high]``, as far as they are known, each in this format."""
        if not math.isfinite(self.low):
            return number(self.mean, form)
        return f"{self.mean:{form}} [{self.low:{form}}, {self.high:{form}}]"

    def percent(self, form: str = "z.1f") -> str:
        """Write a share and its interval in percent, without the sign."""
        return Estimate(100 * self.mean, 100 * self.low, 100 * self.high).shown(form)


def number(value: float | None, form: str = "z.1f") -> str:
    """Write a number, or a dash where it is not known."""
    return "-" if value is None or not math.isfinite(value) else format(value, form)


def mean(values: ArrayLike, lowest: float = -math.inf) -> Estimate:
    """Mean and Student's t interval, cut off at ``lowest``, of independent values, shape (E,).

    Values that are not finite are left out (an episode without a vehicle ahead has no shortest
    headway). One value has no interval; no value has no mean.
    """
    finite = np.asarray(values, np.float64)
    finite = finite[np.isfinite(finite)]
    if len(finite) == 0:
        return Estimate(math.nan, math.nan, math.nan)
    middle = float(finite.mean())
    if len(finite) == 1:
        return Estimate(middle, math.nan, math.nan)
    from scipy import stats  # takes half a second; settings that hold an Estimate do without

    error = float(finite.std(ddof=1)) / math.sqrt(len(finite))
    half = float(stats.t.ppf((1 + CONFIDENCE) / 2, len(finite) - 1)) * error
    return Estimate(middle, max(middle - half, lowest), middle + half)


def ratio(
    amounts: ArrayLike, counts: ArrayLike, lowest: float = -math.inf, highest: float = math.inf
) -> Estimate:
    """Sum of amounts over sum of counts, with Student's t interval over E independent episodes.

    The interval is that of the linearised ratio R: the deviations of an episode are a - R n. So it
    stays valid where the steps of an episode depend on each other.

    Args:
        amounts, counts: of each episode, shape (E,); episodes with neither change nothing.
        lowest, highest: ends at which the interval is cut off.

    Returns:
        NaN unless the counts have a sum above 0; without interval if only one episode counts.
    """
    amount, count = np.asarray(amounts, np.float64), np.asarray(counts, np.float64)
    holds = (amount != 0) | (count != 0)
    amount, count = amount[holds], count[holds]
    if not count.sum() > 0:
        return Estimate(math.nan, math.nan, math.nan)
    middle = float(amount.sum() / count.sum())
    around = mean((amount - middle * count) / count.mean())  # of mean 0 but for rounding
    half = around.high - around.mean
    return Estimate(middle, max(middle - half, lowest), min(middle + half, highest))


def average(estimates: Sequence[Estimate]) -> Estimate:
    """Average of independent estimates, whose half intervals add up as their squares.

    NaN without estimates.
    """
    if not estimates:
        return Estimate(math.nan, math.nan, math.nan)
    middle = float(np.mean([each.mean for each in estimates]))
    half = math.hypot(*(each.high - each.mean for each in estimates)) / len(estimates)
    return Estimate(middle, middle - half, middle + half)


def share(successes: int, trials: int) -> Estimate:
    """Share of successes and its Wilson interval, which stays valid near 0 and 1.

    Raises:
        ValueError: no trials, or more successes than trials.
    """
    if not 0 <= successes <= trials or trials == 0:
        raise ValueError(f"{successes} successes in {trials} trials make no share")
    from scipy import stats

    interval = stats.binomtest(successes, trials).proportion_ci(CONFIDENCE, method="wilson")
    return Estimate(successes / trials, float(interval.low), float(interval.high))


def accuracy(right: NDArray[np.bool_], trials: int) -> Estimate:
    """Share of right guesses (P,), with the interval of fewer trials, rounded outwards.

    ``trials`` is the number of guesses that are independent, at most P.
    """
    hits, count = int(right.sum()), len(right)
    low = share(hits * trials // count, trials).low
    high = share(-(-hits * trials // count), trials).high
    return Estimate(hits / count, low, high)
