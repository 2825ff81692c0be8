"""Plan a comparison of protocols: its tasks, arms and runs, their training, and who plays whom."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import Any, Literal

from hmi_marl.checks import Checked, Count, OpenShare, Steps, Weight
from hmi_marl.envs.config import DRIVER, VEHICLE_AI, Duration, TeamConfig, VehicleRange
from hmi_marl.envs.drivers import PAPER_DRIVERS, get_driver
from hmi_marl.envs.streams import Seed, part_seed
from hmi_marl.experiments.episodes import driven_by, evaluation_seeds
from hmi_marl.experiments.protocols.arms import (
    ANCHORED,
    AT_BUDGET,
    AT_SHARE,
    JOINT,
    MAIN,
    ROBUST,
    SIMULTANEOUS,
    TEAM_ALONE,
    TWO_STAGE,
    UNTOLD,
    Arm,
    PlannedRun,
)
from hmi_marl.experiments.protocols.tasks import TASKS, Task
from hmi_marl.registry import unknown
from hmi_marl.training.jobs import Job
from hmi_marl.training.protocols.registry import compared
from hmi_marl.training.protocols.settings import Budget, TrainSettings
from hmi_marl.training.protocols.two_stage import TwoStage

Shares = Mapping[str, float]
"""Share of the driver's stage by arm, of one task."""
_TUNING = 1_000_000
"""Number of the first run that tries out a share: its seed is that of no run compared."""
_OF_HMI = ("hmi_reads", "rnn_hidden_dim", "sequential")
"""Settings of the vehicle AI's network, which a driver that learns alone goes without."""
RULE = "rule"
"""Driver policy that nobody has trained."""


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
    driver_shares: tuple[OpenShare, ...] = (0.5, 0.25, 0.75)
    """Shares of the steps in which the driver learns, where the seats learn one after the other. If
    there are several, each protocol takes the best of them, by a run with half of the steps, and
    tasks on which none is tried take the first."""
    rounds: Count = 4
    """Rounds of alternating."""
    anchor_kls: tuple[Weight, ...] = (0.003, 0.01, 0.03, 0.1, 0.3, 1.0)
    """Weights λ of the divergence from the two-stage driver, in human-regularised learning, with
    attention hidden."""
    partners: bool = True
    """With attention hidden also train a driver that is not told its traits, and an HMI that learns
    with a mixture of drivers."""
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
    """Episodes that driver and HMI of one run play."""
    cross_episodes: Count = 250
    """Episodes of every other pair, and of every snapshot."""
    drivers: tuple[str, ...] = PAPER_DRIVERS
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
        for values, what in (
            (self.budgets, "budgets"),
            (self.anchor_kls, "anchor_kls"),
            (self.driver_shares, "driver_shares"),
        ):
            if len(set(values)) < len(values):
                raise ValueError(f"{what} names a value twice: {values}")
        if not self.driver_shares:
            raise ValueError("driver_shares is a tuple of at least one share")
        for plan in self.plans():
            plan.jobs(Path(), plan.runs)  # checks the rest
            plan.check_drivers()

    @property
    def driver_names(self) -> tuple[str, ...]:
        """Names of the drivers."""
        return tuple(get_driver(driver).name for driver in self.drivers)

    def plans(self, shares: Mapping[str, Shares] | None = None) -> tuple[TaskPlan, ...]:
        """Return the plan of every task, with these shares of the driver's stage."""
        given = shares or {}
        return tuple(TaskPlan(self, task, given.get(task, {})) for task in self.tasks)


@dataclass(frozen=True)
class TaskPlan:
    """Plan of one task: its arms, runs and pairs."""

    settings: ComparisonSettings
    name: str
    shares: Shares = field(default_factory=dict)
    """Shares of the driver's stage that were chosen; the first of the settings for the others."""

    @property
    def task(self) -> Task:
        """The task."""
        return TASKS[self.name].value

    @property
    def steps(self) -> int:
        """Environment steps of a run, about."""
        return self.settings.steps or self.task.steps

    def team(self, end_at_crash: bool = True) -> TeamConfig:
        """Settings of the teams of an evaluation."""
        settings = self.settings
        return self.task.team(
            settings.drivers,
            duration=settings.duration,
            end_at_crash=end_at_crash,
            vehicles=settings.vehicles,
        )

    def check_drivers(self) -> None:
        """Check that every driver has an episode among those that are played.

        Raises:
            ValueError: one has none; the message says how many episodes to play.
        """
        settings = self.settings
        for field_name in ("episodes", "cross_episodes"):
            count = getattr(settings, field_name)
            for driver, which in driven_by(self.team(), evaluation_seeds(count)).items():
                if not which.any():
                    enough = 8 * len(settings.drivers)
                    raise ValueError(
                        f"{field_name} = {count}, of which {driver.name} has none; {enough} or more "
                        "have some of each"
                    )

    @property
    def protocols(self) -> tuple[str, ...]:
        """Protocols that this task allows.

        A composite policy chooses a^A by a^H_t, so it needs sequential moves; where a task says
        which moves there are, variants of a protocol with other moves are left out.
        """
        wanted = self.settings.protocols
        if not self.task.main:
            wanted = tuple(name for name in wanted if name in MAIN)
        if self.task.hidden:
            wanted = tuple(name for name in wanted if "sequential" not in compared()[name][1])
        if not self.task.sequential:
            wanted = tuple(name for name in wanted if name != JOINT)
        return wanted

    @property
    def _signals(self) -> bool:
        """Whether this is the task in which anchors and other partners are compared."""
        return self.task.hidden and self.task.sequential

    @cached_property
    def arms(self) -> dict[str, Arm]:
        """Arms by name."""
        return {arm.name: arm for arm in self._arms()}

    def _arms(self) -> Iterator[Arm]:
        settings, few = self.settings, min(self.settings.few_seeds, self.settings.seeds)
        for name in self.protocols:
            seeds = settings.seeds if name in MAIN and self.task.main else few
            yield Arm(name, name, self.steps, seeds, crossed=True)
        for name, budget in product(self.protocols, settings.budgets):
            if name in MAIN and budget < self.steps and self.task.main:
                yield Arm(AT_BUDGET.format(name, budget), name, budget, few)
        if TWO_STAGE not in self.protocols or not self.task.main:
            return
        if settings.reward == "default":
            reward = {"driver_reward": "team"}
            yield Arm(TEAM_ALONE, TWO_STAGE, self.steps, few, options=reward)
        if self._signals and SIMULTANEOUS in self.protocols:
            for weight in settings.anchor_kls:
                name = ANCHORED.format(weight)
                yield Arm(name, SIMULTANEOUS, self.steps, few, anchor_kl=weight)
        if self._signals and settings.partners:
            yield Arm(
                UNTOLD, TWO_STAGE, self.steps, few, (DRIVER,), options={"condition": "hidden"}
            )
            drivers = (*(name for name in MAIN if name in self.protocols), UNTOLD, RULE)
            yield Arm(ROBUST, TWO_STAGE, self.steps, few, (VEHICLE_AI,), partners=drivers)

    def tuning_arms(self) -> list[Arm]:
        """Arms that try out shares of the driver's stage, with half of the steps."""
        shares = self.settings.driver_shares
        if len(shares) < 2 or not self.task.main:
            return []
        steps = max(1, self.steps // 2)
        return [
            Arm(AT_SHARE.format(name, share), name, steps, 1, driver_share=share)
            for name in self.protocols
            if self._divides(name)
            for share in shares
        ]

    def _divides(self, protocol: str) -> bool:
        """Whether a protocol divides its steps among the seats."""
        kind, variant = compared()[protocol]
        shared = {**self.task.options, **variant, "num_teams": self.settings.num_teams}
        unit = self.settings.rounds * self.settings.num_teams * self.team().horizon
        one, other = (
            kind.for_comparison(Budget(k * unit, (5 - k) * unit, self.settings.rounds), **shared)
            for k in (1, 4)
        )
        return one != other

    @cached_property
    def _tried(self) -> dict[str, Arm]:
        return {arm.name: arm for arm in self.tuning_arms()}

    @property
    def tuning_runs(self) -> tuple[PlannedRun, ...]:
        """Runs that try out shares, with a seed that no other run has."""
        return tuple(PlannedRun(self.name, arm.name, _TUNING) for arm in self.tuning_arms())

    def runs_of(self, arm: str) -> tuple[PlannedRun, ...]:
        """Runs of an arm, in the order of their seeds."""
        return tuple(PlannedRun(self.name, arm, k) for k in range(self.arms[arm].seeds))

    @property
    def standing_runs(self) -> tuple[PlannedRun, ...]:
        """Runs in which a crash does not end the episode."""
        wanted = self.settings.crash_check and self.name == self.settings.tasks[0]
        names = self.protocols if wanted else ()
        return tuple(PlannedRun(self.name, name, 0, standing=True) for name in names)

    @property
    def runs(self) -> tuple[PlannedRun, ...]:
        """All runs but those that try out shares."""
        main = (run for arm in self.arms for run in self.runs_of(arm))
        return (*main, *self.standing_runs)

    def waves(self) -> list[list[PlannedRun]]:
        """Runs in the order of training: each wave needs those before it.

        Within a wave runs of the first seeds come first, so that whatever has been trained when
        it is cut off can be compared.
        """
        arms = self.arms
        last = max(arm.wave for arm in arms.values())
        runs = sorted(self.runs, key=lambda run: run.number)
        return [[run for run in runs if arms[run.arm].wave == wave] for wave in range(last + 1)]

    def jobs(self, folder: Path, runs: Sequence[PlannedRun]) -> list[Job]:
        """Training of these runs, in the folder of the comparison."""
        return [Job(self.training(run, folder), run.folder(folder)) for run in runs]

    def training(self, run: PlannedRun, folder: Path) -> TrainSettings:
        """Settings of a run's training."""
        settings = self.settings
        arm = self.arms.get(run.arm) or self._tried[run.arm]
        protocol, variant = compared()[arm.protocol]
        shared: dict[str, Any] = {
            **self.task.options,
            "drivers": settings.drivers,
            "seed": int(part_seed(settings.seed, run.number)),
            "end_at_crash": not run.standing,
            "num_teams": settings.num_teams,
            "duration": settings.duration,
            "vehicles": settings.vehicles,
            "snapshots": settings.snapshots if arm.crossed else 0,
            **variant,
            **arm.options,
        }
        budget = self.budget(arm)
        if arm.seats == (DRIVER,):
            alone = {name: value for name, value in shared.items() if name not in _OF_HMI}
            return TwoStage(driver_steps=budget.driver_steps, hmi_steps=0, **alone)
        if arm.seats == (VEHICLE_AI,):
            names = (self._partner(name, run.number, folder) for name in arm.partners)
            mixture = "mixture:" + ",".join(names)
            return TwoStage(driver_policy=mixture, hmi_steps=budget.steps, **shared)
        if arm.anchor_kl is not None:
            shared["anchor"] = self._partner(TWO_STAGE, run.number, folder)
            shared["anchor_kl"] = arm.anchor_kl
        return protocol.for_comparison(budget, **shared)

    def _partner(self, name: str, number: int, folder: Path) -> str:
        """Policy of an arm's run of this number; names of the catalogue stay as they are."""
        known = name in self.arms
        return str(PlannedRun(self.name, name, number).folder(folder)) if known else name

    def budget(self, arm: Arm) -> Budget:
        """Environment steps of an arm, in whole batches."""
        settings = self.settings
        share = arm.driver_share or self.shares.get(arm.protocol, settings.driver_shares[0])
        batch = settings.num_teams * self.team().horizon
        reward = None if settings.reward == "default" else settings.reward
        unit = settings.rounds * batch
        whole = max(2, round(arm.steps / unit))  # the same for every share
        driver = min(max(1, round(share * whole)), whole - 1)
        return Budget(driver * unit, (whole - driver) * unit, settings.rounds, reward, batch=batch)

    def pairs(self) -> list[Pair]:
        """List every pair that plays, each once: those of one run first."""
        arms = self.arms
        own = [run for name, arm in arms.items() if arm.whole for run in self.runs_of(name)]
        wanted = [self._pair(run, run) for run in own]
        wanted += [pair for pair in self.crossed() if not pair.own]
        for pairs in self.baselines().values():
            wanted += pairs
        for run in self.standing_runs:
            wanted += [replace(self._pair(run, run), end_at_crash=ends) for ends in (True, False)]
        return list(dict.fromkeys(wanted))

    def crossed(self) -> list[Pair]:
        """List pairs of crossed arms, by number and with the next number, and with partners.

        Run k's driver plays with the HMIs of run k and of run k + 1 of every crossed arm, so that
        conventions of one seed and of one protocol are told apart at a cost that does not grow with
        the square of the seeds.
        """
        arms = self.arms
        wanted = []
        for one, other in product(arms.values(), repeat=2):
            if self._meets(one, other):
                count = min(one.seeds, other.seeds)
                for k, step in product(range(count), (0, 1)):
                    theirs = PlannedRun(self.name, other.name, (k + step) % count)
                    wanted.append(self._pair(PlannedRun(self.name, one.name, k), theirs))
        for arm in arms.values():
            if self._signals and VEHICLE_AI in arm.seats and (arm.crossed or not arm.whole):
                wanted += [Pair(self.name, RULE, run.name) for run in self.runs_of(arm.name)]
        return list(dict.fromkeys(wanted))

    @staticmethod
    def _meets(one: Arm, other: Arm) -> bool:
        """Whether drivers of one arm play with HMIs of another."""
        if DRIVER not in one.seats or VEHICLE_AI not in other.seats:
            return False
        both = [arm.crossed or not arm.whole for arm in (one, other)]
        anchored = TWO_STAGE in (one.name, other.name) and (
            one.anchor_kl is not None or other.anchor_kl is not None
        )
        return all(both) or anchored

    def baselines(self) -> dict[str, list[Pair]]:
        """List pairs of known policies, and the two-stage driver with known HMIs, by label.

        "when-distracted" is the exact alert optimum for all of the paper's drivers.
        """
        hmis = ["never"] if self.task.hidden else ["never", "when-distracted"]
        known = {f"{RULE}, {hmi}": [Pair(self.name, RULE, hmi)] for hmi in hmis}
        if TWO_STAGE in self.protocols:
            learned = [run.name for run in self.runs_of(TWO_STAGE)]
            known |= {
                f"{TWO_STAGE}, {hmi}": [Pair(self.name, name, hmi) for name in learned]
                for hmi in hmis
            }
        return known

    def driver_terms(self, protocol: str) -> tuple[str, ...]:
        """Reward terms that the driver of a protocol learns from."""
        return self.training(PlannedRun(self.name, protocol, 0), Path()).driver_terms

    def _pair(self, driver: PlannedRun, hmi: PlannedRun) -> Pair:
        return Pair(self.name, driver.name, hmi.name)


def coarse(settings: ComparisonSettings) -> ComparisonSettings:
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
