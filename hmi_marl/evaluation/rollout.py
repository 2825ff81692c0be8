"""Playing seeded episodes and keeping what they were worth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hmi_marl.envs.config import DRIVER, VEHICLE_AI, TeamConfig
from hmi_marl.envs.rewards import ATTENTION_TERMS, TERMS
from hmi_marl.envs.seats import Policy, takes_turns
from hmi_marl.envs.teaming import StepResult, Teaming
from hmi_marl.envs.worlds import World
from hmi_marl.evaluation.alert_quality import AlertJudge, AlertQuality


@dataclass(frozen=True)
class Episodes:
    """What E episodes came to. Arrays have shape (E,)."""

    seeds: NDArray[np.uint64]
    length: NDArray[np.int64]
    """Steps."""
    crashed: NDArray[np.bool_]
    alerts: NDArray[np.int64]
    distracted: NDArray[np.int64]
    """Steps with d = 1."""
    min_time_headway: NDArray[np.float64]
    """[s], inf if nobody was ever ahead."""
    median_time_headway: NDArray[np.float64]
    """[s], over the steps in which somebody was ahead; inf if nobody ever was."""
    returns: dict[str, NDArray[np.float64]]
    """Sum of each reward term."""
    alerting: AlertQuality | None = None
    """How good the alerts were, where a judge was there."""

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


def begin(
    config: TeamConfig, driver: Policy, hmi: Policy, seeds: NDArray[np.uint64], world: str | World
) -> Teaming:
    """Teams at the start of the episodes of these seeds, with both seats' policies reset."""
    teaming = Teaming(config, len(seeds), world)
    for seat in (teaming, driver, hmi):
        seat.reset(seeds)
    return teaming


def turn(teaming: Teaming, driver: Policy, hmi: Policy) -> StepResult:
    """One step, in which the driver acts first and the HMI sees it.

    An HMI that has learnt to act at once with the driver does so: it sees a^H_{t-1}.
    """
    if takes_turns(hmi):
        teaming.intend(driver.act(teaming.observe(DRIVER)))
        return teaming.step(hmi.act(teaming.observe(VEHICLE_AI)))
    alerts = hmi.act(teaming.observe(VEHICLE_AI))
    teaming.intend(driver.act(teaming.observe(DRIVER)))
    return teaming.step(alerts)


def play(
    config: TeamConfig,
    driver: Policy,
    hmi: Policy,
    seeds: ArrayLike,
    world: str = "highway",
    judge: AlertJudge | None = None,
) -> Episodes:
    """Play one episode for each seed, side by side until the last has ended.

    Args:
        config: of the teams.
        driver: policy for the driver's seat.
        hmi: policy for the vehicle AI's seat.
        seeds: shape (E,).
        world: which world to drive in.
        judge: of the alerts; none by default.
    """
    seeds = np.asarray(seeds, np.uint64)
    teaming = begin(config, driver, hmi, seeds, world)
    count = len(seeds)
    returns = {name: np.zeros(count) for name in TERMS}
    alerts, distracted = np.zeros((2, count), np.int64)
    headways = np.full((config.horizon, count), np.inf)
    alerting = None if judge is None else AlertQuality.nothing_yet(count)
    step = 0
    while not teaming.over.all():
        active, before = ~teaming.over, teaming.attention
        result = turn(teaming, driver, hmi)
        if judge is not None and alerting is not None:
            alerting = alerting.add(judge.judge(step, before, teaming.alerted), active)
        for name, values in result.terms.items():
            returns[name] += values
        alerts += active & (teaming.alerted > 0)
        distracted += active & (teaming.attention.distracted == 1)
        headways[step] = np.where(active, teaming.time_headway(), np.inf)
        step += 1
    return Episodes(
        seeds,
        teaming.steps.copy(),
        teaming.ego.crashed.copy(),
        alerts,
        distracted,
        headways.min(axis=0),
        _medians(headways),
        returns,
        alerting,
    )


def _medians(headways: NDArray[np.float64]) -> NDArray[np.float64]:
    """The median over steps of the finite values of each column of (steps, E); inf if none."""
    ordered = np.sort(headways, axis=0)
    known = np.isfinite(ordered).sum(axis=0)
    below, above = np.maximum(known - 1, 0) // 2, known // 2
    columns = np.arange(ordered.shape[1])
    return 0.5 * ordered[below, columns] + 0.5 * ordered[above, columns]
