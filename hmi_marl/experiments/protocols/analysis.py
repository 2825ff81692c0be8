"""What a comparison of protocols shows: means over seeds, curves, dependence, gaming.

**Dependence.** Let M(a, b) be the mean team return of a's driver with b's HMI. For two runs a, b

    ½ [M(a, a) + M(b, b)] - ½ [M(a, b) + M(b, a)],

own pairs minus swapped pairs, is what fitting each other is worth to a team: it is 0 wherever the
return is a driver's part plus an HMI's part, however good each of them is. A protocol's number is
its mean over the other protocols (the runs of the same seed), or over the other seeds of the same
protocol.

**Gaming.** Where a step is worth less than nothing, ending the episode by a crash pays. A protocol
is called gamed with a driver if both hold:

1. they crash more often than the two-stage driver, who learns from the driving reward alone: the
   lower end of the crash rate's Wilson interval is more than 0.05 above the upper end of theirs;
2. a step is worth less than nothing to this driver, in the reward that they learn from (but for
   the collision's own term, which is not what goes on after a step).

With the first alone a protocol "crashes more": it may have learned less, or have learned to crash
while its partner was worse than it is now, which the run that was trained with
``end_at_crash=False`` shows, where crashing ends nothing.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from hmi_marl.experiments.protocols.play import Played, Sums
from hmi_marl.experiments.protocols.settings import (
    EVERYBODY,
    TWO_STAGE,
    CompareSettings,
    Pair,
    Protocol,
    Run,
)
from hmi_marl.reporting import statistics
from hmi_marl.reporting.statistics import Estimate

CURVES = ("team_return", "speed_reward", "attention_return", "crash_rate")
"""What is drawn over environment steps."""
MARGIN = 0.05
"""Of crash rates: a smaller excess over the two-stage driver is not called one."""
UNKNOWN = Estimate(math.nan, math.nan, math.nan)

Verdict = Literal["reference", "fine", "crashes more", "GAMED", "unknown"]
_NEVER_NEGATIVE = ("crash_rate", "alerts_per_minute", "length", "time_headway")
_WORST: tuple[Verdict, ...] = ("GAMED", "crashes more", "unknown", "fine", "reference")
Rows = Sequence[Mapping[str, Any]]
"""Of one run's learning curve."""


@dataclass(frozen=True)
class Comparison:
    """Everything that was learned and played."""

    settings: CompareSettings
    played: Played
    curves: Mapping[str, Rows]
    """Rows of each run's learning curve, by its name."""
    workers: int = 1
    """Runs that were trained side by side."""

    def runs(self, protocol: Protocol) -> list[Run]:
        """A protocol's runs, a seed each."""
        return [run for run in self.settings.main_runs if run.protocol == protocol]

    def own_pairs(self, protocol: Protocol) -> list[Pair]:
        """Each run's driver with its own HMI."""
        return [Pair(run.name, run.name) for run in self.runs(protocol)]

    def groups(self) -> dict[str, list[Pair]]:
        """The protocols and the baselines by label, with their pairs, a seed each."""
        own = {protocol: self.own_pairs(protocol) for protocol in self.settings.protocols}
        return own | self.settings.baselines()

    def seconds(self, run: Run) -> float:
        """What a training took."""
        return float(self.curves[run.name][-1]["seconds"])


def over_seeds(played: Played, pairs: Sequence[Pair], metric: str) -> Estimate:
    """A metric's mean over seeds with Student's t interval: each seed's mean is one value."""
    lowest = 0.0 if metric in _NEVER_NEGATIVE else -math.inf
    return statistics.mean([played[pair][EVERYBODY].metrics()[metric] for pair in pairs], lowest)


def crash_rate(sums: Sums) -> Estimate:
    """The share of episodes that crash, with Wilson's interval; unknown if there were none."""
    return statistics.share(sums.crashes, sums.episodes) if sums.episodes else UNKNOWN


def pooled(played: Played, pairs: Sequence[Pair], driver: str = EVERYBODY) -> Sums:
    """The episodes of several pairs as if of one."""
    return Sums.join(played[pair][driver] for pair in pairs)


@dataclass(frozen=True)
class Curve:
    """One quantity over environment steps. Arrays have shape (T,)."""

    steps: NDArray[np.int64]
    mean: NDArray[np.float64]
    """Over the seeds."""
    low: NDArray[np.float64]
    """Of the 95 % interval; NaN with one seed."""
    high: NDArray[np.float64]


def common_curve(runs: Sequence[Rows], name: str) -> Curve:
    """The mean of several runs' curves, each interpolated on the steps that any of them has.

    Only steps that lie within all of them count.

    Raises:
        ValueError: no curve, an empty one, or none that overlap.
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
    """A protocol's curves by quantity."""
    rows = [comparison.curves[run.name] for run in comparison.runs(protocol)]
    return {name: common_curve(rows, name) for name in CURVES}


def _team_return(played: Played, driver: Run, hmi: Run) -> float:
    return played[Pair(driver.name, hmi.name)][EVERYBODY].per_episode()


def swap_matrix(comparison: Comparison) -> NDArray[np.float64]:
    """Team returns, shape (seeds, protocols, protocols): of the driver's, of the HMI's protocol."""
    protocols = comparison.settings.protocols
    by_seed = zip(*(comparison.runs(protocol) for protocol in protocols), strict=True)
    return np.array(
        [[[_team_return(comparison.played, a, b) for b in runs] for a in runs] for runs in by_seed]
    )


def seed_matrix(comparison: Comparison, protocol: Protocol) -> NDArray[np.float64]:
    """Team returns within a protocol, shape (seeds, seeds): of the driver's, of the HMI's seed."""
    runs = comparison.runs(protocol)
    return np.array([[_team_return(comparison.played, a, b) for b in runs] for a in runs])


def dependences(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """Own pairs minus swapped pairs of each run with every other one, averaged over those.

    Args:
        matrix: returns, shape (n, n), rows by driver, columns by HMI.

    Returns:
        Shape (n,); NaN if there is no other.
    """
    own = np.diag(matrix)
    gains = (own[:, None] + own[None, :] - matrix - matrix.T) / 2.0
    others = len(own) - 1
    return gains.sum(axis=1) / others if others else np.full(1, np.nan)


@dataclass(frozen=True)
class Dependence:
    """How far a protocol's partners depend on each other. Team returns per episode."""

    protocol: Protocol
    own: Estimate
    """Driver and HMI of the same run."""
    driver_with_others: Estimate
    """Its driver with the other protocols' HMIs; this also tells how good these are."""
    hmi_with_others: Estimate
    """Its HMI with the other protocols' drivers; the same."""
    on_protocol: Estimate
    """Own minus swapped pairs, beside the other protocols."""
    other_seeds: Estimate
    """Driver and HMI of different runs of this protocol, each driver's mean."""
    on_seed: Estimate
    """Own minus swapped pairs, among the runs of this protocol."""


def dependence_of(comparison: Comparison) -> list[Dependence]:
    """For every protocol; intervals are over the seeds."""
    matrix = swap_matrix(comparison)
    across = np.array([dependences(one) for one in matrix])
    told = []
    for k, protocol in enumerate(comparison.settings.protocols):
        within = seed_matrix(comparison, protocol)
        others = np.arange(matrix.shape[1]) != k
        apart = ~np.eye(len(within), dtype=np.bool_)
        swapped = [row[keep].mean() for row, keep in zip(within, apart, strict=True) if keep.any()]
        told.append(
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
    return told


def _mean_of(returns: NDArray[np.float64]) -> Estimate:
    """Over seeds, of the means over the others; shape (seeds, others)."""
    return statistics.mean(returns.mean(axis=1)) if returns.shape[1] else UNKNOWN


@dataclass(frozen=True)
class Gaming:
    """Whether it pays a driver to crash: one protocol with one driver, or ``EVERYBODY``."""

    protocol: Protocol
    driver: str
    crash_rate: Estimate
    """All seeds together; a crash ends the episode, in training and now."""
    two_stage_crash_rate: Estimate
    """The two-stage driver's."""
    team_return: float
    """Per episode."""
    team_return_per_step: float
    worth_of_a_step: float
    """To the driver, in the reward they learn from, but for the collision's own term."""
    crash_rate_if_trained_standing: Estimate
    """Of the first seed's run trained with ``end_at_crash=False``; a crash ends the episode now."""
    crash_rate_standing: Estimate
    """The same run in its own setting: the crashed car stands until the time is over. Policies
    that draw nothing crash in the same episodes."""
    team_return_standing: float
    """Per episode, in that setting."""
    verdict: Verdict


def judge(rate: Estimate, reference: Estimate, worth_of_a_step: float) -> Verdict:
    """The rule at the top of this page."""
    if not all(map(math.isfinite, (rate.low, reference.high, worth_of_a_step))):
        return "unknown"
    if rate.low <= reference.high + MARGIN:
        return "fine"
    return "GAMED" if worth_of_a_step < 0.0 else "crashes more"


def gaming_of(comparison: Comparison) -> list[Gaming]:
    """For every protocol, with everybody and with each driver."""
    settings, played = comparison.settings, comparison.played
    told = []
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
        told.append(
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
                verdict="reference" if protocol == TWO_STAGE else judge(rate, reference, worth),
            )
        )
    return told


def _with_drivers(settings: CompareSettings) -> list[tuple[Protocol, str]]:
    names = (EVERYBODY, *settings.driver_names)
    return [(protocol, name) for protocol in settings.protocols for name in names]


def verdict_of(gaming: Sequence[Gaming], protocol: Protocol) -> Verdict:
    """A protocol's: the worst of those with everybody and with each driver."""
    found = {row.verdict for row in gaming if row.protocol == protocol}
    return next(verdict for verdict in _WORST if verdict in found)
