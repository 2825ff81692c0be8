"""Cross-play: every driver with every HMI, and how much partners depend on each other.

Runs of the same number share their seed. Let M(a, b) be the return of a's driver with b's HMI. For
two runs a, b

    ½ [M(a, a) + M(b, b)] - ½ [M(a, b) + M(b, a)],

own pairs minus swapped pairs, is the gain from partners that fit each other: it is 0 wherever the
return is a driver's part plus an HMI's part, however good each of them is. Between protocols it
compares runs of one seed; within a protocol, each run with that of the next seed: there it shows
whether partners agreed on something that others of the same protocol do not know. All pairs are
compared by the same episodes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hmi_marl.envs.config import DRIVER, VEHICLE_AI
from hmi_marl.experiments.protocols.arms import RULE, Arm
from hmi_marl.experiments.protocols.pairs import Pair, crossed, pairs_of, rule_pairs
from hmi_marl.experiments.protocols.results import TaskResults
from hmi_marl.reporting import statistics
from hmi_marl.reporting.statistics import UNKNOWN, Estimate

METRIC = "attention_return"
"""Return that is compared: it is what partners earn by understanding each other."""


@dataclass(frozen=True)
class Cell:
    """One arm's drivers with another arm's HMIs."""

    driver: str
    hmi: str
    same_seed: Estimate
    """Over runs of the same number; for one arm, driver and HMI of one run."""
    next_seed: Estimate
    """Each run's driver with the HMI of the next number."""


def drivers_of(results: TaskResults) -> list[str]:
    """Arms with a driver that plays with every HMI, and the rule-based driver."""
    listed = [arm.name for arm in _crossed(results) if DRIVER in arm.seats]
    return [*listed, RULE] if any(pair.driver == RULE for pair in crossed(results.plan)) else listed


def hmis_of(results: TaskResults) -> list[str]:
    """Arms with an HMI that plays with every driver."""
    return [arm.name for arm in _crossed(results) if VEHICLE_AI in arm.seats]


def cross_play(results: TaskResults) -> list[Cell]:
    """Play out of every arm's drivers with every arm's HMIs."""
    return [
        cell_of(results, driver, hmi) for driver in drivers_of(results) for hmi in hmis_of(results)
    ]


def cell_of(results: TaskResults, driver: str, hmi: str) -> Cell:
    """Average over the runs of two arms, with Student's t intervals over runs."""
    if driver == RULE:
        pairs = rule_pairs(results.plan, hmi)
        return Cell(driver, hmi, results.over_runs(pairs, METRIC, shared=True), UNKNOWN)
    same, following = pairs_of(results.plan, driver, hmi, 0), pairs_of(results.plan, driver, hmi, 1)
    apart = [pair for pair in following if pair not in same]
    return Cell(
        driver,
        hmi,
        results.over_runs(same, METRIC, shared=True),
        results.over_runs(apart, METRIC, shared=True) if apart else UNKNOWN,
    )


@dataclass(frozen=True)
class Dependence:
    """Dependence of an arm's partners on each other, in attention return per episode."""

    arm: str
    on_protocol: Mapping[str, Estimate]
    """Own minus swapped pairs with each other arm, runs of the same seed."""
    on_seed: Estimate
    """Own minus swapped pairs with the next run of the same arm."""


def dependence_of(results: TaskResults) -> list[Dependence]:
    """Measure the dependence of every crossed arm; intervals are over runs."""
    arms = [arm for arm in _crossed(results) if arm.whole]
    return [
        Dependence(
            arm.name,
            {
                other.name: statistics.mean(_gains(results, arm.name, other.name))
                for other in arms
                if other is not arm
            },
            statistics.mean(_gains_next(results, arm.name)),
        )
        for arm in arms
    ]


def _gains(results: TaskResults, one: str, other: str) -> NDArray[np.float64]:
    """Own minus swapped pairs of runs of the same number, shape (runs,)."""
    own = [_values(results, pairs_of(results.plan, name, name, 0)) for name in (one, other)]
    swapped = _values(results, pairs_of(results.plan, one, other, 0))
    back = _values(results, pairs_of(results.plan, other, one, 0))
    count = len(swapped)
    return (own[0][:count] + own[1][:count] - swapped - back) / 2.0


def _gains_next(results: TaskResults, arm: str) -> NDArray[np.float64]:
    """Own minus swapped pairs of each run and the next, shape (runs,); NaN with one run.

    Run k + 1's driver does not play with run k's HMI, so the other half of the swap is that of the
    whole circle: the mean over runs is the same.
    """
    own = _values(results, pairs_of(results.plan, arm, arm, 0))
    if len(own) < 2:
        return np.full(1, np.nan)
    swapped = _values(results, pairs_of(results.plan, arm, arm, 1))
    return own - swapped


def _values(results: TaskResults, pairs: Sequence[Pair]) -> NDArray[np.float64]:
    return results.values(pairs, METRIC, shared=True)


def _crossed(results: TaskResults) -> list[Arm]:
    return [arm for arm in results.plan.arms.values() if arm.in_cross_play]
