"""Pairs of driver and HMI that play in one task of a comparison."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

from hmi_marl.envs.config import DRIVER, VEHICLE_AI
from hmi_marl.experiments.protocols.arms import RULE, TWO_STAGE, Arm, PlannedRun, is_run
from hmi_marl.experiments.protocols.task_plan import TaskPlan


@dataclass(frozen=True)
class Pair:
    """Driver and HMI that play together."""

    task: str
    driver: str
    """Name of a run, or of a driver policy in the catalogue."""
    hmi: str
    """Name of a run, or of an HMI in the catalogue."""
    end_at_crash: bool = True

    @property
    def own(self) -> bool:
        """Whether both are of one run."""
        return self.driver == self.hmi

    @property
    def learned(self) -> bool:
        """Whether the HMI is that of a run."""
        return is_run(self.task, self.hmi)


def own_pair(run: PlannedRun) -> Pair:
    """Pair a run's driver with its own HMI."""
    return Pair(run.task, run.name, run.name)


def all_pairs(plan: TaskPlan) -> list[Pair]:
    """List every pair that plays, each once: those of one run first."""
    whole = (arm for arm in plan.arms.values() if arm.whole)
    wanted = [own_pair(run) for arm in whole for run in plan.runs_of(arm.name)]
    wanted += [pair for pair in crossed(plan) if not pair.own]
    for pairs in baselines(plan).values():
        wanted += pairs
    for run in plan.standing_runs:
        wanted += [replace(own_pair(run), end_at_crash=ends) for ends in (True, False)]
    return list(dict.fromkeys(wanted))


def crossed(plan: TaskPlan) -> list[Pair]:
    """List pairs of crossed arms, by number and with the next number, and with partners.

    Run k's driver plays with the HMIs of run k and of run k + 1 of every crossed arm, which
    separates the conventions of a seed from those of a protocol at a cost that does not grow with
    the square of the seeds.
    """
    wanted = []
    for one, other in product(plan.arms.values(), repeat=2):
        if _meets(one, other):
            for step in (0, 1):
                wanted += pairs_of(plan, one.name, other.name, step)
    for arm in plan.arms.values():
        if plan.signals and VEHICLE_AI in arm.seats and arm.in_cross_play:
            wanted += rule_pairs(plan, arm.name)
    return list(dict.fromkeys(wanted))


def pairs_of(plan: TaskPlan, driver: str, hmi: str, step: int) -> list[Pair]:
    """Pair run k's driver with the HMI of run k + ``step``, for every k that both arms have."""
    count = min(plan.arms[driver].seeds, plan.arms[hmi].seeds)
    return [
        Pair(
            plan.name,
            PlannedRun(plan.name, driver, k).name,
            PlannedRun(plan.name, hmi, (k + step) % count).name,
        )
        for k in range(count)
    ]


def rule_pairs(plan: TaskPlan, hmi: str) -> list[Pair]:
    """Pair the rule-based driver with the HMI of every run of an arm."""
    return [Pair(plan.name, RULE, run.name) for run in plan.runs_of(hmi)]


def baselines(plan: TaskPlan) -> dict[str, list[Pair]]:
    """List pairs of known policies, and the two-stage driver with known HMIs, by label.

    "when-distracted" is the exact alert optimum for all of the paper's drivers.
    """
    hmis = ["never"] if plan.task.hidden else ["never", "when-distracted"]
    known = {f"{RULE}, {hmi}": [Pair(plan.name, RULE, hmi)] for hmi in hmis}
    if TWO_STAGE in plan.protocols:
        learned = [run.name for run in plan.runs_of(TWO_STAGE)]
        known |= {
            f"{TWO_STAGE}, {hmi}": [Pair(plan.name, name, hmi) for name in learned] for hmi in hmis
        }
    return known


def _meets(one: Arm, other: Arm) -> bool:
    """Whether drivers of one arm play with HMIs of another."""
    if DRIVER not in one.seats or VEHICLE_AI not in other.seats:
        return False
    anchored = TWO_STAGE in (one.name, other.name) and (
        one.anchor_kl is not None or other.anchor_kl is not None
    )
    return (one.in_cross_play and other.in_cross_play) or anchored
