"""The table: HMIs in rows, drivers in columns, over seeded episodes.

Every cell plays the same seeds, so that cells differ by driver and HMI alone.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from typing import Any

import numpy as np

from hmi_marl.agents import oracle
from hmi_marl.agents.catalogue import make_driver_policy, make_hmi
from hmi_marl.agents.hmis import AttentionRule
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import PAPER_DRIVERS, get_driver
from hmi_marl.envs.rewards import RewardWeights
from hmi_marl.envs.scene import Scene
from hmi_marl.envs.streams import check_seed
from hmi_marl.evaluation import statistics
from hmi_marl.evaluation.rollout import Episodes, play
from hmi_marl.evaluation.statistics import Estimate

PAPER_HMIS = ("NoHMI", "always", "AvgHMI", "own")
EPISODES_PER_TASK = 4


@dataclass(frozen=True)
class TableConfig:
    """What to put in a table.

    Raises:
        ValueError: unknown driver, HMI, policy or world, no episodes or no workers.
    """

    drivers: tuple[str, ...] = PAPER_DRIVERS
    """Columns: lisa, marge, bart, homer, average."""
    hmis: tuple[str, ...] = PAPER_HMIS
    """Rows: NoHMI (or never), always, random[:RATE], when-distracted, AvgHMI (or average), own (or
    optimal), optimal:DRIVER, belief[:DRIVER]."""
    driver_policy: str = "rule"
    """Who steers: rule or random."""
    episodes: int = 16
    """Episodes in each cell."""
    seed: int = 0
    """Seed of the first episode; the others count on from it."""
    alert_window: int = 7
    """N, the intervention window in steps."""
    duration: float = 20.0
    """Length of an episode [s]."""
    end_at_crash: bool = True
    """Whether a crash ends the episode."""
    ai_sees_attention: bool = True
    """Whether the HMI sees d, i and c; if not, optimal HMIs work on the Bayes belief."""
    vehicles: tuple[int, int] = (1, 20)
    """Least and most other vehicles."""
    world: str = "highway"
    """Which world to drive in."""

    def __post_init__(self) -> None:
        if not self.drivers or not self.hmis:
            raise ValueError("a table needs at least one driver and one HMI")
        if self.episodes < 1:
            raise ValueError(f"a cell needs at least one episode, but got {self.episodes}")
        check_seed(self.seed)
        check_seed(self.seed + self.episodes)
        for driver in self.drivers:
            config = self.team(driver)
            make_driver_policy(self.driver_policy, config)
            for hmi in self.hmis:
                make_hmi(hmi, config)

    def team(self, driver: str) -> TeamConfig:
        """How the teams of this driver's column are set up."""
        return TeamConfig(
            driver=driver,
            ai_sees_attention=self.ai_sees_attention,
            alert_window=self.alert_window,
            duration=self.duration,
            end_at_crash=self.end_at_crash,
            scene=Scene(vehicles=self.vehicles),
        )


@dataclass(frozen=True)
class Cell:
    """One HMI with one driver."""

    driver: str
    hmi: str
    episodes: int
    steps: Estimate
    """Length of an episode in steps; a crash may end it early."""
    speed_return: Estimate
    distraction_return: Estimate
    attention_return: Estimate
    """Distraction, alert and accept-alert terms together."""
    alerts: Estimate
    """Per minute of driving."""
    crash_rate: Estimate
    """Share of episodes."""
    min_time_headway: Estimate
    """Shortest of an episode [s]."""
    exact_distraction_return: float | None
    """The exact expectation over an episode that runs its whole time; None if not known."""
    exact_distraction_return_same_steps: float | None
    """The same, over as many steps as the episodes really had."""
    optimal_distraction_return: float
    """Of the exact alert optimum for this driver, attention seen."""
    reachable_distraction_return: oracle.Reachable
    """Least and most that any alert policy can reach."""

    def as_json(self) -> dict[str, Any]:
        """Plain JSON content: ``alerts`` and ``crash_rate`` as numbers with ``*_interval``."""
        content: dict[str, Any] = {}
        for name, value in vars(self).items():
            if name in ("alerts", "crash_rate"):
                estimate = value.as_json()
                content[name] = estimate["mean"]
                content[f"{name}_interval"] = [estimate["low"], estimate["high"]]
            else:
                content[name] = value.as_json() if isinstance(value, Estimate) else value
        return content


def make_cell(config: TableConfig, driver: str, hmi: str, episodes: Episodes) -> Cell:
    """Sum up the episodes of one cell, beside what is known exactly."""
    team = config.team(driver)
    settings = (get_driver(driver), team.alert_window, team.horizon, RewardWeights())
    policy = make_hmi(hmi, team)
    exact = same_steps = None
    if isinstance(policy, AttentionRule):
        returns = oracle.evaluate(policy.alert_probability(), *settings)
        exact = returns.distraction_return
        same_steps = float(returns.distraction_return_after(episodes.length).mean())
    minutes = episodes.length / team.scene.policy_frequency / 60
    return Cell(
        driver=driver,
        hmi=hmi,
        episodes=len(episodes.seeds),
        steps=statistics.mean(episodes.length),
        speed_return=statistics.mean(episodes.returns["speed_reward"]),
        distraction_return=statistics.mean(episodes.returns["distraction"]),
        attention_return=statistics.mean(episodes.attention_return()),
        alerts=statistics.mean(episodes.alerts / minutes),
        crash_rate=statistics.share(int(episodes.crashed.sum()), len(episodes.crashed)),
        min_time_headway=statistics.mean(episodes.min_time_headway),
        exact_distraction_return=exact,
        exact_distraction_return_same_steps=same_steps,
        optimal_distraction_return=oracle.solve_alerts(*settings).distraction_return,
        reachable_distraction_return=oracle.reachable(*settings),
    )


def play_cell(config: TableConfig, driver: str, hmi: str, seeds: range) -> Episodes:
    """Some of the episodes of one cell."""
    team = config.team(driver)
    seats = make_driver_policy(config.driver_policy, team), make_hmi(hmi, team)
    return play(team, *seats, np.array(seeds, np.uint64), config.world)


def make_table(
    config: TableConfig, workers: int | None = None, progress: Callable[[int], Any] = id
) -> list[Cell]:
    """Play every cell and sum it up, row by row. The result does not depend on ``workers``.

    Args:
        config: what to put in the table.
        workers: processes to share the episodes among; the number of cores by default.
        progress: called with the number of episodes that have just been finished.
    """
    workers = os.cpu_count() or 1 if workers is None else workers
    if workers < 1:
        raise ValueError(f"there is at least one worker, but got {workers}")
    wanted = [(driver, hmi) for hmi in config.hmis for driver in config.drivers]
    played: dict[tuple[str, str], list[Episodes]] = {cell: [] for cell in wanted}
    tasks = [(cell, seeds) for cell in wanted for seeds in _chunks(config)]
    for (cell, _), episodes in zip(tasks, _play_all(config, tasks, workers), strict=True):
        played[cell].append(episodes)
        progress(len(episodes.seeds))
    return [
        make_cell(config, driver, hmi, Episodes.join(episodes))
        for (driver, hmi), episodes in played.items()
    ]


def _chunks(config: TableConfig) -> list[range]:
    end = config.seed + config.episodes
    starts = range(config.seed, end, EPISODES_PER_TASK)
    return [range(start, min(start + EPISODES_PER_TASK, end)) for start in starts]


def _play_all(
    config: TableConfig, tasks: list[tuple[tuple[str, str], range]], workers: int
) -> Iterator[Episodes]:
    if workers == 1:
        for (driver, hmi), seeds in tasks:
            yield play_cell(config, driver, hmi, seeds)
        return
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        futures: list[Future[Episodes]] = [
            pool.submit(play_cell, config, driver, hmi, seeds) for (driver, hmi), seeds in tasks
        ]
        try:
            for future in futures:
                yield future.result()
        finally:
            for future in futures:
                future.cancel()
