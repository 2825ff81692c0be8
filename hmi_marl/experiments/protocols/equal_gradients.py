"""Protocols minus two-stage at equal gradient steps: the second account of a fair budget.

Where two learners learn at once, the same environment steps take twice the gradient steps. So a
protocol with a smaller budget of environment steps is compared with two-stage with a larger one,
wherever their gradient steps are about the same. Protocols that take as many gradient steps as
two-stage at equal environment steps are compared by the main account already.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from hmi_marl.experiments.protocols.arms import TWO_STAGE, Arm
from hmi_marl.experiments.protocols.results import Comparison, TaskResults
from hmi_marl.reporting.many_runs import Difference, paired_differences

ALIKE = 0.1
"""Largest difference of gradient steps that count as equal, as a share: budgets are whole
batches."""


@dataclass(frozen=True)
class AtEqualGradients:
    """A protocol minus two-stage in attention return, paired by seed."""

    task: str
    protocol: str
    gradient_steps: int
    """Of a run of the protocol."""
    steps: int
    """Environment steps of a run of the protocol."""
    two_stage_gradient_steps: int
    two_stage_steps: int
    difference: Difference


def at_equal_gradients(comparison: Comparison) -> list[AtEqualGradients]:
    """Compare every protocol with two-stage at equal gradient steps, corrected for all of them."""
    matched = [
        (results, ours, theirs)
        for results in comparison.tasks.values()
        for ours, theirs in _matches(results)
    ]
    metric = "attention_return"
    differences = paired_differences(
        [
            (
                results.values(results.own(ours.name), metric),
                results.values(results.own(theirs.name), metric),
            )
            for results, ours, theirs in matched
        ]
    )
    found = []
    for (results, ours, theirs), difference in zip(matched, differences, strict=True):
        one, other = results.cost(ours.name), results.cost(theirs.name)
        found.append(
            AtEqualGradients(
                results.plan.name,
                ours.protocol,
                one.gradient_steps,
                one.steps,
                other.gradient_steps,
                other.steps,
                difference,
            )
        )
    return found


def _matches(results: TaskResults) -> Iterator[tuple[Arm, Arm]]:
    """Pair arms with those of two-stage with as many gradient steps, if their budgets differ."""
    budgeted = [arm for arm in results.whole_arms() if arm.anchor_kl is None and not arm.options]
    references = [arm for arm in budgeted if arm.protocol == TWO_STAGE]
    for ours in budgeted:
        one = results.cost(ours.name)
        for theirs in references if ours.protocol != TWO_STAGE else ():
            other = results.cost(theirs.name)
            apart = abs(one.gradient_steps - other.gradient_steps)
            if apart <= ALIKE * other.gradient_steps and one.steps != other.steps:
                yield ours, theirs
