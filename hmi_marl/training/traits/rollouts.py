"""Driving by the learnt policy π(a | s, z), in the world that the demonstrations are from.

The policy stands for the person and their lapses together, so its action is the applied action:
the attention chain is out of play. Alerts sound as often as in the demonstrations, whatever
happens, and the policy hears them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hmi_marl.agents.hmis import RandomAlert
from hmi_marl.agents.situations import Recent
from hmi_marl.envs.config import VEHICLE_AI, TeamConfig
from hmi_marl.envs.drivers import Driver
from hmi_marl.envs.teaming import Teaming
from hmi_marl.envs.worlds import make_world
from hmi_marl.training.demonstrations import observed_layout

ATTENTIVE = Driver("attentive", beta=0.0, alpha=1.0, eta=0.0, inflation=1.0)
"""Never distracted, so that what they intend is what the car does."""


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
    """Time headway after each step [s], shape (N, T); inf if nobody is ahead."""
    crashed: NDArray[np.bool_]
    """Shape (N,)."""
    driving_return: NDArray[np.float64]
    """True driving reward of each, all five terms, shape (N,)."""


def drive(
    config: TeamConfig,
    act: Callable[[NDArray[np.float32]], NDArray[np.int64]],
    alert_rate: float,
    seeds: NDArray[np.uint64],
    threads: int | None = None,
) -> Drives:
    """Drive one episode for each seed; a crashed car stands until the time is over.

    Args:
        config: of the teams that gave the demonstrations; the driver in it does not matter.
        act: actions (N,) in situations (N, D), called once for each step.
        alert_rate: how often an alert sounds.
        seeds: of the episodes, shape (N,).
        threads: of the world; all cores by default. Does not change results.
    """
    config = replace(config, driver=ATTENTIVE, reward="driving", end_at_crash=False)
    world = make_world("batched", config.scene, len(seeds), threads)
    teaming = Teaming(config, len(seeds), world)
    alarm, recent = RandomAlert(alert_rate), Recent(len(seeds))
    teaming.reset(seeds)
    alarm.reset(seeds)
    layout = teaming.layouts[VEHICLE_AI]
    columns = layout.columns(part.name for part in observed_layout(config).parts)
    shape = config.horizon, len(seeds)
    actions, alerts = np.zeros((2, *shape), np.int64)
    speed, headway, rewards = np.zeros((3, *shape))
    x = []
    for t in range(config.horizon):
        seen = teaming.observe(VEHICLE_AI)
        alerts[t] = alarm.act(seen)
        x.append(recent.situation(seen[:, columns], alerts[t]))
        actions[t] = act(x[-1])
        teaming.intend(actions[t])
        result = teaming.step(alerts[t])
        recent.acted(actions[t])
        speed[t], headway[t] = teaming.ego.speed, teaming.time_headway()
        rewards[t] = result.rewards["driver"]
    return Drives(
        np.stack(x, axis=1),
        actions.T.copy(),
        alerts.T.copy(),
        speed.T,
        headway.T,
        teaming.ego.crashed.copy(),
        rewards.sum(axis=0),
    )
