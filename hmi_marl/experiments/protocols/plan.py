"""Settings of a comparison of protocols: its tasks, arms and sizes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, TypeVar

from hmi_marl.checks import Checked, Count, OpenShare, Steps, Weight
from hmi_marl.envs.config import Duration, VehicleRange
from hmi_marl.envs.drivers import PAPER_DRIVERS, DriverName, get_driver
from hmi_marl.envs.streams import Seed
from hmi_marl.experiments.protocols.arms import MAIN
from hmi_marl.experiments.protocols.task_plan import TaskPlan
from hmi_marl.experiments.protocols.tasks import TASKS
from hmi_marl.registry import unknown
from hmi_marl.training.protocols.registry import compared

S = TypeVar("S", bound="ComparisonSettings")


@dataclass(frozen=True)
class ComparisonSettings(Checked):
    """Settings of a comparison of protocols.

    Raises:
        ValueError, TypeError: a value out of its range, saying what to use instead.
    """

    tasks: tuple[str, ...] = ("seen", "hidden", "hidden-parallel")
    """Tasks: seen, hidden (attention), hidden-parallel (both agents move at the same time), and on
    request graded and fatigue (other alerts)."""
    protocols: tuple[str, ...] = field(default_factory=lambda: tuple(compared()))
    """Protocols to compare; two-stage is the reference."""
    steps: Steps | None = None
    """Environment steps of each run in all, rounded to batches, the same for every protocol. By
    default 4 million with attention seen and 8 million with attention hidden."""
    budgets: tuple[Steps, ...] = (1_000_000, 2_000_000, 4_000_000)
    """Smaller budgets that two-stage, joint and simultaneous are trained with, too."""
    seeds: Count = 10
    """Runs of two-stage, joint and simultaneous."""
    few_seeds: Count = 3
    """Runs of the others, and of each budget and each anchor."""
    seed: Seed = 0
    """Seed of the first run of each arm; those of the others are mixed from it."""
    driver_shares: tuple[OpenShare, ...] = (0.5, 0.25, 0.125, 0.75)
    """Shares of the steps in which the driver learns, where the seats learn one after the other. If
    there are several, each protocol takes the best of them, by a run with half of the steps, and
    tasks on which none is tried take the first."""
    rounds: Count = 4
    """Rounds of alternating."""
    anchor_kls: tuple[Weight, ...] = (0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 1.0)
    """Weights λ of the divergence from the two-stage driver, in human-regularised learning, with
    attention hidden."""
    partners: bool = True
    """With attention hidden also train a driver that does not see its traits, and an HMI that
    learns with a mixture of drivers."""
    reward: Literal["default", "team", "individual"] = "default"
    """Reward to learn from: each protocol's own (where the seats learn one after the other, the
    driver learns from driving and the HMI from the team's reward; where they learn together, both
    from the team's), or one for all but two-stage. With "default", two-stage is also trained with
    the team's reward in both stages."""
    crash_check: bool = True
    """Train every protocol also with end_at_crash=False, in the first task and with the first
    seed, to see whether crashing early pays."""
    snapshots: Count = 8
    """Points of the learning curves at which the policies are played."""
    episodes: Count = 1000
    """Episodes that driver and HMI of one run play, and drivers with known HMIs."""
    cross_episodes: Count = 250
    """Episodes of every other pair, and of every snapshot: the first of these."""
    drivers: tuple[DriverName, ...] = PAPER_DRIVERS
    """Drivers, one drawn for each episode: known names, or name:beta,alpha,eta,inflation."""
    num_teams: Count = 512
    """Teams that train side by side."""
    duration: Duration = 20.0
    """Length of an episode [s]."""
    vehicles: VehicleRange = (1, 20)
    """Least and most other vehicles."""

    def __post_init__(self) -> None:
        _check_names("tasks", "task", self.tasks, TASKS)
        _check_names("protocols", "protocol", self.protocols, compared())
        super().__post_init__()
        if not isinstance(self.drivers, tuple) or not self.drivers:
            raise ValueError(f"drivers is a tuple of at least one name, not {self.drivers!r}")
        names = Counter(get_driver(driver).name for driver in self.drivers)
        if names.total() > len(names):
            raise ValueError(f"drivers names {names.most_common(1)[0][0]!r} twice")
        alike: dict[tuple[float, ...], str] = {}
        for driver in map(get_driver, self.drivers):
            first = alike.setdefault(driver.traits, driver.name)
            if first != driver.name:
                raise ValueError(
                    f"drivers {first} and {driver.name} have the same traits; leave one out"
                )
        if len(set(self.budgets)) < len(self.budgets):
            raise ValueError(f"budgets names a value twice: {self.budgets}")
        for values, what in (
            (self.anchor_kls, "anchor_kls"),
            (self.driver_shares, "driver_shares"),
        ):
            if len({f"{value:g}" for value in values}) < len(values):  # as in names of folders
                raise ValueError(f"{what} names a value twice, to six digits: {values}")
        if 0.0 in self.anchor_kls:
            raise ValueError(
                "anchor_kls are weights above 0; 0 is simultaneous learning, with which the sweep "
                "over λ begins in any case"
            )
        if not self.driver_shares:
            raise ValueError("driver_shares is a tuple of at least one share")
        for plan in self.plans():
            if not plan.protocols:
                raise ValueError(
                    f"task {plan.name} allows none of {', '.join(self.protocols)}; leave it out of "
                    "--tasks, or add another to --protocols"
                )
            plan.check_steps()
            firsts = [
                plan.runs_of(arm)[0] for arm in plan.arms
            ]  # others differ in their seeds alone
            plan.jobs(Path(), [*firsts, *plan.standing_runs])  # checks the rest
            plan.check_drivers()

    @property
    def driver_names(self) -> tuple[str, ...]:
        """Names of the drivers."""
        return tuple(get_driver(driver).name for driver in self.drivers)

    def plans(self) -> tuple[TaskPlan, ...]:
        """Return the plan of every task, before shares of the driver's stage are chosen."""
        return tuple(TaskPlan(self, task) for task in self.tasks)


def coarse(settings: S) -> S:
    """Return a small comparison, with attention hidden, of the same seed.

    Raises:
        ValueError: one of its sizes was chosen.
    """
    default = ComparisonSettings()
    chosen = [name for name in QUICK if getattr(settings, name) != getattr(default, name)]
    if chosen:
        raise ValueError(f"--quick sets {', '.join(chosen)} itself; leave out one or the other")
    return replace(settings, **QUICK)


QUICK: dict[str, Any] = {
    "tasks": ("hidden",),
    "protocols": MAIN,
    "steps": 2_000_000,
    "budgets": (),
    "seeds": 2,
    "few_seeds": 1,
    "driver_shares": (0.5,),
    "anchor_kls": (0.1,),
    "partners": False,
    "crash_check": False,
    "snapshots": 4,
    "episodes": 200,
    "cross_episodes": 100,
}
"""Sizes of a small comparison."""


def _check_names(field: str, kind: str, names: Sequence[str], known: Any) -> None:
    listed = ", ".join(known)
    if isinstance(names, str) or not names:
        raise ValueError(f"{field} is a tuple of at least one of {listed}; got {names!r}")
    for name, times in Counter(names).items():
        if name not in known:
            raise ValueError(unknown(kind, name, known, "hmi-marl compare --help"))
        if times > 1:
            raise ValueError(f"{field} names {name!r} twice")
