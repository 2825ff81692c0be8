"""Play the pairs of a comparison, and sum up their episodes by driver.

All pairs of a task play the same seeded episodes on the batched world, with the driver of each
drawn from the population.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hmi_marl.agents.catalogue import make_driver_policy, make_hmi
from hmi_marl.agents.learned.policy import LearnedPolicy, load_policy
from hmi_marl.agents.rollout import Observer
from hmi_marl.envs.config import DRIVER, VEHICLE_AI, TeamConfig
from hmi_marl.envs.streams import part_seed
from hmi_marl.envs.teaming import Teaming
from hmi_marl.experiments.episode_sums import ALL_DRIVERS, Sums, mean_metrics, ratio
from hmi_marl.experiments.episodes import (
    driven_by,
    evaluation_seeds,
    play_episodes,
    play_named,
)
from hmi_marl.experiments.protocols.arms import TWO_STAGE, PlannedRun, is_run
from hmi_marl.experiments.protocols.kept import FOLDER, Kept, Key, play_once, weights_key
from hmi_marl.experiments.protocols.pairs import Pair
from hmi_marl.experiments.protocols.snapshots import Point, points_of
from hmi_marl.experiments.protocols.task_plan import TaskPlan
from hmi_marl.experiments.references import PairScore, measure_pair
from hmi_marl.experiments.signalling import Signalling
from hmi_marl.files import json_value


@dataclass(frozen=True)
class Played:
    """Results of a pair's episodes."""

    sums: Mapping[str, Sums]
    """By driver, and for ``ALL_DRIVERS``."""
    shared: Mapping[str, Sums]
    """By driver, of the episodes that every pair of the task plays: the first ones. Pairs with
    different numbers of episodes are compared by these."""
    scores: Mapping[str, PairScore]
    """Scores between exact references over as many steps, by driver."""
    signals: Mapping[str, Signalling]
    """By driver; only of pairs of one run."""
    divergence: Mapping[str, float]
    """Divergence of the driver from the two-stage driver of the same number [nats per step], by
    driver; only of pairs of one run, where there is one."""


class Divergence(Observer):
    """Average KL(driver ‖ natural driver) over the steps of N episodes, on the driver's own way.

    Both are taken with the probabilities that they learned with, though they play the likeliest
    action.
    """

    def __init__(self, driver: LearnedPolicy, natural: LearnedPolicy) -> None:
        self._driver, self._natural = driver, natural
        self._sum: NDArray[np.float64] | float = 0.0
        self._steps: NDArray[np.int64] | int = 0

    def before(self, teaming: Teaming) -> None:
        """Add the divergence of the action that comes."""
        seen = teaming.observe(DRIVER)
        ours, theirs = self._driver.probabilities(seen), self._natural.probabilities(seen)
        apart = (ours * (_log(ours) - _log(theirs))).sum(axis=1)
        self._sum = self._sum + np.where(teaming.over, 0.0, apart)
        self._steps = self._steps + ~teaming.over

    def mean(self, which: NDArray[np.bool_]) -> float:
        """Return the mean over the steps of the marked episodes [nats]."""
        steps = np.asarray(self._steps)[which].sum()
        return ratio(float(np.asarray(self._sum)[which].sum()), float(steps))


def _log(probability: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.log(np.maximum(probability, np.finfo(np.float64).tiny))


def shared_episodes(plan: TaskPlan) -> int:
    """Count the episodes that every pair plays."""
    return min(plan.settings.episodes, plan.settings.cross_episodes)


def episodes_of(plan: TaskPlan, pair: Pair) -> int:
    """Count the episodes of a pair: all of them for one run's driver and HMI, and for known HMIs.

    These are compared with exact values; the others are many, and show which partners fit.
    """
    return plan.settings.episodes if pair.own or not pair.learned else shared_episodes(plan)


def play_pair(plan: TaskPlan, folder: Path, pair: Pair) -> Played:
    """Play a pair's episodes; sum them up for each driver and for ``ALL_DRIVERS``."""
    team, count = plan.team(pair.end_at_crash), episodes_of(plan, pair)
    driver, hmi = (_place(plan, folder, name) for name in (pair.driver, pair.hmi))
    divergence = _divergence(plan, folder, pair, team)
    observers = [] if divergence is None else [divergence]
    sequential = plan.task.sequential
    found = measure_pair(team, driver, hmi, count, sequential=sequential, observers=observers)
    drawn = driven_by(team, found.episodes.seeds)
    add = partial(Sums.of, found.episodes, frequency=team.scene.policy_frequency)
    first = np.arange(count) < shared_episodes(plan)
    return Played(
        {ALL_DRIVERS: add(np.ones(count, np.bool_))}
        | {n: add(which) for n, which in drawn.items()},
        {n: add(which & first) for n, which in drawn.items()},
        {each.driver: each for each in found.scores},
        found.signalling if pair.own else {},
        {} if divergence is None else {n: divergence.mean(which) for n, which in drawn.items()},
    )


def _natural(plan: TaskPlan, pair: Pair) -> str | None:
    """Name of the two-stage run of the same number as an own pair's, if there is one."""
    number = next((run.number for run in plan.runs if run.name == pair.driver), None)
    arm = plan.arms.get(TWO_STAGE)
    if not pair.own or number is None or arm is None or number >= arm.seeds:
        return None
    return PlannedRun(plan.name, TWO_STAGE, number).name


def _divergence(plan: TaskPlan, folder: Path, pair: Pair, team: TeamConfig) -> Divergence | None:
    """Observer of the divergence from the two-stage driver of the same number, if there is one."""
    natural = _natural(plan, pair)
    if natural is None:
        return None
    return Divergence(
        *(load_policy(_place(plan, folder, name), DRIVER, team) for name in (pair.driver, natural))
    )


def _place(plan: TaskPlan, folder: Path, name: str) -> str:
    """Policy of a run by its folder; names of the catalogue stay as they are."""
    return str(folder / name) if is_run(plan.name, name) else name


def play_all(
    plan: TaskPlan,
    pairs: Sequence[Pair],
    folder: Path,
    workers: int,
    progress: Callable[[int], object] = id,
) -> dict[Pair, Played]:
    """Play pairs of the runs in ``folder``; the result does not depend on ``workers``.

    A pair that was played before, with the same weights, settings and code, is not played again.
    ``progress`` is called with the number of pairs that have just finished.
    """
    played = {}
    keys = [_key_of_pair(plan, folder, pair) for pair in pairs]
    kept, play = Kept(folder / FOLDER, Played), partial(play_pair, plan, folder)
    for pair, result in zip(pairs, play_once(kept, play, pairs, keys, workers), strict=True):
        played[pair] = result
        progress(1)
    return played


def _key_of_pair(plan: TaskPlan, folder: Path, pair: Pair) -> Key:
    natural = _natural(plan, pair)
    return {
        "kind": "pair",
        "episodes": [episodes_of(plan, pair), shared_episodes(plan)],
        "own": pair.own,
        "natural": natural and weights_key(_place(plan, folder, natural), DRIVER),
        **_key_of_seats(
            plan,
            _place(plan, folder, pair.driver),
            _place(plan, folder, pair.hmi),
            pair.end_at_crash,
        ),
    }


def _key_of_seats(plan: TaskPlan, driver: str, hmi: str, end_at_crash: bool = True) -> Key:
    """What any result depends on: the settings of the teams, and the policies in both seats."""
    return {
        "team": json_value(plan.team(end_at_crash)),
        "sequential": plan.task.sequential,
        DRIVER: weights_key(driver, DRIVER),
        VEHICLE_AI: weights_key(hmi, VEHICLE_AI),
    }


def play_tuning(plan: TaskPlan, folder: Path, workers: int) -> Iterator[float]:
    """Yield the team return of each run that tries out a share; see :func:`play_all`."""
    runs, about = plan.tuning_runs, {"kind": "tuning", "episodes": plan.settings.episodes}
    places = [str(run.folder(folder)) for run in runs]
    keys = [{**about, **_key_of_seats(plan, place, place)} for place in places]
    play = partial(tuning_return, plan, folder)
    return play_once(Kept(folder / FOLDER, float), play, runs, keys, workers)


def tuning_return(plan: TaskPlan, folder: Path, run: PlannedRun) -> float:
    """Team return per episode of a run that tries something out.

    Its episodes are others than those by which arms are compared.
    """
    team, place = plan.team(), str(run.folder(folder))
    seats = make_driver_policy(place, team), make_hmi(place, team, plan.task.sequential)
    seeds = part_seed(evaluation_seeds(plan.settings.episodes), 1)
    episodes = play_episodes(team, *seats, seeds, "batched")
    return float(np.sum([values.mean() for values in episodes.returns.values()]))


def play_point(plan: TaskPlan, folder: Path, point: Point) -> dict[str, float]:
    """Play a run's policies as they were at a point of its learning curve; mean over drivers."""
    team, count, sequential = plan.team(), shared_episodes(plan), plan.task.sequential
    episodes = play_named(team, point.driver, point.hmi, count, sequential=sequential)
    drawn = driven_by(team, episodes.seeds)
    return mean_metrics(
        Sums.of(episodes, which, team.scene.policy_frequency) for which in drawn.values()
    )


def play_curves(
    plan: TaskPlan,
    runs: Sequence[PlannedRun],
    folder: Path,
    workers: int,
    progress: Callable[[int], object] = id,
) -> dict[str, list[tuple[int, dict[str, float]]]]:
    """Play the snapshots of runs; environment steps and metrics of each point, by the run's name.

    Every driver counts the same, as in the tables.
    """
    points = {run.name: points_of(run.folder(folder), plan.settings.snapshots) for run in runs}
    tasks = [point for each in points.values() for point in each]
    about = {"kind": "curve", "episodes": shared_episodes(plan)}
    keys = [{**about, **_key_of_seats(plan, point.driver, point.hmi)} for point in tasks]
    kept, play = Kept(folder / FOLDER, dict[str, float]), partial(play_point, plan, folder)
    played: dict[Point, dict[str, float]] = {}
    for point, metrics in zip(tasks, play_once(kept, play, tasks, keys, workers), strict=True):
        played[point] = metrics
        progress(1)
    return {name: [(p.steps, played[p]) for p in each] for name, each in points.items()}
