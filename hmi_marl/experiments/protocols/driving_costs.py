"""Driving that drivers give up against two-stage: speed, lanes, merging and crashes.

A driver who signals chooses actions for what they show, which can cost driving return, term by
term. Differences are paired by seed, in what the pairs of one run earn.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from hmi_marl.envs.rewards import DRIVING_TERMS
from hmi_marl.experiments.protocols.arms import TWO_STAGE
from hmi_marl.experiments.protocols.results import TaskResults, given_up
from hmi_marl.reporting.many_runs import paired_differences
from hmi_marl.reporting.statistics import Estimate


@dataclass(frozen=True)
class DrivingCost:
    """Driving of one arm against the two-stage pairs of the same seeds, mean over drivers."""

    arm: str
    driving: Estimate
    """Driving return per episode that the driver gives up: two-stage's minus its own."""
    by_term: Mapping[str, Estimate]
    """The same for each driving term."""
    crash_rate: Estimate
    """Crash rate minus two-stage's."""


def driving_costs(results: TaskResults) -> list[DrivingCost]:
    """Compare every arm with the largest budget; none without two-stage."""
    if TWO_STAGE not in results.plan.protocols:
        return []
    return [
        DrivingCost(
            arm.name,
            given_up(results, arm.name),
            {term: _less(results, TWO_STAGE, arm.name, term) for term in DRIVING_TERMS},
            _less(results, arm.name, TWO_STAGE, "crash_rate"),
        )
        for arm in results.main_arms()
    ]


def _less(results: TaskResults, one: str, other: str, metric: str) -> Estimate:
    """Return one arm's metric minus another's, paired by seed."""
    ours, theirs = (results.values(results.own(arm), metric) for arm in (one, other))
    (change,) = paired_differences([(ours, theirs)])
    return change.estimate
