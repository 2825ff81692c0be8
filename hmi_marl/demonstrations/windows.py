"""Demonstrations as trait models take them: which team drove, what is held out, alerts."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hmi_marl.demonstrations.dataset import Observed, observed_layout
from hmi_marl.demonstrations.env import team_config
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.scene import Scene


def team_of(observed: Observed) -> TeamConfig:
    """How the teams were set up that gave these demonstrations; the driver in it is anybody.

    Recordings that do not tell it are taken as of the default scene, at its policy frequency.

    Raises:
        ValueError: the states are not as such a team would see them.
    """
    team = dict(observed.about.get("team", {}))
    frequency = team.get("scene", {}).get("policy_frequency", Scene().policy_frequency)
    duration = observed.actions.shape[1] / frequency
    config = team_config(team, duration=duration, end_at_crash=False)
    if observed_layout(config) != observed.layout:
        raise ValueError("the demonstrations' states are not laid out as their scene would be seen")
    if config.horizon < observed.actions.shape[1]:
        raise ValueError(
            f"a window has {observed.actions.shape[1]} steps, but an episode of this team "
            f"{config.horizon}"
        )
    return config


def alert_rate(observed: Observed) -> float:
    """How often an alert sounds in a step of these demonstrations."""
    return float(observed.alerts[observed.steps_taken].mean())


def held_out(observed: Observed, share: float) -> NDArray[np.bool_]:
    """The last windows of every driver, a share of them: never learned from. Shape (E,)."""
    number, out = observed.number, np.zeros(len(observed), np.bool_)
    for who in np.unique(observed.driver):
        theirs = observed.driver == who
        out[theirs] = number[theirs] >= round((1.0 - share) * theirs.sum())
    return out
