"""HMIs that learn to give graded alerts, with fatigue and without, against the exact optimum.

Every case is one driver with one set of alerts. An HMI learns with the rule-based driver, which
costs no generality: attention, and the reward of alerts, do not depend on a^H. A crash does not end
an episode here, so that all have the same number of steps, over which the optimum is exact.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from hmi_marl.agents.hmis import strongest_alert
from hmi_marl.agents.learned.policy import find_policy
from hmi_marl.checks import Count, Steps
from hmi_marl.envs.config import VEHICLE_AI, TeamConfig
from hmi_marl.envs.streams import Seed
from hmi_marl.exact import oracle
from hmi_marl.experiments.criteria import GRADED_OPTIMUM_SHARE
from hmi_marl.experiments.episodes import exact_settings, play_named
from hmi_marl.experiments.experiment import Agent, Place
from hmi_marl.experiments.training_seeds import SeededExperiment, learned_part
from hmi_marl.files import json_value
from hmi_marl.reporting import statistics
from hmi_marl.reporting.blocks import Block, Table, Text
from hmi_marl.reporting.statistics import Estimate
from hmi_marl.reporting.verdicts import Part, Verdict
from hmi_marl.training.jobs import Job
from hmi_marl.training.protocols.settings import PPOSettings
from hmi_marl.training.protocols.two_stage import TwoStage

READS = ("time", "distracted", "accepted", "counter", "fatigue")
"""Observation parts that the optimum depends on; an HMI would have to ignore lidar and lanes."""
LEARNER = PPOSettings(
    gamma=0.99, num_learning_epochs=8, num_mini_batches=8, learning_rate=2e-3, entropy_coef=0.02
)
"""Many gradient steps on few numbers. With the defaults, a ninth as many, HMIs stay with alerting
whenever the driver is distracted, which is far from the optimum under fatigue."""
CAPTION = (
    "Attention returns per episode: of the learned HMI, of the exact optimum over the same steps, "
    "and exact of two rules: the strongest alert when distracted, and silence. share: of the "
    "optimum's gain over silence. shortfall: of the optimum's size. least: return that is asked."
)


@dataclass(frozen=True)
class Case:
    """One driver and the alerts that the HMI can give."""

    name: str
    driver: str
    strengths: tuple[float, ...]
    fatigue: tuple[int, int, float] | None = None

    @property
    def reads(self) -> tuple[str, ...]:
        """Parts of ``READS`` that this case has."""
        return READS if self.fatigue else READS[:-1]

    def describe(self) -> str:
        """Describe the case for a table."""
        strengths = " ".join(f"{strength:g}" for strength in self.strengths)
        if self.fatigue is None:
            return f"{self.driver}, {strengths}"
        levels, per_alert, effect = self.fatigue
        return f"{self.driver}, {strengths}, fatigue {levels} {per_alert} {effect:g}"


GRADES = (0.25, 0.5, 0.75, 1.0)
WEARY = (20, 5, 1.0)
CASES = (
    Case("homer-graded", "homer", GRADES),
    Case("average-graded", "average", GRADES),
    Case("homer-weary", "homer", GRADES, WEARY),
    Case("average-weary", "average", GRADES, WEARY),
    Case("average-one-weary", "average", (1.0,), WEARY),
    Case("bart-weary", "bart", GRADES, WEARY),
)


@dataclass(frozen=True)
class GradedRow:
    """Attention returns of one case, over the same episodes."""

    case: Case
    learned: Estimate
    optimal_played: Estimate
    """Policy of the exact optimum, played in the same episodes."""
    optimum: float
    """Exact optimum over as many steps."""
    strongest: float
    """Exact return of the strongest alert exactly when distracted, the optimum of one bit."""
    silent: float
    """Exact return without alerts."""
    alerts: float
    """Alerts per episode of the learned HMI."""
    optimal_alerts: tuple[float, ...]
    """Expected alerts of the optimum, by strength."""

    @property
    def share(self) -> float:
        """Share of the optimum's gain over silence that was learned."""
        return (self.learned.mean - self.silent) / (self.optimum - self.silent)

    @property
    def shortfall(self) -> float:
        """Difference to the optimum, as a share of its size."""
        return (self.optimum - self.learned.mean) / abs(self.optimum)

    @property
    def least(self) -> float:
        """Least attention return that counts as enough.

        Where the optimum is positive, a share of it; otherwise, since a share of a loss says
        little, the return at that share of the gain over silence.
        """
        start = 0.0 if self.optimum > 0 else self.silent
        return start + GRADED_OPTIMUM_SHARE * (self.optimum - start)

    def part(self, seeds: int = 1) -> Part:
        """State that enough was learned."""
        what = f"{self.case.describe()} (optimum {self.optimum:.1f})"
        return learned_part(what, self.learned, seeds, above=self.least, form="z.1f")

    def as_json(self) -> dict[str, Any]:
        """JSON content."""
        return json_value(self) | {
            "share_of_gain_over_silence": self.share,
            "shortfall": self.shortfall,
            "least": self.least,
        }


@dataclass(frozen=True)
class GradedAlerts(SeededExperiment[list[GradedRow]]):
    """Compare learned HMIs with the exact optimum: graded alerts, alert fatigue.

    Raises:
        ValueError: no steps, episodes or teams.
    """

    hmi_steps: Steps = 800_000
    """Environment steps in which each HMI learns."""
    episodes: Count = 2000
    """Episodes that each of them plays."""
    num_teams: Count = 128
    """Teams that train side by side."""
    seed: Seed = 0
    """Seed of the first training, from which the others are mixed."""
    seeds: Count = 5
    """Trainings of each HMI."""

    name = "graded"
    title = "Graded alerts, and alert fatigue"
    short = "Graded alerts"
    paper = (
        "The paper's alert is one bit, which it says can be extended to any discrete signal "
        "(Sec. IV). Below an alert has one of several strengths, and alerts that pile up may lose "
        "their effect. The optimum is exact here too."
    )

    @classmethod
    def quick(cls) -> GradedAlerts:
        """Make a coarse version of a minute, too short to reach the optimum everywhere."""
        return cls(hmi_steps=200_000, episodes=200, seeds=1)

    def training(self, case: Case) -> TwoStage:
        """Settings by which the HMI of a case learns."""
        return TwoStage(
            hmi_for=case.driver,
            driver_policy="rule",
            hmi_steps=self.hmi_steps,
            hmi_reward="attention",
            hmi_reads=case.reads,
            alert_strengths=case.strengths,
            fatigue=case.fatigue,
            end_at_crash=False,
            vehicles=(1, 1),
            condition="hidden",
            critic="own",
            ppo=LEARNER,
            num_teams=self.num_teams,
            seed=self.seed,
        )

    def team(self, case: Case) -> TeamConfig:
        """Teams of a case."""
        return self.training(case).team(case.driver, "attention")

    def settings(self) -> dict[str, Any]:
        """JSON content of the settings and the cases."""
        return super().settings() | {"cases": json_value(CASES)}

    def learn(self, each: Sequence[tuple[GradedAlerts, Place]], place: Place) -> None:
        """Learn an HMI for each case."""
        place.train(
            [
                Job(alone.training(case), where.folder / case.name)
                for alone, where in each
                for case in CASES
            ]
        )

    def play(self, place: Place) -> list[GradedRow]:
        """Play each case's HMI and the optimum in the same episodes."""
        return [self.assess(case, place.folder) for case in place.each(CASES, "cases")]

    def assess(self, case: Case, folder: Path) -> GradedRow:
        """Play the HMI that was learned for a case, and the optimum, in the same episodes."""
        team = self.team(case)
        learned, optimal = (
            play_named(team, "rule", hmi, self.episodes)
            for hmi in (str(folder / case.name), "optimal")
        )
        problem = exact_settings(team)
        best = oracle.solve_alerts(**problem)
        rule = partial(strongest_alert, team.alerts)
        steps = learned.length
        return GradedRow(
            case=case,
            learned=statistics.mean(learned.attention_return()),
            optimal_played=statistics.mean(optimal.attention_return()),
            optimum=float(best.return_after(steps).mean()),
            strongest=float(oracle.evaluate(rule(0.0, 1.0), **problem).return_after(steps).mean()),
            silent=float(oracle.evaluate(0.0, **problem).return_after(steps).mean()),
            alerts=float(learned.alerts.mean()),
            optimal_alerts=tuple(best.rate_by_strength.sum(axis=1).tolist()),
        )

    def numbers_of(self, results: list[GradedRow]) -> dict[str, Any]:
        """JSON content."""
        return {"rows": [row.as_json() for row in results]}

    def judge_of(self, results: list[GradedRow]) -> list[Verdict]:
        """Judge each learned HMI by the exact optimum."""
        return [
            Verdict(
                f"{row.case.describe()}: {100 * GRADED_OPTIMUM_SHARE:.0f} % of the exact optimum",
                (row.part(self.seeds),),
            )
            for row in results
        ]

    def blocks_of(self, results: list[GradedRow]) -> Sequence[Block]:
        """Table of every case."""
        columns: dict[str, Callable[[GradedRow], str]] = {
            "driver, strengths": lambda row: row.case.describe(),
            "learned": lambda row: row.learned.shown(),
            "optimum": lambda row: f"{row.optimum:.1f}",
            "strongest": lambda row: f"{row.strongest:.1f}",
            "silent": lambda row: f"{row.silent:.1f}",
            "share": lambda row: f"{100 * row.share:.1f} %",
            "shortfall": lambda row: f"{100 * row.shortfall:.1f} %",
            "least": lambda row: f"{row.least:.1f}",
        }
        table = Table.of("Attention returns", results, columns, sources=["/rows"])
        return [Text(CAPTION), table]

    def agents(self, place: Place) -> list[Agent]:
        """HMI of every case."""
        return [
            Agent(
                case.name,
                find_policy(place.folder / case.name, VEHICLE_AI),
                f"alerts {case.describe()}, attention seen",
            )
            for case in CASES
        ]
