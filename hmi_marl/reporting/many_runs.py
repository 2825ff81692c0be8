"""Statistics over several training runs: aggregates, profiles, paired differences, corrections.

Scores have shape (runs, drivers): each run's policies play with every driver. **The unit is a
run**: what a run scores with its drivers comes from the same weights, so a bootstrap draws whole
runs, and each resample has every driver equally often (strata). Interquartile means, performance
profiles and the probability of improvement are those of Agarwal et al., "Deep reinforcement
learning at the edge of the statistical precipice" (2021). Intervals are percentiles of the
resamples, expanded for few runs as in Hesterberg, "What teachers should know about the bootstrap"
(2015).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hmi_marl.reporting.statistics import CONFIDENCE, Estimate, t_interval

RESAMPLES = 2000
"""Resamples of a bootstrap. They are drawn from a fixed seed, so a report can be repeated."""
_SEED = 0
Statistic = Callable[[NDArray[np.float64]], NDArray[np.float64]]
"""Function of scores (..., runs, drivers), of shape (...)."""


def interquartile_mean(scores: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean of the middle half of scores (..., runs, drivers), over runs and drivers together."""
    from scipy import stats

    together = scores.reshape(*scores.shape[:-2], -1)
    return np.asarray(stats.trim_mean(together, 0.25, axis=-1))


def over_runs(
    scores: ArrayLike, statistic: Statistic = interquartile_mean, confidence: float = CONFIDENCE
) -> Estimate:
    """Estimate a statistic of scores (runs, drivers) with its expanded bootstrap interval.

    One run has no interval.

    Raises:
        ValueError: another shape, no scores, or scores that are not finite.
    """
    return _resampled([checked(scores)], lambda parts: statistic(parts[0]), confidence)


def shared_error(
    scores: ArrayLike, errors: ArrayLike, statistic: Statistic = interquartile_mean
) -> float:
    """Standard error of a statistic by what moves the scores of all runs alike, driver by driver.

    An interquartile mean leans on the drivers in the middle, so that it has more of their errors
    than the mean over drivers has: they are drawn from normal distributions.

    Args:
        scores: shape (runs, drivers).
        errors: standard errors that all runs share, shape (drivers,).
        statistic: of the scores.

    Returns:
        NaN if an error is not known.

    Raises:
        ValueError: as :func:`over_runs`.
    """
    values, apart = checked(scores), np.asarray(errors, np.float64)
    if not np.isfinite(apart).all():
        return math.nan
    if not apart.any():
        return 0.0
    drawn = np.random.default_rng(_SEED).standard_normal((RESAMPLES, 1, len(apart)))
    return float(statistic(values + drawn * apart).std())


def probability_of_improvement(scores: ArrayLike, others: ArrayLike) -> Estimate:
    """Probability that a run of one kind scores higher than one of another, mean over drivers.

    Equal scores count half. Both kinds are resampled, each by itself. Shapes (runs, drivers) and
    (other runs, drivers).

    Raises:
        ValueError: as :func:`over_runs`, or different numbers of drivers.
    """
    ours, theirs = checked(scores), checked(others)
    if ours.shape[1] != theirs.shape[1]:
        raise ValueError(f"scores with {ours.shape[1]} and with {theirs.shape[1]} drivers")

    def improvement(parts: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
        apart = parts[0][..., :, None, :] - parts[1][..., None, :, :]
        return (0.5 * (1.0 + np.sign(apart))).mean(axis=(-3, -2, -1))

    return _resampled([ours, theirs], improvement, CONFIDENCE)


@dataclass(frozen=True)
class Profile:
    """Share of runs and drivers that score more than a threshold. Arrays have shape (T,)."""

    thresholds: NDArray[np.float64]
    share: NDArray[np.float64]
    low: NDArray[np.float64]
    """Lower end of the bootstrap interval of each share; NaN with one run."""
    high: NDArray[np.float64]


def performance_profile(scores: ArrayLike, thresholds: ArrayLike) -> Profile:
    """Return the performance profile of scores (runs, drivers) at thresholds (T,).

    Raises:
        ValueError: as :func:`over_runs`.
    """
    values, places = checked(scores), np.asarray(thresholds, np.float64)
    above = [
        over_runs((values > place).astype(np.float64), lambda part: part.mean(axis=(-2, -1)))
        for place in places
    ]
    share, low, high = np.array([[e.mean, e.low, e.high] for e in above]).T
    return Profile(places, share, low, high)


@dataclass(frozen=True)
class Difference:
    """Difference of two kinds of runs, paired by seed."""

    pairs: int
    """Seeds that both have."""
    estimate: Estimate
    """Mean difference and Student's t interval, as wide as the number of comparisons asks for."""
    p: float
    """p of the paired t test, corrected by Holm's method; NaN with fewer than two pairs."""

    @property
    def differs(self) -> bool | None:
        """Whether they differ, after correction; None where that cannot be said."""
        return None if math.isnan(self.p) else self.p < 1.0 - CONFIDENCE


def paired_differences(
    pairs: Sequence[tuple[ArrayLike, ArrayLike]], comparisons: int | None = None
) -> list[Difference]:
    """Compare pairs of kinds of runs, with one value for each seed, corrected for their number.

    Args:
        pairs: values of both, shape (seeds,) each, of which the first min(seeds) are paired.
        comparisons: comparisons that are made in all; those given here by default. Intervals are
            Bonferroni's, so all of them hold together with 95 %.

    Raises:
        ValueError: fewer comparisons than pairs.
    """
    from scipy import stats

    count = len(pairs) if comparisons is None else comparisons
    if count < len(pairs):
        raise ValueError(f"{len(pairs)} pairs are more than {count} comparisons")
    apart = [_apart(*pair) for pair in pairs]
    level = 1.0 - (1.0 - CONFIDENCE) / max(1, count)
    raw, estimates = [], []
    for values in apart:
        middle = float(values.mean()) if len(values) else math.nan
        if len(values) < 2:
            estimates.append(Estimate(middle, math.nan, math.nan, count=len(values)))
            raw.append(math.nan)
            continue
        error = float(values.std(ddof=1)) / math.sqrt(len(values))
        low, high = t_interval(middle, error, len(values), level)
        estimates.append(Estimate(middle, low, high, error, len(values)))
        t = abs(middle) / error if error else (math.inf if middle else 0.0)
        raw.append(2.0 * float(stats.t.sf(t, len(values) - 1)))
    return [
        Difference(len(values), estimate, p)
        for values, estimate, p in zip(apart, estimates, holm(raw, count), strict=True)
    ]


def holm(p_values: Sequence[float], comparisons: int | None = None) -> list[float]:
    """Correct p values for their number by Holm's step-down method; NaN stays NaN."""
    count = len(p_values) if comparisons is None else comparisons
    corrected, highest = [math.nan] * len(p_values), 0.0
    known = sorted((p, place) for place, p in enumerate(p_values) if not math.isnan(p))
    for rank, (p, place) in enumerate(known):
        highest = max(highest, min(1.0, p * (count - rank)))
        corrected[place] = highest
    return corrected


def checked(scores: ArrayLike) -> NDArray[np.float64]:
    """Return scores as an array (runs, drivers).

    Raises:
        ValueError: another shape, no scores, or scores that are not finite.
    """
    values = np.asarray(scores, np.float64)
    if values.ndim != 2 or values.size == 0:
        raise ValueError(f"scores have shape (runs, drivers), not {values.shape}")
    if not np.isfinite(values).all():
        raise ValueError("scores are finite everywhere")
    return values


def _apart(ours: ArrayLike, theirs: ArrayLike) -> NDArray[np.float64]:
    one, other = np.asarray(ours, np.float64), np.asarray(theirs, np.float64)
    count = min(len(one), len(other))
    return one[:count] - other[:count]


def _resampled(
    parts: Sequence[NDArray[np.float64]],
    statistic: Callable[[Sequence[NDArray[np.float64]]], NDArray[np.float64]],
    confidence: float,
) -> Estimate:
    """Estimate a statistic of one or more kinds of runs, each of which is resampled by itself."""
    found, runs = float(statistic(parts)), min(len(part) for part in parts)
    if runs < 2:
        return Estimate(found, math.nan, math.nan, count=runs)
    rng = np.random.default_rng(_SEED)
    tail = _tail(runs, confidence)
    drawn = [part[rng.integers(len(part), size=(RESAMPLES, len(part)))] for part in parts]
    values = statistic(drawn)
    low, high = np.quantile(values, [tail, 1.0 - tail])
    error = float(values.std()) * math.sqrt(runs / (runs - 1))  # resamples are too narrow
    return Estimate(found, float(low), float(high), error, runs)


def _tail(runs: int, confidence: float) -> float:
    """Share of resamples left out at either end, by the expanded percentile interval.

    A percentile interval of few runs is too narrow, by the factor sqrt((n - 1) / n) and by the
    normal's quantile in place of Student's t. The tail makes up for both; with 3 runs the interval
    goes from the least resample to the greatest.
    """
    from scipy import stats

    reach = stats.t.ppf((1.0 + confidence) / 2.0, runs - 1) * math.sqrt(runs / (runs - 1))
    return float(stats.norm.sf(reach))
