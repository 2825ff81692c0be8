"""Play seeded episodes, and keep their lengths, returns, alerts and headways."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hmi_marl.agents.rollout import Observer, begin, play
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.rewards import ATTENTION_TERMS, TERMS
from hmi_marl.envs.seats import Policy
from hmi_marl.envs.teaming import StepResult, Teaming
from hmi_marl.experiments.alert_quality import AlertJudge, AlertQuality


@dataclass(frozen=True)
class Episodes:
    """Results of E episodes. Arrays have shape (E,)."""

    seeds: NDArray[np.uint64]
    length: NDArray[np.int64]
    """Length [steps]."""
    crashed: NDArray[np.bool_]
    alerts: NDArray[np.int64]
    distracted: NDArray[np.int64]
    """Steps with d = 1."""
    min_time_headway: NDArray[np.float64]
    """Shortest time headway [s]; inf if no vehicle was ever ahead."""
    median_time_headway: NDArray[np.float64]
    """Median over the steps with a vehicle ahead [s]; inf if there was none."""
    returns: dict[str, NDArray[np.float64]]
    """Sum of each reward term."""
    alerting: AlertQuality | None = None
    """Quality of the alerts; None without a judge."""

    def attention_return(self) -> NDArray[np.float64]:
        """Distraction, alert and accept-alert terms together."""
        return np.sum([self.returns[name] for name in ATTENTION_TERMS], axis=0)

    @classmethod
    def join(cls, several: Sequence[Episodes]) -> Episodes:
        """Put episodes together, in order."""
        joined: dict[str, Any] = {
            field.name: np.concatenate([getattr(episodes, field.name) for episodes in several])
            for field in fields(cls)
            if field.name not in ("returns", "alerting")
        }
        returns = {
            name: np.concatenate([episodes.returns[name] for episodes in several]) for name in TERMS
        }
        judged = [episodes.alerting for episodes in several if episodes.alerting is not None]
        alerting = AlertQuality.join(judged) if len(judged) == len(several) else None
        return cls(**joined, returns=returns, alerting=alerting)


class _Totals(Observer):
    """Add up the results of N episodes."""

    def __init__(self, count: int, horizon: int, judge: AlertJudge | None) -> None:
        self.returns = {name: np.zeros(count) for name in TERMS}
        self.alerts, self.distracted = np.zeros((2, count), np.int64)
        self.headways = np.full((horizon, count), np.inf)
        self.alerting = None if judge is None else AlertQuality.nothing_yet(count)
        self._judge = judge
        self._step = 0

    def before(self, teaming: Teaming) -> None:
        self._active, self._attention = ~teaming.over, teaming.attention

    def after(self, teaming: Teaming, result: StepResult) -> None:
        active, step = self._active, self._step
        if self._judge is not None and self.alerting is not None:
            judged = self._judge.judge(step, self._attention, teaming.alerted)
            self.alerting = self.alerting.add(judged, active)
        for name, values in result.terms.items():
            self.returns[name] += values
        self.alerts += active & (teaming.alerted > 0)
        self.distracted += active & (teaming.attention.distracted == 1)
        self.headways[step] = np.where(active, teaming.time_headway(), np.inf)
        self._step += 1


def play_episodes(
    config: TeamConfig,
    driver: Policy,
    hmi: Policy,
    seeds: ArrayLike,
    world: str = "highway",
    judge: AlertJudge | None = None,
) -> Episodes:
    """Play one episode for each seed, side by side until the last has ended.

    Args:
        config: settings of the teams.
        driver: policy for the driver's seat.
        hmi: policy for the vehicle AI's seat.
        seeds: shape (E,).
        world: world to drive in.
        judge: judges the alerts; by default they are not judged.
    """
    seeds = np.asarray(seeds, np.uint64)
    totals = _Totals(len(seeds), config.horizon, judge)
    teaming = play(begin(config, driver, hmi, seeds, world), driver, hmi, [totals])
    return Episodes(
        seeds,
        teaming.steps.copy(),
        teaming.ego.crashed.copy(),
        totals.alerts,
        totals.distracted,
        totals.headways.min(axis=0),
        _medians(totals.headways),
        totals.returns,
        totals.alerting,
    )


def _medians(headways: NDArray[np.float64]) -> NDArray[np.float64]:
    """Median of the finite values of each column of (steps, E); inf if there are none."""
    ordered = np.sort(headways, axis=0)
    known = np.isfinite(ordered).sum(axis=0)
    below, above = np.maximum(known - 1, 0) // 2, known // 2
    columns = np.arange(ordered.shape[1])
    return 0.5 * ordered[below, columns] + 0.5 * ordered[above, columns]
