"""Driving by the learned policy π(a | s, z), in the world of the demonstrations.

The policy stands for a person with their distraction, so its action is the applied action and the
attention chain is switched off. Alerts are drawn at the rate of the demonstrations, and the policy
observes them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hmi_marl.agents.hmis import RandomAlert
from hmi_marl.agents.learned.situations import Recent
from hmi_marl.agents.memory import Memoryless
from hmi_marl.agents.rollout import Observer, play
from hmi_marl.demonstrations.dataset import observed_layout
from hmi_marl.envs.config import DRIVER, VEHICLE_AI, TeamConfig
from hmi_marl.envs.drivers import Driver
from hmi_marl.envs.step_result import StepResult
from hmi_marl.envs.teaming import Teaming
from hmi_marl.envs.worlds import make_world

ATTENTIVE = Driver("attentive", beta=0.0, alpha=1.0, eta=0.0, inflation=1.0)
"""A driver who is never distracted, so that the intended action is the applied one."""


@dataclass(frozen=True)
class Drives:
    """N drives of T steps."""

    situations: NDArray[np.float32]
    """Shape (N, T, D)."""
    actions: NDArray[np.int64]
    """Shape (N, T)."""
    alerts: NDArray[np.int64]
    """Shape (N, T)."""
    speed: NDArray[np.float64]
    """After each step [m/s], shape (N, T)."""
    headway: NDArray[np.float64]
    """Time headway after each step [s], shape (N, T); inf if no vehicle is ahead."""
    crashed: NDArray[np.bool_]
    """Shape (N,)."""
    driving_return: NDArray[np.float64]
    """True driving return, the sum of all five terms, shape (N,)."""


def drive(
    config: TeamConfig,
    act: Callable[[NDArray[np.float32]], NDArray[np.int64]],
    alert_rate: float,
    seeds: NDArray[np.uint64],
    threads: int | None = None,
) -> Drives:
    """Drive one episode for each seed; a crashed car stands until the end of the episode.

    Args:
        config: configuration of the teams that gave the demonstrations; its driver is not used.
        act: returns actions (N,) for situations (N, D); called once in each step.
        alert_rate: share of steps with an alert.
        seeds: seeds of the episodes, shape (N,).
        threads: threads of the world; all cores by default. Does not change results.
    """
    config = replace(config, driver=ATTENTIVE, reward="driving", end_at_crash=False)
    world = make_world("batched", config.scene, len(seeds), threads)
    teaming = Teaming(config, len(seeds), world)
    imitator = _Imitator(act, teaming)
    alarm = _Alarm(alert_rate, imitator)
    teaming.reset(seeds)
    alarm.reset(seeds)
    play(teaming, imitator, alarm, [imitator])
    return imitator.drives(teaming)


class _Alarm(RandomAlert):
    """Alert at random, simultaneously with the driver, and pass the alerts on to the imitator."""

    sequential = False

    def __init__(self, rate: float, imitator: _Imitator) -> None:
        super().__init__(rate)
        self._imitator = imitator

    def act(self, observations: NDArray[np.float32]) -> NDArray[np.int64]:
        """See :meth:`hmi_marl.envs.seats.Policy.act`."""
        alerts = super().act(observations)
        self._imitator.hear(observations, alerts)
        return alerts


class _Imitator(Memoryless, Observer):
    """Drive by the policy, and record the drives."""

    def __init__(
        self, act: Callable[[NDArray[np.float32]], NDArray[np.int64]], teaming: Teaming
    ) -> None:
        seen = teaming.layouts[VEHICLE_AI]
        self._columns = seen.columns_of(observed_layout(teaming.config))
        self._act = act
        self._recent = Recent(teaming.num_teams)
        self._situations: list[NDArray[np.float32]] = []
        self._rows: list[tuple[NDArray[Any], ...]] = []

    def hear(self, observations: NDArray[np.float32], alerts: NDArray[np.int64]) -> None:
        """Take the observation and the alert as the next situation."""
        states = observations[:, self._columns]
        self._alerts = alerts
        self._situations.append(self._recent.situation(states, alerts))

    def act(self, observations: NDArray[np.float32]) -> NDArray[np.int64]:
        """Act in the latest situation; the driver's own observation is not read."""
        self._actions = self._act(self._situations[-1])
        self._recent.acted(self._actions)
        return self._actions

    def after(self, teaming: Teaming, result: StepResult) -> None:
        """Record the step."""
        speed, headway = teaming.ego.speed, teaming.time_headway()
        reward = result.rewards[DRIVER]
        self._rows.append((self._actions, self._alerts, speed, headway, reward))

    def drives(self, teaming: Teaming) -> Drives:
        """Return the record, once the episodes have ended."""
        actions, alerts, speed, headway, rewards = (
            np.stack(rows) for rows in zip(*self._rows, strict=True)
        )
        return Drives(
            np.stack(self._situations, axis=1),
            actions.T.copy(),
            alerts.T.copy(),
            speed.T,
            headway.T,
            teaming.ego.crashed.copy(),
            rewards.sum(axis=0),
        )
