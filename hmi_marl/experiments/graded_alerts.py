"""HMIs that learn to give graded alerts, with fatigue and without, beside the exact optimum.

Every case is one driver with one set of alerts. An HMI learns beside the rule-based driver, which
costs no generality: what attention does, and what alerts earn, does not depend on a^H. A crash
does not end an episode here, so that all have the same number of steps, and the optimum over that
many is exact.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from hmi_marl.agents.catalogue import make_driver_policy, make_hmi
from hmi_marl.agents.hmis import strongest_alert
from hmi_marl.checks import check_count
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import get_driver
from hmi_marl.exact import oracle
from hmi_marl.experiments.episodes import play_episodes
from hmi_marl.experiments.metrics_table.reproduction import EVALUATION_SEED
from hmi_marl.reporting import statistics
from hmi_marl.reporting.page import text_table
from hmi_marl.reporting.statistics import Estimate
from hmi_marl.training.ppo.settings import PPOSettings
from hmi_marl.training.protocols.two_stage import TwoStage
from hmi_marl.training.runs.jobs import Job

LEAST_SHARE = 0.97
"""Of the exact optimum that a learned HMI is to reach."""
READS = ("time", "distracted", "accepted", "counter", "fatigue")
"""What the optimum depends on. Lidar and lanes would only have to be ignored."""

LEARNER = PPOSettings(
    gamma=0.99, num_learning_epochs=8, num_mini_batches=8, learning_rate=2e-3, entropy_coef=0.02
)
"""Many gradient steps on few numbers. With the defaults, a ninth as many, HMIs stay with alerting
whenever the driver is distracted, which fatigue makes a bad habit."""


@dataclass(frozen=True)
class Case:
    """One driver and the alerts that there are."""

    name: str
    driver: str
    strengths: tuple[float, ...]
    fatigue: tuple[int, int, float] | None = None

    @property
    def reads(self) -> tuple[str, ...]:
        """What there is of ``READS``."""
        return READS if self.fatigue else READS[:-1]

    def describe(self) -> str:
        """For a table."""
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
class GradedSettings:
    """How large the comparison is.

    Raises:
        ValueError: no steps or no episodes.
    """

    hmi_steps: int = 800_000
    """Environment steps in which each HMI learns."""
    episodes: int = 2000
    """Episodes that each of them plays."""
    num_teams: int = 128
    """Teams that train side by side."""
    seed: int = 0
    """Of all training."""

    def __post_init__(self) -> None:
        for name in ("hmi_steps", "episodes", "num_teams"):
            check_count(name, getattr(self, name))

    def training(self, case: Case) -> TwoStage:
        """How the HMI of a case learns."""
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
        """The teams of a case."""
        return self.training(case).team(case.driver, "attention")

    def jobs(self, folder: Path) -> list[Job]:
        """A training for each case."""
        return [Job(self.training(case), folder / case.name) for case in CASES]


QUICK = GradedSettings(hmi_steps=200_000, episodes=200)
"""A coarse one, in a minute, too short to reach the optimum everywhere."""


@dataclass(frozen=True)
class GradedRow:
    """What came of one case: attention returns, over the same episodes."""

    case: Case
    learned: Estimate
    optimal_played: Estimate
    """The exact optimum's policy, played in the same episodes."""
    optimum: float
    """Exact, over as many steps."""
    strongest: float
    """Exact, of the strongest alert exactly when distracted, the optimum of one bit."""
    silent: float
    """Exact, without alerts."""
    alerts: float
    """Per episode, of the learned HMI."""
    optimal_alerts: tuple[float, ...]
    """Of the optimum, expected for each strength."""

    @property
    def share(self) -> float:
        """Of what the optimum earns more than silence: how much of it was learned."""
        return (self.learned.mean - self.silent) / (self.optimum - self.silent)

    @property
    def shortfall(self) -> float:
        """What is missing to the optimum, as a share of its size."""
        return (self.optimum - self.learned.mean) / abs(self.optimum)

    @property
    def holds(self) -> bool:
        """Whether enough was learned.

        Where the optimum is positive the return itself is held against it, otherwise, since a
        share of a loss says little, the gain over silence.
        """
        reached = 1.0 - self.shortfall if self.optimum > 0 else self.share
        return reached >= LEAST_SHARE

    def as_json(self) -> dict[str, Any]:
        """JSON content."""
        return vars(self) | {
            "case": vars(self.case),
            "learned": self.learned.as_json(),
            "optimal_played": self.optimal_played.as_json(),
            "share_of_gain_over_silence": self.share,
            "shortfall": self.shortfall,
            "holds": self.holds,
        }


def assess(settings: GradedSettings, case: Case, folder: Path) -> GradedRow:
    """Play the HMI that was learned for a case, and the optimum, in the same episodes."""
    team = settings.team(case)
    seeds = np.arange(EVALUATION_SEED, EVALUATION_SEED + settings.episodes, dtype=np.uint64)
    played = {}
    for name in (str(folder / case.name), "optimal"):
        seats = make_driver_policy("rule", team), make_hmi(name, team)
        played[name] = play_episodes(team, *seats, seeds, world="batched")
    learned, optimal = played.values()
    problem: dict[str, Any] = {
        "driver": get_driver(case.driver),
        "window": team.alert_window,
        "horizon": team.horizon,
        "strengths": team.alert_strengths,
        "fatigue": team.fatigue,
    }
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


def compare_graded(
    settings: GradedSettings, folder: Path, progress: Callable[[str], object]
) -> list[GradedRow]:
    """Assess every case; ``progress`` is told its name when it is done."""
    rows = []
    for case in CASES:
        rows.append(assess(settings, case, folder))
        progress(case.name)
    return rows


CAPTION = (
    "Attention returns per episode: of the learned HMI, of the exact optimum over the same steps, "
    "and exact of two rules: the strongest alert when distracted, and silence. share: of the "
    "optimum's gain over silence. shortfall: of the optimum's size."
)
HEAD = (
    "driver, strengths",
    "learned",
    "optimum",
    "strongest",
    "silent",
    "share",
    "shortfall",
    f"{100 * LEAST_SHARE:.0f} %",
)


def table_rows(rows: list[GradedRow]) -> list[list[str]]:
    """A line for each case."""
    return [
        [
            row.case.describe(),
            f"{row.learned.mean:.1f} [{row.learned.low:.1f}, {row.learned.high:.1f}]",
            f"{row.optimum:.1f}",
            f"{row.strongest:.1f}",
            f"{row.silent:.1f}",
            f"{100 * row.share:.1f} %",
            f"{100 * row.shortfall:.1f} %",
            "holds" if row.holds else "MISSED",
        ]
        for row in rows
    ]


def as_text(rows: list[GradedRow]) -> str:
    """For a terminal."""
    return f"{CAPTION}\n\n{text_table(HEAD, table_rows(rows))}"
