"""Costs of a comparison's arms: steps, gradient steps and time of a run."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from hmi_marl.envs.config import DRIVER
from hmi_marl.experiments.protocols.results import TaskResults
from hmi_marl.reporting.statistics import Estimate


@dataclass(frozen=True)
class Cost:
    """Costs of the runs of one arm."""

    arm: str
    steps: int
    """Environment steps of a run."""
    gradient_steps: int
    """Gradient steps of a run, of both learners where two learn at once."""
    seconds: Estimate
    """Wall time of a run, over runs [s]."""
    steps_per_second: float
    """Environment steps per second."""
    driver_alone: float
    """Share of the steps in which the driver learns alone."""


def costs_of(results: TaskResults) -> list[Cost]:
    """Return the costs of every arm."""
    found = []
    for arm in results.plan.arms:
        spent, one = results.seconds(arm), results.cost(arm)
        speed, alone = one.steps / spent.mean, _alone(results, arm)
        found.append(Cost(arm, one.steps, one.gradient_steps, spent, speed, alone))
    return found


def _alone(results: TaskResults, arm: str) -> float:
    settings = results.plan.training(results.plan.runs_of(arm)[0], Path())
    steps = [phase.iterations(settings.num_teams) for phase in settings.phases()]
    alone = [phase.seat == DRIVER for phase in settings.phases()]
    return sum(n for n, own in zip(steps, alone, strict=True) if own) / sum(steps)
