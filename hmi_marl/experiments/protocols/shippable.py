"""Trained pairs of a comparison that ship with the package: the first run of each protocol."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from hmi_marl.envs.config import DRIVER, VEHICLE_AI
from hmi_marl.experiments.protocols.arms import MAIN, PlannedRun
from hmi_marl.experiments.protocols.task_plan import TaskPlan
from hmi_marl.experiments.protocols.tasks import TASKS, Task

_SEATS = (DRIVER, "driver", "drives"), (VEHICLE_AI, "hmi", "alerts")
"""Seat, end of the agent's name, and what it does."""


@dataclass(frozen=True)
class TrainedSeat:
    """A trained policy that ships."""

    name: str
    """Name among the trained agents."""
    run: PlannedRun
    seat: str
    what: str
    """Description in one line."""


def shippable(plans: Iterable[TaskPlan]) -> list[TrainedSeat]:
    """List the policies of a comparison that ship, of the tasks in which a driver can signal."""
    return [each for plan in plans for each in _of_task(plan.task, plan.protocols)]


def all_shippable() -> list[TrainedSeat]:
    """List the policies of all tasks and protocols that a comparison can ship."""
    return [each for task in TASKS.values() for each in _of_task(task.value, MAIN)]


def _of_task(task: Task, protocols: Sequence[str]) -> list[TrainedSeat]:
    if not task.hidden or not task.sequential:
        return []
    return [
        TrainedSeat(
            f"{task.name}-{protocol}-{role}",
            PlannedRun(task.name, protocol, 0),
            seat,
            f"{does}, attention {task.name}, learned by {protocol}",
        )
        for protocol in MAIN
        if protocol in protocols
        for seat, role, does in _SEATS
    ]
