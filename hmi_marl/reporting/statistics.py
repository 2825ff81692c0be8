"""Means and shares with their 95 % intervals, and how they are written.

An estimate also keeps its standard error and the number of independent units that it is over, so
that a verdict can ask for an interval of another confidence (:mod:`hmi_marl.reporting.verdicts`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

CONFIDENCE = 0.95
_ONE_DEVIATION = math.erf(math.sqrt(0.5))
"""Confidence of an interval of one standard deviation to either side."""
_LARGEST = 700.0
"""Largest exponent; larger ones overflow."""


@dataclass(frozen=True)
class Estimate:
    """Number and its 95 % interval. NaN where it is not known."""

    mean: float
    low: float
    high: float
    error: float = field(default=math.nan, compare=False)
    """Standard error; NaN where it is not known, and of a share, whose interval is Wilson's."""
    count: int = field(default=0, compare=False)
    """Independent units (episodes, training seeds) that it is over; 0 where that is not known."""
    luck: float = field(default=0.0, compare=False)
    """Part of the standard error that all training seeds share: the luck of their episodes."""
    luck_count: int = field(default=0, compare=False)
    """Units that ``luck`` is over."""

    @classmethod
    def from_json(cls, content: Mapping[str, Any]) -> Estimate:
        """Read what :meth:`as_json` wrote."""
        known = {name: math.nan if value is None else value for name, value in content.items()}
        ends = known["mean"], known["low"], known["high"]
        error, count = known.get("error", math.nan), int(known.get("count", 0))
        return cls(*ends, error, count, known.get("luck", 0.0), int(known.get("luck_count", 0)))

    def __neg__(self) -> Estimate:
        """Turn a difference around."""
        return replace(self, mean=-self.mean, low=-self.high, high=-self.low)

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


UNKNOWN = Estimate(math.nan, math.nan, math.nan)


def number(value: float | None, form: str = "z.1f") -> str:
    """Write a number, or a dash where it is not known."""
    return "-" if value is None or not math.isfinite(value) else format(value, form)


def cut(low: float, high: float, lowest: float = 0.0, highest: float = 1.0) -> tuple[float, float]:
    """Cut an interval off at ends that its quantity cannot pass; by default those of a share."""
    return max(low, lowest), min(high, highest)


def mean(values: ArrayLike, lowest: float = -math.inf, highest: float = math.inf) -> Estimate:
    """Mean and Student's t interval, cut off at these ends, of independent values, shape (E,).

    Values that are not finite are left out (an episode without a vehicle ahead has no shortest
    headway). One value has no interval; no value has no mean.
    """
    finite = np.asarray(values, np.float64)
    finite = finite[np.isfinite(finite)]
    if len(finite) == 0:
        return UNKNOWN
    middle = float(finite.mean())
    if len(finite) == 1:
        return Estimate(middle, math.nan, math.nan, count=1)
    error = float(finite.std(ddof=1)) / math.sqrt(len(finite))
    ends = cut(*t_interval(middle, error, len(finite)), lowest, highest)
    return Estimate(middle, *ends, error, len(finite))


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
        return UNKNOWN
    middle = float(amount.sum() / count.sum())
    around = mean((amount - middle * count) / count.mean())  # of mean 0 but for rounding
    half = around.high - around.mean
    ends = cut(middle - half, middle + half, lowest, highest)
    return Estimate(middle, *ends, around.error, around.count)


def average(estimates: Sequence[Estimate]) -> Estimate:
    """Average of independent estimates, whose half intervals add up as their squares.

    NaN without estimates.
    """
    if not estimates:
        return UNKNOWN
    middle = float(np.mean([each.mean for each in estimates]))
    half = math.hypot(*(each.high - each.mean for each in estimates)) / len(estimates)
    error = math.hypot(*(each.error for each in estimates)) / len(estimates)
    count = min(each.count for each in estimates)
    return Estimate(middle, middle - half, middle + half, error, count)


def share(successes: int, trials: int) -> Estimate:
    """Share of successes and its Wilson interval, which stays valid near 0 and 1.

    Raises:
        ValueError: no trials, or more successes than trials.
    """
    if not 0 <= successes <= trials or trials == 0:
        raise ValueError(f"{successes} successes in {trials} trials make no share")
    found = successes / trials
    return Estimate(found, *wilson_interval(found, trials), count=trials)


def accuracy(right: NDArray[np.bool_], trials: int) -> Estimate:
    """Share of right guesses (P,), with the interval of fewer trials, rounded outwards.

    ``trials`` is the number of guesses that are independent, at most P.
    """
    hits, count = int(right.sum()), len(right)
    low = share(hits * trials // count, trials).low
    high = share(-(-hits * trials // count), trials).high
    return Estimate(hits / count, low, high, count=trials)


def mean_share(shares: Sequence[Estimate]) -> Estimate:
    """Average shares of the same trials over several training seeds, with Student's t interval.

    The luck of the trials is the same for all seeds, so that it does not average out over them: a
    standard deviation of the mean share of as many trials is added (:func:`interval_with_luck`).
    One seed has no interval.

    Args:
        shares: one of each seed, as :func:`share` makes them.
    """
    over = mean([each.mean for each in shares])
    if over.count < 2:
        return over
    trials = shares[0].count
    low, high = wilson_interval(over.mean, trials, _ONE_DEVIATION)
    found = _with_luck(over, (high - low) / 2, trials)
    low, high = cut(found.low, found.high)
    return replace(found, low=low, high=high)


def mean_of_same(estimates: Sequence[Estimate]) -> Estimate:
    """Average estimates from the same units over several training seeds, with Student's t interval.

    As in :func:`mean_share` the luck of the units does not average out over seeds: the mean
    standard error within a seed, from its 95 % interval, is added (:func:`interval_with_luck`). One
    seed has no interval.
    """
    over = mean([each.mean for each in estimates])
    if over.count < 2:
        return over
    luck, units = shared_luck(estimates)
    return _with_luck(over, luck, max(over.count, units))


def shared_luck(estimates: Sequence[Estimate]) -> tuple[float, int]:
    """Return the mean standard error of estimates from the same units, and how many units.

    Args:
        estimates: one of each training seed, with 95 % intervals over the units.
    """
    half = float(np.mean([(each.high - each.low) / 2 for each in estimates]))
    return half / _z_quantile((1.0 + CONFIDENCE) / 2.0), min(each.count for each in estimates)


def widened(over: Estimate, luck: float, units: int) -> Estimate:
    """Add what all training seeds share to an interval over seeds that need not be symmetric.

    Half intervals add up as their squares, as in :func:`interval_with_luck`, each side by itself.

    Args:
        over: over training seeds, for example by a bootstrap. Without interval it stays as it is.
        luck, units: standard error that all seeds share, and the units that it is over.
    """
    if luck == 0.0 or not math.isfinite(over.low):
        return over
    half = _t_quantile((1.0 + CONFIDENCE) / 2.0, units - 1) * luck
    low = over.mean - math.hypot(over.mean - over.low, half)
    high = over.mean + math.hypot(over.high - over.mean, half)
    error = math.hypot(over.error, luck)
    return Estimate(over.mean, low, high, error, over.count, luck, units)


def difference_of_shares(ones: Sequence[Estimate], others: Sequence[Estimate]) -> Estimate:
    """Average the differences of shares of the same trials over training seeds, paired by seed.

    The luck of the trials is added as in :func:`mean_share`, that of both shares as if they were
    independent: trials that are right in both have less. One seed has no interval.

    Args:
        ones, others: one of each seed, as :func:`share` makes them; the longer list is cut.
    """
    pairs = list(zip(ones, others, strict=False))
    over = mean([one.mean - other.mean for one, other in pairs])
    if over.count < 2:
        return over
    both = [mean_share(shares) for shares in zip(*pairs, strict=True)]
    luck, trials = math.hypot(*(each.luck for each in both)), min(each.luck_count for each in both)
    return _with_luck(over, luck, trials)


def _with_luck(over: Estimate, luck: float, units: int) -> Estimate:
    """Add the standard error of what all seeds share to that of a mean over seeds."""
    error = math.hypot(over.error, luck)
    low, high = interval_with_luck(over.mean, error, over.count, luck, units)
    return Estimate(over.mean, low, high, error, over.count, luck, units)


def geometric_ratio(ones: ArrayLike, others: ArrayLike) -> Estimate:
    """Geometric mean of paired ratios of positive values, shapes (E,).

    Student's t interval of the logarithms; ``error`` is that of their mean. Pairs in which one is
    not finite are left out.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        log = mean(np.log(np.asarray(ones, np.float64)) - np.log(np.asarray(others, np.float64)))
    return _exponential(log)


def quotient(one: Estimate, other: Estimate) -> Estimate:
    """Ratio of two positive numbers that :func:`by_logarithm` made, as if they were independent."""
    error = math.hypot(one.error, other.error)
    return by_logarithm(one.mean / other.mean, error, min(one.count, other.count))


def by_logarithm(middle: float, error: float, count: int) -> Estimate:
    """Positive number with Student's t interval of its logarithm, whose standard error it has."""
    low, high = t_interval(0.0, error, count)
    return Estimate(middle, middle * exp(low), middle * exp(high), error, count)


def geometric_mean_of_same(estimates: Sequence[Estimate]) -> Estimate:
    """Geometric mean, over training seeds, of numbers that :func:`by_logarithm` made.

    As in :func:`mean_of_same` the luck of the units, the mean standard error of the logarithm
    within a seed, does not average out over seeds. ``error`` and ``luck`` are of logarithms. One
    seed has no interval.
    """
    log = mean([math.log(each.mean) for each in estimates])
    if log.count > 1:
        luck = float(np.mean([each.error for each in estimates]))
        log = _with_luck(log, luck, min(each.count for each in estimates))
    return _exponential(log)


def _exponential(log: Estimate) -> Estimate:
    """Turn the estimate of a logarithm into that of the number; errors stay as they are."""
    return replace(log, mean=exp(log.mean), low=exp(log.low), high=exp(log.high))


def exp(value: float) -> float:
    """Exponential, of a large number that of the largest which does not overflow."""
    return math.exp(min(value, _LARGEST))


def t_interval(
    mean: float, error: float, count: int, confidence: float = CONFIDENCE
) -> tuple[float, float]:
    """Student's t interval of a mean over two or more units, from its standard error."""
    half = _t_quantile((1.0 + confidence) / 2.0, count - 1) * error
    return mean - half, mean + half


def interval_with_luck(
    mean: float,
    error: float,
    count: int,
    luck: float,
    luck_count: int,
    confidence: float = CONFIDENCE,
) -> tuple[float, float]:
    """Interval of a mean over a few seeds that share the luck of many units.

    The half intervals of Student's t, over seeds and over units, add up as their squares, so that
    each part has its own degrees of freedom.

    Args:
        mean, error, count: over seeds; the standard error includes ``luck``.
        luck, luck_count: standard error that all seeds share, and the units that it is over.
        confidence: of the interval.
    """
    if luck == 0.0:
        return t_interval(mean, error, count, confidence)
    own = math.sqrt(max(0.0, error * error - luck * luck))  # ** would raise where these overflow
    tail = (1.0 + confidence) / 2.0
    half = math.hypot(_t_quantile(tail, count - 1) * own, _t_quantile(tail, luck_count - 1) * luck)
    return mean - half, mean + half


def wilson_interval(
    share: float, trials: int, confidence: float = CONFIDENCE
) -> tuple[float, float]:
    """Wilson's interval of a share of trials: all shares that a score test does not exclude."""
    z = _z_quantile((1.0 + confidence) / 2.0)
    centre, width = share + z**2 / (2 * trials), 1.0 + z**2 / trials
    half = z * math.sqrt(share * (1.0 - share) / trials + z**2 / (4 * trials**2))
    low = 0.0 if share == 0.0 else (centre - half) / width  # not below by rounding
    return low, 1.0 if share == 1.0 else (centre + half) / width


@lru_cache(maxsize=4096)
def _t_quantile(probability: float, degrees: int) -> float:
    from scipy.special import stdtrit  # as scipy.stats, which takes half a second more, does

    return float(stdtrit(degrees, probability))


@lru_cache(maxsize=4096)
def _z_quantile(probability: float) -> float:
    from scipy.special import ndtri

    return float(ndtri(probability))
