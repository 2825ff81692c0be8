"""How drivers without distraction drive, and how that changes as they learn.

The cautious one perceives other vehicles nine times their size, the confident one three times;
one policy is learned for both.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hmi_marl.agents.catalogue import make_driver_policy, make_hmi
from hmi_marl.checks import check_count
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import Driver
from hmi_marl.experiments.episodes import play_episodes
from hmi_marl.experiments.metrics_table.reproduction import spec
from hmi_marl.reporting import statistics
from hmi_marl.reporting.page import text_table
from hmi_marl.reporting.statistics import Estimate
from hmi_marl.training.protocols.two_stage import TwoStage
from hmi_marl.training.runs.jobs import Job

CONFIDENT = Driver("confident", beta=0.0, alpha=1.0, eta=0.0, inflation=3.0)
CAUTIOUS = Driver("cautious", beta=0.0, alpha=1.0, eta=0.0, inflation=9.0)
LEAST_SPEED_RETURN = {CONFIDENT.name: 460.0, CAUTIOUS.name: 405.0}
MOST_CRASHES = 0.04
"""Of the confident driver, as a share of episodes."""
LEAST_HEADWAY_RATIO = 1.2
"""Of the cautious driver's median time headway to the confident one's."""


@dataclass(frozen=True)
class AttentiveSettings:
    """How large it is.

    Raises:
        ValueError: nothing of something.
    """

    steps: int = 18_000_000
    """Environment steps to learn from."""
    snapshots: int = 6
    """At how many points on the way to look."""
    episodes: int = 2000
    """Episodes of each driver at each point."""
    num_teams: int = 512
    """Teams that train side by side."""
    seed: int = 0
    """Of the training."""

    def __post_init__(self) -> None:
        for name in ("steps", "snapshots", "episodes"):
            check_count(name, getattr(self, name))

    def job(self, folder: Path) -> Job:
        """One policy for both drivers."""
        drivers = tuple(spec(driver) for driver in (CONFIDENT, CAUTIOUS))
        settings = TwoStage(
            drivers=drivers,
            driver_steps=self.steps,
            hmi_steps=0,
            num_teams=self.num_teams,
            seed=self.seed,
            snapshots=self.snapshots,
        )
        return Job(settings, folder)


@dataclass(frozen=True)
class Driving:
    """How one driver drives."""

    driver: str
    steps: int
    """Environment steps learned from."""
    speed_return: Estimate
    """Per episode; an episode that crashes earns no more."""
    crash_rate: Estimate
    time_headway: float
    """Median over episodes of each episode's median while somebody is ahead [s]."""

    def as_json(self) -> dict[str, Any]:
        """JSON content."""
        return vars(self) | {
            "speed_return": self.speed_return.as_json(),
            "crash_rate": self.crash_rate.as_json(),
        }


def assess(policy: Path, steps: int, driver: Driver, episodes: int, seed: int) -> Driving:
    """Let a driver drive with a learned policy, without alerts."""
    team = TeamConfig(driver=driver)
    seats = make_driver_policy(str(policy), team), make_hmi("never", team)
    seeds = np.arange(seed, seed + episodes, dtype=np.uint64)
    played = play_episodes(team, *seats, seeds, world="batched")
    headways = played.median_time_headway
    return Driving(
        driver=driver.name,
        steps=steps,
        speed_return=statistics.mean(played.returns["speed_reward"]),
        crash_rate=statistics.share(int(played.crashed.sum()), episodes),
        time_headway=float(np.median(headways[np.isfinite(headways)])),
    )


def verdicts(confident: Driving, cautious: Driving) -> dict[str, bool]:
    """What is asked of trained drivers, and whether it holds."""
    ratio = cautious.time_headway / confident.time_headway
    return {
        f"confident: speed return of at least {LEAST_SPEED_RETURN['confident']:.0f}": (
            confident.speed_return.mean >= LEAST_SPEED_RETURN["confident"]
        ),
        f"confident: crashes under {100 * MOST_CRASHES:.0f} %": (
            confident.crash_rate.mean < MOST_CRASHES
        ),
        f"cautious: speed return of at least {LEAST_SPEED_RETURN['cautious']:.0f}": (
            cautious.speed_return.mean >= LEAST_SPEED_RETURN["cautious"]
        ),
        f"cautious keep {LEAST_HEADWAY_RATIO} times the headway ({ratio:.2f})": (
            ratio >= LEAST_HEADWAY_RATIO
        ),
    }


def snapshots(folder: Path) -> list[tuple[int, Path]]:
    """The policies on the way, by the steps that they learned from."""
    kept = (path for path in (folder / "snapshots").iterdir() if path.name.isdigit())
    return sorted((int(path.name), path) for path in kept)


HEAD = ["million steps", "driver", "speed return", "crashes", "median time headway [s]"]


def table_rows(rows: list[Driving]) -> list[list[str]]:
    """A line for each driver at each point."""
    lines = []
    for row in rows:
        speed, crashes = row.speed_return, row.crash_rate
        lines.append(
            [
                f"{row.steps / 1e6:.2f}",
                row.driver,
                f"{speed.mean:.1f} [{speed.low:.1f}, {speed.high:.1f}]",
                f"{100 * crashes.mean:.1f} % [{100 * crashes.low:.1f}, {100 * crashes.high:.1f}]",
                f"{row.time_headway:.2f}",
            ]
        )
    return lines


def as_text(rows: list[Driving], verdicts: dict[str, bool]) -> str:
    """For a terminal: the table, and the verdicts at the last point."""
    told = [f"{'holds ' if holds else 'MISSED'}  {claim}" for claim, holds in verdicts.items()]
    return "\n".join([text_table(HEAD, table_rows(rows), indent=""), "", *told])
