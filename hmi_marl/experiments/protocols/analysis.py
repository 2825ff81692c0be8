"""Analyse a comparison of protocols: means over seeds, curves, dependence, gaming.

**Dependence.** Let M(a, b) be the mean team return of a's driver with b's HMI. For two runs a, b

    ½ [M(a, a) + M(b, b)] - ½ [M(a, b) + M(b, a)],

own pairs minus swapped pairs, is the gain from partners that fit each other: it is 0 wherever the
return is a driver's part plus an HMI's part, however good each of them is. A protocol's number is
its mean over the other protocols (the runs of the same seed), or over the other seeds of the same
protocol.

**Gaming.** Where the reward of a step is negative, ending the episode by a crash pays. A protocol
is gamed with a driver if both hold:

1. the driver crashes more often than the two-stage driver, who learns from the driving reward
   alone: the lower end of the crash rate's Wilson interval is more than
   ``criteria.MORE_CRASHES`` above the upper end of the two-stage driver's;
2. the mean reward of a step is negative, in the reward that the driver learns from, without the
   collision term, which is not part of the steps that a crash saves.

With the first alone a protocol "crashes more": it may have learned less, or have learned to crash
while its partner was worse than it is now. The run that was trained with ``end_at_crash=False``,
where crashing ends nothing, shows which.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from hmi_marl.experiments import criteria
from hmi_marl.experiments.protocols.plan import (
    ALL_DRIVERS,
    TWO_STAGE,
    ComparisonSettings,
    Pair,
    PlannedRun,
    Played,
    Protocol,
    Sums,
)
from hmi_marl.reporting import statistics
from hmi_marl.reporting.statistics import Estimate

CURVES = ("team_return", "speed_reward", "attention_return", "crash_rate")
"""Quantities that are drawn over environment steps."""
UNKNOWN = Estimate(math.nan, math.nan, math.nan)

Finding = Literal["reference", "fine", "crashes more", "GAMED", "unknown"]
_NEVER_NEGATIVE = ("crash_rate", "alerts_per_minute", "length", "time_headway")
_WORST: tuple[Finding, ...] = ("GAMED", "crashes more", "unknown", "fine", "reference")
Rows = Sequence[Mapping[str, Any]]
"""Rows of one run's learning curve."""


@dataclass(frozen=True)
class Comparison:
    """Results of a comparison."""

    settings: ComparisonSettings
    played: Played
    curves: Mapping[str, Rows]
    """Rows of each run's learning curve, by its name."""
    workers: int = 1
    """Runs that were trained side by side."""

    def runs(self, protocol: Protocol) -> list[PlannedRun]:
        """List a protocol's runs, a seed each."""
        return [run for run in self.settings.main_runs if run.protocol == protocol]

    def own_pairs(self, protocol: Protocol) -> list[Pair]:
        """Pair each run's driver with its own HMI."""
        return [Pair(run.name, run.name) for run in self.runs(protocol)]

    def groups(self) -> dict[str, list[Pair]]:
        """Return the pairs of the protocols and the baselines by label, a seed each."""
        own = {protocol: self.own_pairs(protocol) for protocol in self.settings.protocols}
        return own | self.settings.baselines()

    def seconds(self, run: PlannedRun) -> float:
        """Return the duration of a training [s]."""
        return float(self.curves[run.name][-1]["seconds"])


def over_seeds(played: Played, pairs: Sequence[Pair], metric: str) -> Estimate:
    """Average a metric over seeds, with Student's t interval: each seed's mean is one value."""
    lowest = 0.0 if metric in _NEVER_NEGATIVE else -math.inf
    return statistics.mean([played[pair][ALL_DRIVERS].metrics()[metric] for pair in pairs], lowest)


def crash_rate(sums: Sums) -> Estimate:
    """Return the share of episodes that crash, with Wilson's interval; NaN without episodes."""
    return statistics.share(sums.crashes, sums.episodes) if sums.episodes else UNKNOWN


def pooled(played: Played, pairs: Sequence[Pair], driver: str = ALL_DRIVERS) -> Sums:
    """Join the episodes of several pairs."""
    return Sums.join(played[pair][driver] for pair in pairs)


@dataclass(frozen=True)
class Curve:
    """Quantity over environment steps. Arrays have shape (T,)."""

    steps: NDArray[np.int64]
    mean: NDArray[np.float64]
    """Mean over the seeds."""
    low: NDArray[np.float64]
    """Lower end of the 95 % interval; NaN with one seed."""
    high: NDArray[np.float64]


def common_curve(runs: Sequence[Rows], name: str) -> Curve:
    """Average several runs' curves, each interpolated at the steps that any of them has.

    Only steps within all curves count.

    Raises:
        ValueError: no curve, an empty curve, or curves that do not overlap.
    """
    if not runs or not all(runs):
        raise ValueError("a curve is made of at least one run, and each has at least one row")
    places = [np.array([row["steps"] for row in rows], np.int64) for rows in runs]
    steps = np.unique(np.concatenate(places))
    steps = steps[(steps >= max(at[0] for at in places)) & (steps <= min(at[-1] for at in places))]
    if len(steps) == 0:
        raise ValueError("these curves have no environment steps in common")
    values = np.array(
        [
            np.interp(steps, at, [row[name] for row in rows])
            for at, rows in zip(places, runs, strict=True)
        ]
    )
    estimates = [statistics.mean(column) for column in values.T]
    mean, low, high = np.array([[e.mean, e.low, e.high] for e in estimates]).T
    return Curve(steps, mean, low, high)


def curves_of(comparison: Comparison, protocol: Protocol) -> dict[str, Curve]:
    """Return a protocol's curves by quantity."""
    rows = [comparison.curves[run.name] for run in comparison.runs(protocol)]
    return {name: common_curve(rows, name) for name in CURVES}


def _team_return(played: Played, driver: PlannedRun, hmi: PlannedRun) -> float:
    return played[Pair(driver.name, hmi.name)][ALL_DRIVERS].per_episode()


def swap_matrix(comparison: Comparison) -> NDArray[np.float64]:
    """Return team returns, shape (seeds, protocols, protocols): the driver's by the HMI's."""
    protocols = comparison.settings.protocols
    by_seed = zip(*(comparison.runs(protocol) for protocol in protocols), strict=True)
    return np.array(
        [[[_team_return(comparison.played, a, b) for b in runs] for a in runs] for runs in by_seed]
    )


def seed_matrix(comparison: Comparison, protocol: Protocol) -> NDArray[np.float64]:
    """Return team returns within a protocol, shape (seeds, seeds): the driver's by the HMI's."""
    runs = comparison.runs(protocol)
    return np.array([[_team_return(comparison.played, a, b) for b in runs] for a in runs])


def dependences(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """Average own minus swapped pairs of each run over all other runs, shape (n,); NaN if none.

    Returns in ``matrix`` (n, n) are by driver (rows) and HMI (columns).
    """
    own = np.diag(matrix)
    gains = (own[:, None] + own[None, :] - matrix - matrix.T) / 2.0
    others = len(own) - 1
    return gains.sum(axis=1) / others if others else np.full(1, np.nan)


@dataclass(frozen=True)
class Dependence:
    """Dependence of a protocol's partners on each other. Team returns per episode."""

    protocol: Protocol
    own: Estimate
    """Driver and HMI of the same run."""
    driver_with_others: Estimate
    """Its driver with the other protocols' HMIs; also depends on how good these are."""
    hmi_with_others: Estimate
    """Its HMI with the other protocols' drivers; also depends on how good these are."""
    on_protocol: Estimate
    """Own minus swapped pairs, with the other protocols."""
    other_seeds: Estimate
    """Driver and HMI of different runs of this protocol, each driver's mean."""
    on_seed: Estimate
    """Own minus swapped pairs, among the runs of this protocol."""


def dependence_of(comparison: Comparison) -> list[Dependence]:
    """Measure the dependence of every protocol; intervals are over the seeds."""
    matrix = swap_matrix(comparison)
    across = np.array([dependences(one) for one in matrix])
    rows = []
    for k, protocol in enumerate(comparison.settings.protocols):
        within = seed_matrix(comparison, protocol)
        others = np.arange(matrix.shape[1]) != k
        apart = ~np.eye(len(within), dtype=np.bool_)
        swapped = [row[keep].mean() for row, keep in zip(within, apart, strict=True) if keep.any()]
        rows.append(
            Dependence(
                protocol,
                own=statistics.mean(matrix[:, k, k]),
                driver_with_others=_mean_of(matrix[:, k, others]),
                hmi_with_others=_mean_of(matrix[:, others, k]),
                on_protocol=statistics.mean(across[:, k]),
                other_seeds=statistics.mean(swapped),
                on_seed=statistics.mean(dependences(within)),
            )
        )
    return rows


def _mean_of(returns: NDArray[np.float64]) -> Estimate:
    """Average over seeds the means over the others; shape (seeds, others)."""
    return statistics.mean(returns.mean(axis=1)) if returns.shape[1] else UNKNOWN


@dataclass(frozen=True)
class Gaming:
    """Crashes of one protocol with one driver, or ``ALL_DRIVERS``, and whether crashing pays."""

    protocol: Protocol
    driver: str
    crash_rate: Estimate
    """Crash rate over all seeds; a crash ends the episode, in training and now."""
    two_stage_crash_rate: Estimate
    """Crash rate of the two-stage driver."""
    team_return: float
    """Team return per episode."""
    team_return_per_step: float
    worth_of_a_step: float
    """Mean reward of a step that the driver learns from, without the collision term."""
    crash_rate_if_trained_standing: Estimate
    """Crash rate of the first run trained with ``end_at_crash=False``; a crash ends it now."""
    crash_rate_standing: Estimate
    """Crash rate of the same run in its own setting: the crashed car stands until the end.
    Deterministic policies crash in the same episodes."""
    team_return_standing: float
    """Team return per episode in that setting."""
    finding: Finding


def find(rate: Estimate, reference: Estimate, worth_of_a_step: float) -> Finding:
    """Apply the rule at the top of this page."""
    if not all(map(math.isfinite, (rate.low, reference.high, worth_of_a_step))):
        return "unknown"
    if rate.low <= reference.high + criteria.MORE_CRASHES:
        return "fine"
    return "GAMED" if worth_of_a_step < 0.0 else "crashes more"


def gaming_of(comparison: Comparison) -> list[Gaming]:
    """Look for gaming in every protocol, with all drivers together and with each driver."""
    settings, played = comparison.settings, comparison.played
    rows = []
    for protocol, driver in _with_drivers(settings):
        sums = pooled(played, comparison.own_pairs(protocol), driver)
        reference = UNKNOWN
        if TWO_STAGE in settings.protocols:
            reference = crash_rate(pooled(played, comparison.own_pairs(TWO_STAGE), driver))
        terms = [name for name in settings.driver_terms(protocol) if name != "collision"]
        worth = sums.per_step(terms)
        ends, stands = UNKNOWN, UNKNOWN
        standing_return = math.nan
        for run in settings.standing_runs:
            if run.protocol == protocol:
                ends = crash_rate(played[Pair(run.name, run.name)][driver])
                own = played[Pair(run.name, run.name, end_at_crash=False)][driver]
                stands, standing_return = crash_rate(own), own.per_episode()
        rate = crash_rate(sums)
        rows.append(
            Gaming(
                protocol=protocol,
                driver=driver,
                crash_rate=rate,
                two_stage_crash_rate=reference,
                team_return=sums.per_episode(),
                team_return_per_step=sums.per_step(),
                worth_of_a_step=worth,
                crash_rate_if_trained_standing=ends,
                crash_rate_standing=stands,
                team_return_standing=standing_return,
                finding="reference" if protocol == TWO_STAGE else find(rate, reference, worth),
            )
        )
    return rows


def _with_drivers(settings: ComparisonSettings) -> list[tuple[Protocol, str]]:
    names = (ALL_DRIVERS, *settings.driver_names)
    return [(protocol, name) for protocol in settings.protocols for name in names]


def worst_finding(gaming: Sequence[Gaming], protocol: Protocol) -> Finding:
    """Return the worst of a protocol's findings."""
    found = {row.finding for row in gaming if row.protocol == protocol}
    return next(finding for finding in _WORST if finding in found)
