"""Plan of one task of a comparison: its arms, their runs and how these are trained."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hmi_marl.envs.config import DRIVER, VEHICLE_AI, TeamConfig
from hmi_marl.envs.streams import part_seed
from hmi_marl.experiments.episodes import driven_by, evaluation_seeds
from hmi_marl.experiments.protocols.arms import (
    ANCHORED,
    AT_BUDGET,
    AT_SHARE,
    JOINT,
    MAIN,
    NO_TRAITS,
    ROBUST,
    RULE,
    SIMULTANEOUS,
    TEAM_ALONE,
    TWO_STAGE,
    Arm,
    PlannedRun,
)
from hmi_marl.experiments.protocols.tasks import TASKS, Task
from hmi_marl.training.jobs import Job
from hmi_marl.training.protocols.registry import compared
from hmi_marl.training.protocols.settings import Budget, TrainSettings
from hmi_marl.training.protocols.two_stage import TwoStage
from hmi_marl.training.runs.folder import partners_of

if TYPE_CHECKING:
    from hmi_marl.experiments.protocols.plan import ComparisonSettings

Shares = Mapping[str, float]
"""Share of the driver's stage by arm, of one task."""
_TUNING = 1_000_000
"""Number of the first run that tries out a share: its seed is that of no run compared."""
_OF_HMI = ("hmi_reads", "rnn_hidden_dim", "sequential")
"""Settings of the vehicle AI's network, which a driver that learns alone goes without."""


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

    def check_steps(self) -> None:
        """Check that every arm has a batch for each seat in each round.

        So have those that try out shares of the driver's stage, with half of the steps.

        Raises:
            ValueError: one has fewer steps; the message says how many are needed.
        """
        settings = self.settings
        least = 2 * settings.rounds * settings.num_teams * self.team().horizon
        for arm in (*self.arms.values(), *self.tuning_arms.values()):
            if arm.steps < least:
                one = ", or give one of driver_shares" if arm.name in self.tuning_arms else ""
                raise ValueError(
                    f"{arm.steps:,} steps of {arm.name} in task {self.name} are fewer than a batch "
                    f"for each seat in {settings.rounds} rounds, {least:,}; raise steps and "
                    f"budgets, or lower rounds, num_teams or duration{one}"
                )

    def check_drivers(self) -> None:
        """Check that every driver has an episode among those that are played.

        Raises:
            ValueError: one has none; the message says how many episodes to play.
        """
        settings = self.settings
        for field_name in ("episodes", "cross_episodes"):
            count = getattr(settings, field_name)
            absent = self._absent(count)
            if absent:
                enough = 2 * count
                while self._absent(enough):
                    enough *= 2
                raise ValueError(
                    f"{field_name} = {count}, of which {absent[0]} has none; with {enough} each "
                    "driver has some"
                )

    def _absent(self, episodes: int) -> list[str]:
        """Names of the drivers that none of so many episodes has."""
        drawn = driven_by(self.team(), evaluation_seeds(episodes))
        return [name for name, which in drawn.items() if not which.any()]

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
    def signals(self) -> bool:
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
        if self.signals and SIMULTANEOUS in self.protocols:
            for weight in settings.anchor_kls:
                name = ANCHORED.format(weight)
                yield Arm(name, SIMULTANEOUS, self.steps, few, anchor_kl=weight)
        if self.signals and settings.partners:
            yield Arm(
                NO_TRAITS, TWO_STAGE, self.steps, few, (DRIVER,), options={"condition": "hidden"}
            )
            drivers = (*(name for name in MAIN if name in self.protocols), NO_TRAITS, RULE)
            yield Arm(ROBUST, TWO_STAGE, self.steps, few, (VEHICLE_AI,), partners=drivers)

    @cached_property
    def tuning_arms(self) -> dict[str, Arm]:
        """Arms by name that try out shares of the driver's stage, with half of the steps."""
        shares = self.settings.driver_shares
        if len(shares) < 2 or not self.task.main:
            return {}
        steps = max(1, self.steps // 2)
        tried = [
            Arm(AT_SHARE.format(name, share), name, steps, 1, driver_share=share)
            for name in self.protocols
            if self._divides(name)
            for share in shares
        ]
        return {arm.name: arm for arm in tried}

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

    @property
    def tuning_runs(self) -> tuple[PlannedRun, ...]:
        """Runs that try out shares, with a seed that no other run has."""
        return tuple(PlannedRun(self.name, arm, _TUNING) for arm in self.tuning_arms)

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

    def check_partners(self, folder: Path) -> None:
        """Check that no HMI there has learned with other partners, before anything is trained.

        It would be refused when its turn comes, after all that its partners take to learn.

        Raises:
            ValueError: one has, since then other protocols were compared.
        """
        for run in self.runs:
            place, arm = run.folder(folder), self.arms[run.arm]
            before = partners_of(place) if arm.partners else None
            names = (self._partner(name, run.number, folder) for name in arm.partners)
            now = tuple(Path(name).name for name in names)
            if before is not None and before != now:
                raise ValueError(
                    f"the HMI in {place} has learned with the drivers {', '.join(before)}, which "
                    f"were now {', '.join(now)}; choose another --out, remove the folder, or give "
                    "--no-partners"
                )

    def jobs(self, folder: Path, runs: Sequence[PlannedRun]) -> list[Job]:
        """Training of these runs, in the folder of the comparison."""
        return [Job(self.training(run, folder), run.folder(folder)) for run in runs]

    def training(self, run: PlannedRun, folder: Path) -> TrainSettings:
        """Settings of a run's training."""
        settings = self.settings
        arm = self.arms.get(run.arm) or self.tuning_arms[run.arm]
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
        return Budget.shared_out(arm.steps, share, batch, settings.rounds, reward)

    def driver_terms(self, protocol: str) -> tuple[str, ...]:
        """Reward terms that the driver of a protocol learns from."""
        return self.training(PlannedRun(self.name, protocol, 0), Path()).driver_terms
