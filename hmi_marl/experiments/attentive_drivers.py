"""Drivers without distraction, and how their driving changes as they learn.

The cautious driver perceives other vehicles nine times their size, the confident one three times;
one policy is learned for both.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hmi_marl.agents.learned.policy import find_policy
from hmi_marl.checks import Count, Steps
from hmi_marl.envs.config import DRIVER, TeamConfig
from hmi_marl.envs.drivers import Driver
from hmi_marl.envs.streams import Seed
from hmi_marl.experiments import criteria
from hmi_marl.experiments.episodes import Episodes, play_named
from hmi_marl.experiments.experiment import Agent, Place, spec
from hmi_marl.experiments.training_seeds import SeededExperiment, learned_part
from hmi_marl.files import json_value
from hmi_marl.reporting import statistics
from hmi_marl.reporting.blocks import Block, Table
from hmi_marl.reporting.statistics import UNKNOWN, Estimate
from hmi_marl.reporting.verdicts import Part, Verdict
from hmi_marl.training.jobs import Job
from hmi_marl.training.protocols.two_stage import TwoStage

CONFIDENT = Driver("confident", beta=0.0, alpha=1.0, eta=0.0, inflation=3.0)
CAUTIOUS = Driver("cautious", beta=0.0, alpha=1.0, eta=0.0, inflation=9.0)


@dataclass(frozen=True)
class DriverRow:
    """Driving of one driver after some learning."""

    driver: str
    steps: int
    """Environment steps learned from."""
    speed_return: Estimate
    """Per episode; an episode that crashes earns no more."""
    crash_rate: Estimate
    time_headway: float
    """Median over episodes of each episode's median while a vehicle is ahead [s]."""
    headway_ratio: Estimate = UNKNOWN
    """Ratio of an episode's median headway to the confident driver's in the same episode, geometric
    mean; of the cautious driver."""


@dataclass(frozen=True)
class AttentiveDrivers(SeededExperiment[list[DriverRow]]):
    """Learn to drive without distraction: speed, crashes and headway by steps.

    Raises:
        ValueError: no steps, snapshots or episodes.
    """

    steps: Steps = 18_000_000
    """Environment steps to learn from."""
    snapshots: Count = 6
    """Number of points on the way at which the policy is evaluated."""
    episodes: Count = 2000
    """Episodes of each driver at each point."""
    num_teams: Count = 512
    """Teams that train side by side."""
    seed: Seed = 0
    """Seed of the first training, from which the others are mixed."""
    seeds: Count = 5
    """Trainings of the policy."""

    name = "driver"
    files = "driver.table"  # driver.json is the card of the policy
    title = "Drivers without distraction"
    short = "Headway"
    paper = (
        "The paper models caution as perceiving others larger than they are (Sec. VI), which is to "
        "make a driver leave more headway, and prints no figures for it. Below is one policy for a "
        "confident driver (inflation 3) and a cautious one (9), neither ever distracted, as it "
        "learns."
    )

    @classmethod
    def quick(cls) -> AttentiveDrivers:
        """Make a coarse version that takes minutes."""
        return cls(steps=1_500_000, snapshots=3, episodes=400, seeds=1)

    def job(self, folder: Path) -> Job:
        """Training of one policy for both drivers."""
        settings = TwoStage(
            drivers=tuple(spec(driver) for driver in (CONFIDENT, CAUTIOUS)),
            driver_steps=self.steps,
            hmi_steps=0,
            num_teams=self.num_teams,
            seed=self.seed,
            snapshots=self.snapshots,
        )
        return Job(settings, folder)

    def learn(self, each: Sequence[tuple[AttentiveDrivers, Place]], place: Place) -> None:
        """Learn a policy for both drivers."""
        place.train([alone.job(where.folder) for alone, where in each])

    def play(self, place: Place) -> list[DriverRow]:
        """Let both drivers drive with the policy of each snapshot."""
        return [
            row
            for steps, policy in place.each(snapshots(place.folder), "snapshots")
            for row in assess(policy, steps, self.episodes)
        ]

    def numbers_of(self, results: list[DriverRow]) -> dict[str, Any]:
        """JSON content."""
        return {"rows": json_value(results)}

    def judge_of(self, results: list[DriverRow]) -> list[Verdict]:
        """Judge the drivers after all learning."""
        confident, cautious = results[-2:]
        fast = []
        for row in (confident, cautious):
            least = criteria.LEAST_SPEED_RETURN[row.driver]
            part = learned_part("speed return", row.speed_return, self.seeds, above=least)
            fast.append(Verdict(f"{row.driver}: speed return of at least {least:.0f}", (part,)))
        most, crashes = criteria.MOST_CRASHES, confident.crash_rate
        few = learned_part(
            "crash rate", crashes, self.seeds, alone=Part.share, below=most, form="z.2%"
        )
        keeps = headway_part(cautious.headway_ratio, self.seeds)
        return [
            *fast,
            Verdict(f"confident: crashes under {100 * most:.0f} %", (few,)),
            Verdict(f"cautious: keep {criteria.LEAST_HEADWAY_RATIO} times the headway", (keeps,)),
        ]

    def blocks_of(self, results: list[DriverRow]) -> Sequence[Block]:
        """Table of both drivers at every snapshot."""
        columns: dict[str, Callable[[DriverRow], str]] = {
            "million steps": lambda row: f"{row.steps / 1e6:.2f}",
            "driver": lambda row: row.driver,
            "speed return": lambda row: row.speed_return.shown(),
            "crashes [%]": lambda row: row.crash_rate.percent(),
            "median headway [s]": lambda row: f"{row.time_headway:.2f}",
            "times the confident one's": lambda row: (
                row.headway_ratio.shown(".2f") if row.headway_ratio.count else ""
            ),
        }
        return [Table.of("As they learn", results, columns, sources=["/rows"])]

    def agents(self, place: Place) -> list[Agent]:
        """Policy of the drivers without distraction."""
        what = "drives without distraction, confidently or cautiously"
        return [Agent("attentive-driver", find_policy(place.folder, DRIVER), what)]


def headway_part(ratio: Estimate, seeds: int = 1) -> Part:
    """State that the cautious driver keeps more headway than the confident one."""
    least = criteria.LEAST_HEADWAY_RATIO
    what = "headway, times the confident driver's"
    return learned_part(what, ratio, seeds, alone=Part.ratio, above=least, form="z.2f")


def assess(policy: Path, steps: int, episodes: int) -> list[DriverRow]:
    """Let both drivers drive with a learned policy, without alerts, in the same episodes."""
    played = {
        driver: play_named(TeamConfig(driver=driver), str(policy), "never", episodes)
        for driver in (CONFIDENT, CAUTIOUS)
    }
    return [
        _row(driver, steps, found, played[CONFIDENT] if driver == CAUTIOUS else None)
        for driver, found in played.items()
    ]


def _row(driver: Driver, steps: int, played: Episodes, confident: Episodes | None) -> DriverRow:
    headways = played.median_time_headway
    return DriverRow(
        driver=driver.name,
        steps=steps,
        speed_return=statistics.mean(played.returns["speed_reward"]),
        crash_rate=statistics.share(int(played.crashed.sum()), len(headways)),
        time_headway=float(np.median(headways[np.isfinite(headways)])),
        headway_ratio=UNKNOWN
        if confident is None
        else statistics.geometric_ratio(headways, confident.median_time_headway),
    )


def snapshots(folder: Path) -> list[tuple[int, Path]]:
    """List the policies kept on the way, with the steps that they learned from."""
    kept = (path for path in (folder / "snapshots").iterdir() if path.name.isdigit())
    return sorted((int(path.name), path) for path in kept)
