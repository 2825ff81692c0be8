"""Table of HMIs (rows) and drivers (columns) over seeded episodes.

All cells play the same seeds, so that they differ by driver and HMI alone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hmi_marl.agents.catalogue import make_driver_policy, make_hmi
from hmi_marl.agents.hmis import AttentionRule, OptimalAlert
from hmi_marl.agents.learned.policy import LearnedPolicy
from hmi_marl.checks import Checked, Count
from hmi_marl.envs.config import TeamConfig, TeamSettings
from hmi_marl.envs.drivers import PAPER_DRIVERS, Driver, DriverName
from hmi_marl.envs.seats import Policy
from hmi_marl.envs.streams import Seed, episode_seed
from hmi_marl.envs.worlds import check_world
from hmi_marl.exact import oracle
from hmi_marl.experiments.episodes import (
    AlertJudge,
    Episodes,
    ExactRules,
    exact_settings,
    play_episodes,
)
from hmi_marl.files import json_value
from hmi_marl.reporting import statistics
from hmi_marl.reporting.statistics import UNKNOWN, Estimate
from hmi_marl.workers import check_workers, results

PAPER_HMIS = ("NoHMI", "always", "AvgHMI", "own")
EPISODES_PER_TASK = {"highway": 4, "batched": 256}
"""Number by world; the batched one is fastest with many at once."""


@dataclass(frozen=True)
class TableSettings(TeamSettings):
    """Settings of a table, as they were typed: nothing is checked yet."""

    drivers: tuple[DriverName, ...] = PAPER_DRIVERS
    """Columns: lisa, marge, bart, homer, average, name:beta,alpha,eta,inflation, or files."""
    hmis: tuple[str, ...] = PAPER_HMIS
    """Rows: NoHMI (or never), always, random[:RATE], when-distracted, AvgHMI (or average), own (or
    optimal), optimal:DRIVER, belief[:DRIVER], the folders of trained runs, trained:NAME, or
    mixture:NAME,NAME,... of these."""
    driver_policy: str = "rule"
    """Driver policy: rule, random, the folder of a trained run, trained:NAME, or
    mixture:NAME,NAME,... of these."""
    episodes: Count = 16
    """Episodes in each cell."""
    seed: Seed = 0
    """Seed of the series of episodes: that of the first, from which the others' are mixed."""
    world: str = "highway"
    """World to drive in."""


@dataclass(frozen=True)
class TableConfig(Checked, TableSettings):
    """Settings of a table, checked.

    Raises:
        ValueError: unknown driver, HMI, policy or world, the same driver or HMI twice, no
            episodes, or seeds out of range.
        TypeError: a value of another kind.
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_names("drivers", self.drivers)
        _check_names("hmis", self.hmis)
        check_world(self.world)
        for driver in self.drivers:
            config = self.team(driver)
            make_driver_policy(self.driver_policy, config)
            for hmi in self.hmis:
                make_hmi(hmi, config)

    def seeds(self, numbers: range) -> NDArray[np.uint64]:
        """Seeds of some of the episodes, by their numbers, 0 for the first."""
        return episode_seed(self.seed, np.array(numbers))


def _check_names(field: str, names: Sequence[str]) -> None:
    if isinstance(names, str) or not all(isinstance(name, str) for name in names):
        raise TypeError(f"{field} takes a tuple of names, not {names!r}")
    if not names:
        raise ValueError(f"a table needs at least one driver and one HMI, but {field} is empty")
    plainly = [name if "/" in name else name.lower() for name in names]
    twice = [name for k, name in enumerate(names) if plainly[k] in plainly[:k]]
    if twice:
        raise ValueError(f"{field} names {twice[0]!r} twice; a table has one column or row for it")


@dataclass(frozen=True)
class Cell:
    """Results of one HMI with one driver."""

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
    """Alerts per minute of driving."""
    crash_rate: Estimate
    """Share of episodes that crash."""
    min_time_headway: Estimate
    """Shortest time headway of an episode [s]."""
    exact_distraction_return: float | None
    """Exact expectation over an episode that runs its whole time; None if not known. For a
    learned HMI that sees attention it is that of the optimum for the driver it was trained for."""
    exact_distraction_return_same_steps: float | None
    """The same, over as many steps as the episodes really had."""
    optimal_attention_return_same_steps: float
    """Attention return of the exact optimum for this driver, attention seen, over as many steps."""
    optimal_distraction_return: float
    """Distraction return of the exact optimum for this driver, attention seen."""
    reachable_distraction_return_same_steps: oracle.Reachable
    """Least and most that any alert policy can reach, over as many steps as the episodes had."""
    rule_shortfall: float
    """Loss of "the strongest alert exactly when distracted" against the exact optimum for this
    driver, over an episode that runs its whole time, in attention return."""
    share_following_rule: float | None = None
    """Share of steps in which the HMI did what that rule does; None if they were not judged."""
    share_of_gain: float | None = None
    """Share of what the best alerts, attention seen, gain over none, by exact values in every step:
    1 is the optimum, 0 no alerts; None if alerts can gain nothing or were not judged."""
    learned: bool = False
    """Whether the HMI is a learned policy."""
    distraction_minus_exact: Estimate = UNKNOWN
    """Distraction return less the exact one over as many steps, paired by episode."""
    attention_minus_optimum: Estimate = UNKNOWN
    """Attention return less the exact optimum over as many steps, paired by episode."""

    def as_json(self) -> dict[str, Any]:
        """Plain JSON content: ``alerts`` and ``crash_rate`` as numbers with ``*_interval``."""
        content: dict[str, Any] = {}
        for name, value in json_value(self).items():
            content[name] = value
            if name in ("alerts", "crash_rate"):
                content |= {name: value["mean"], f"{name}_interval": [value["low"], value["high"]]}
        name = "reachable_distraction_return_same_steps"
        return content | {name: getattr(self, name)._asdict()}


def make_cell(config: TableConfig, driver: str, hmi: str, episodes: Episodes) -> Cell:
    """Add up the episodes of one cell, and compute its exact values."""
    team = config.team(driver)
    settings, policy = exact_settings(team), make_hmi(hmi, team)
    best, rules = oracle.solve_alerts(**settings), ExactRules.of(team)
    exact = same_steps = following = lost = None
    from_exact = UNKNOWN
    rule = known_rule(policy, team)
    if rule is not None:
        returns = oracle.evaluate(rule, **settings)
        exact = returns.distraction_return
        by_episode = returns.return_after(episodes.length, ["distraction"])
        same_steps = float(by_episode.mean())
        from_exact = statistics.mean(episodes.returns["distraction"] - by_episode)
        if isinstance(policy, AttentionRule):  # which a learned HMI may have missed
            lost = rules.optimum - returns.total_return
    if episodes.alerting is not None:
        played = int(episodes.length.sum())
        following = float(episodes.alerting.followed.sum() / played)
        if lost is None:
            lost = float(episodes.alerting.lost.sum() / played * team.horizon)
    minutes = episodes.length / team.scene.policy_frequency / 60
    optimum = best.return_after(episodes.length)
    reach = oracle.reachable_by_steps(**settings)[episodes.length].mean(axis=0)
    return Cell(
        driver=driver,
        hmi=hmi,
        episodes=len(episodes.seeds),
        steps=statistics.mean(episodes.length, lowest=0.0),
        speed_return=statistics.mean(episodes.returns["speed_reward"]),
        distraction_return=statistics.mean(episodes.returns["distraction"]),
        attention_return=statistics.mean(episodes.attention_return()),
        alerts=statistics.mean(episodes.alerts / minutes, lowest=0.0),
        crash_rate=statistics.share(int(episodes.crashed.sum()), len(episodes.crashed)),
        min_time_headway=statistics.mean(episodes.min_time_headway, lowest=0.0),
        exact_distraction_return=exact,
        exact_distraction_return_same_steps=same_steps,
        optimal_attention_return_same_steps=float(optimum.mean()),
        optimal_distraction_return=best.distraction_return,
        reachable_distraction_return_same_steps=oracle.Reachable(*map(float, reach)),
        rule_shortfall=max(0.0, rules.optimum - rules.when_distracted),
        share_following_rule=following,
        share_of_gain=None if lost is None else rules.share_of_gain(lost),
        learned=isinstance(policy, LearnedPolicy),
        distraction_minus_exact=from_exact,
        attention_minus_optimum=statistics.mean(episodes.attention_return() - optimum),
    )


def known_rule(hmi: Policy, team: TeamConfig) -> NDArray[np.float64] | None:
    """Return the alert rule over (t, d, i, c) that an HMI follows, or was trained to follow.

    A learned HMI that sees attention should have become the optimum for the driver that it was
    trained for, or, trained for several, for the one at the wheel.
    """
    if isinstance(hmi, AttentionRule):
        return hmi.alert_probability()
    if not isinstance(hmi, LearnedPolicy) or "distracted" not in dict(hmi.card.reads):
        return None
    trained = hmi.card.training.get("team", {})
    here = json_value(team)
    chain = ("alert_window", "weights", "alert_strengths", "fatigue")
    same = all(trained.get(name) == here[name] for name in chain)
    if not same or trained["reward"] not in ("team", "attention"):
        return None
    trained_for = trained["driver"].get("drivers", [])
    if len(trained_for) == 1:
        return OptimalAlert(Driver(**trained_for[0]), team).alert_probability()
    return (
        None
        if team.only_driver is None
        else OptimalAlert(team.only_driver, team).alert_probability()
    )


def play_cell(config: TableConfig, driver: str, hmi: str, numbers: range) -> Episodes:
    """Play some of the episodes of one cell, by their numbers."""
    team = config.team(driver)
    seats = make_driver_policy(config.driver_policy, team), make_hmi(hmi, team)
    return play_episodes(team, *seats, config.seeds(numbers), config.world, AlertJudge(team))


def make_table(
    config: TableConfig, workers: int | None = None, progress: Callable[[int], Any] = id
) -> list[Cell]:
    """Play every cell and add it up, row by row; see :func:`play_table`."""
    played = play_table(config, workers, progress)
    return [make_cell(config, *cell, episodes) for cell, episodes in played.items()]


def play_table(
    config: TableConfig, workers: int | None = None, progress: Callable[[int], Any] = id
) -> dict[tuple[str, str], Episodes]:
    """Play every cell, by driver and HMI, row by row; the same for any number of ``workers``.

    Workers (by default as many as cores) begin by importing the script that started them: unless
    there is 1, a script that calls this needs an ``if __name__ == "__main__":`` around what it
    does. ``progress`` is called with the number of episodes that have just been finished.

    Raises:
        ValueError: workers < 1.
    """
    workers = check_workers(workers)
    wanted = [(driver, hmi) for hmi in config.hmis for driver in config.drivers]
    played: dict[tuple[str, str], list[Episodes]] = {cell: [] for cell in wanted}
    tasks = [(*cell, numbers) for cell in wanted for numbers in _chunks(config)]
    play_task = partial(_play_task, config)
    for (driver, hmi, _), episodes in zip(tasks, results(play_task, tasks, workers), strict=True):
        played[driver, hmi].append(episodes)
        progress(len(episodes.seeds))
    return {cell: Episodes.join(episodes) for cell, episodes in played.items()}


def _chunks(config: TableConfig) -> list[range]:
    """Numbers of the episodes of each task."""
    end, size = config.episodes, EPISODES_PER_TASK[config.world]
    return [range(start, min(start + size, end)) for start in range(0, end, size)]


def _play_task(config: TableConfig, task: tuple[str, str, range]) -> Episodes:
    return play_cell(config, *task)
