"""Protocols minus two-stage with the same reward for all: that of the team, in every stage.

By default a driver who learns alone learns from driving, one who learns together with an HMI from
the team's reward. This account leaves no difference but the order of learning: protocols in which
both seats always learn at once, minus two-stage with the team's reward in both stages.
"""

from __future__ import annotations

from pathlib import Path

from hmi_marl.experiments.protocols.arms import TEAM_ALONE
from hmi_marl.experiments.protocols.findings import COMPARED_METRICS, Compared
from hmi_marl.experiments.protocols.results import Comparison, TaskResults
from hmi_marl.reporting.many_runs import paired_differences
from hmi_marl.training.protocols.settings import TEAM


def with_same_reward(comparison: Comparison) -> list[Compared]:
    """Compare them in every task that has both, corrected for the number of comparisons."""
    kinds = [
        (results, protocol, metric)
        for results in comparison.tasks.values()
        for protocol in _learn_at_once(results)
        for metric in COMPARED_METRICS
    ]
    changes = paired_differences(
        [
            (
                results.values(results.own(protocol), metric),
                results.values(results.own(TEAM_ALONE), metric),
            )
            for results, protocol, metric in kinds
        ]
    )
    return [
        Compared(results.plan.name, protocol, metric, change)
        for (results, protocol, metric), change in zip(kinds, changes, strict=True)
    ]


def _learn_at_once(results: TaskResults) -> list[str]:
    """Protocols in which both seats learn in every phase, where two-stage-team is there too."""
    plan = results.plan
    if TEAM_ALONE not in plan.arms:
        return []
    first = {name: plan.runs_of(name)[0] for name in plan.protocols}
    settings = {name: plan.training(run, Path()) for name, run in first.items()}
    return [
        name
        for name, found in settings.items()
        if all(phase.seat == TEAM for phase in found.phases())
    ]
