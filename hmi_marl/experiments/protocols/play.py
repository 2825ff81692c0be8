"""Play every pair of a comparison of protocols, and sum up the episodes by driver."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hmi_marl.envs.drivers import get_driver
from hmi_marl.envs.rewards import ATTENTION_TERMS, TERMS
from hmi_marl.experiments.episodes import Episodes, play_named
from hmi_marl.experiments.protocols.experiment import ALL_DRIVERS, Pair, ProtocolComparison
from hmi_marl.workers import results


@dataclass(frozen=True)
class Sums:
    """Sums over some episodes."""

    episodes: int
    crashes: int
    steps: int
    minutes: float
    """Minutes of driving."""
    alerts: int
    time_headway: float
    """Mean over episodes of the median while a vehicle is ahead [s]; NaN if there was none."""
    terms: dict[str, float]
    """Sum of each reward term."""

    @classmethod
    def of(cls, episodes: Episodes, which: NDArray[np.bool_], frequency: float) -> Sums:
        """Sum up the marked episodes."""
        headways = episodes.median_time_headway[which]
        headways = headways[np.isfinite(headways)]
        steps = int(episodes.length[which].sum())
        return cls(
            episodes=int(which.sum()),
            crashes=int(episodes.crashed[which].sum()),
            steps=steps,
            minutes=steps / frequency / 60.0,
            alerts=int(episodes.alerts[which].sum()),
            time_headway=float(headways.mean()) if len(headways) else math.nan,
            terms={name: float(values[which].sum()) for name, values in episodes.returns.items()},
        )

    @classmethod
    def join(cls, several: Iterable[Sums]) -> Sums:
        """Join one or more sums into one."""
        parts = list(several)
        known = [part for part in parts if math.isfinite(part.time_headway)]
        weights = [part.episodes for part in known]
        return cls(
            episodes=sum(part.episodes for part in parts),
            crashes=sum(part.crashes for part in parts),
            steps=sum(part.steps for part in parts),
            minutes=sum(part.minutes for part in parts),
            alerts=sum(part.alerts for part in parts),
            time_headway=(
                float(np.average([part.time_headway for part in known], weights=weights))
                if known
                else math.nan
            ),
            terms={name: sum(part.terms[name] for part in parts) for name in parts[0].terms},
        )

    def per_episode(self, names: Sequence[str] = TERMS) -> float:
        """Return the mean return of an episode, of these terms together."""
        return _ratio(sum(self.terms[name] for name in names), self.episodes)

    def per_step(self, names: Sequence[str] = TERMS) -> float:
        """Return the mean reward of a step."""
        return _ratio(sum(self.terms[name] for name in names), self.steps)

    def metrics(self) -> dict[str, float]:
        """Return every metric by name; NaN where there were no episodes."""
        return {
            "team_return": self.per_episode(),
            **{name: self.per_episode([name]) for name in TERMS},
            "attention_return": self.per_episode(ATTENTION_TERMS),
            "team_return_per_step": self.per_step(),
            "crash_rate": _ratio(self.crashes, self.episodes),
            "alerts_per_minute": _ratio(self.alerts, self.minutes),
            "length": _ratio(self.steps, self.episodes),
            "time_headway": self.time_headway,
        }


def _ratio(amount: float, count: float) -> float:
    return amount / count if count else math.nan


Played = Mapping[Pair, Mapping[str, Sums]]
"""Sums of every pair's episodes, by the driver's name and for ``ALL_DRIVERS``."""


def play_pair(settings: ProtocolComparison, folder: Path, pair: Pair) -> dict[str, Sums]:
    """Play a pair's episodes; sum them up for each driver and for ``ALL_DRIVERS``."""
    team = settings.team(pair.end_at_crash)
    runs = {run.name for run in settings.runs}
    driver, hmi = (str(folder / name) if name in runs else name for name in (pair.driver, pair.hmi))
    episodes = play_named(team, driver, hmi, settings.episodes)
    drawn = team.population.draw(episodes.seeds).as_array()
    add = partial(Sums.of, episodes, frequency=team.scene.policy_frequency)
    sums = {ALL_DRIVERS: add(np.ones(settings.episodes, np.bool_))}
    for name in settings.drivers:
        known = get_driver(name)
        sums[known.name] = add((drawn == np.array(known.traits)).all(axis=1))
    return sums


def play_all(
    settings: ProtocolComparison, folder: Path, workers: int, progress: Callable[[int], object] = id
) -> Played:
    """Play every pair; the result does not depend on ``workers``.

    Args:
        settings: the comparison.
        folder: folder of the runs.
        workers: pairs at a time.
        progress: called with the number of episodes that have just finished.
    """
    pairs, play_one = settings.pairs(), partial(play_pair, settings, folder)
    played: dict[Pair, Mapping[str, Sums]] = {}
    for pair, sums in zip(pairs, results(play_one, pairs, workers), strict=True):
        played[pair] = sums
        progress(settings.episodes)
    return played
