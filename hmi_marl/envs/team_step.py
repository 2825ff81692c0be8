"""One step of a team, without the world's part: the driver's attention, then rewards and the end.

Both rules take k, which is a team's number where they are compiled and a slice of all teams in
NumPy; see :mod:`hmi_marl.envs.elementwise`. They write into arrays that nobody else holds yet.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hmi_marl.envs.alerts import Effects
from hmi_marl.envs.attention import next_attention
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.elementwise import choose
from hmi_marl.envs.rewards import (
    TERMS,
    Weights,
    add_up,
    attention_values,
    driving_values,
    places,
)
from hmi_marl.envs.streams import Stream, unit_draw
from hmi_marl.envs.worlds.base import VEHICLE_ACTIONS

NO_ACTION = -1
_MOVE_LEFT, _MOVE_RIGHT = VEHICLE_ACTIONS.index("move_left"), VEHICLE_ACTIONS.index("move_right")
_ATTENTION = np.uint64(Stream.ATTENTION)
_TERMS = len(TERMS)


class Before(NamedTuple):
    """N teams when both agents have acted. Arrays have shape (N,)."""

    active: NDArray[np.bool_]
    """Teams whose episode goes on; the others stay as they are."""
    alert: NDArray[np.int64]
    """a^A_t."""
    intended: NDArray[np.int64]
    """a^H_t."""
    applied: NDArray[np.int64]
    """v_{t-1}, -1 before the first."""
    alerted: NDArray[np.int64]
    """a^A_{t-1}."""
    seeds: NDArray[np.uint64]
    steps: NDArray[np.uint64]
    distracted: NDArray[np.int64]
    accepted: NDArray[np.int64]
    counter: NDArray[np.int64]
    fatigue: NDArray[np.int64]
    beta: NDArray[np.float64]
    alpha: NDArray[np.float64]
    eta: NDArray[np.float64]


class Decided(NamedTuple):
    """What the world moves by, and attention after it; arrays of shape (N,) to be filled."""

    distracted: NDArray[np.int64]
    accepted: NDArray[np.int64]
    counter: NDArray[np.int64]
    fatigue: NDArray[np.int64]
    applied: NDArray[np.int64]
    """v_t = v_{t-1} if d_t = 1, else a^H_t."""
    alerted: NDArray[np.int64]


def decide(k: Any, before: Before, window: int, effects: Effects, decided: Decided) -> None:
    """Fill in c_t, i_t, d_t, f_t and v_t of team k."""
    active, applied = before.active[k], before.applied[k]
    d, i, c, f = next_attention(
        before.distracted[k],
        before.accepted[k],
        before.counter[k],
        before.fatigue[k],
        before.alert[k],
        before.beta[k],
        before.alpha[k],
        before.eta[k],
        unit_draw(before.seeds[k], _ATTENTION, before.steps[k]),
        window,
        effects,
    )
    decided.distracted[k] = choose(active, d, before.distracted[k])
    decided.accepted[k] = choose(active, i, before.accepted[k])
    decided.counter[k] = choose(active, c, before.counter[k])
    decided.fatigue[k] = choose(active, f, before.fatigue[k])
    carried_out = choose((d == 1) & (applied != NO_ACTION), applied, before.intended[k])
    decided.applied[k] = choose(active, carried_out, applied)
    decided.alerted[k] = choose(active, before.alert[k], before.alerted[k])


class Moved(NamedTuple):
    """N teams when the world has moved. Arrays have shape (N,)."""

    active: NDArray[np.bool_]
    steps: NDArray[np.int64]
    """Steps before this one."""
    intended: NDArray[np.int64]
    alert: NDArray[np.int64]
    distracted_before: NDArray[np.int64]
    distracted: NDArray[np.int64]
    crashed: NDArray[np.bool_]
    speed: NDArray[np.float64]
    lane: NDArray[np.int64]
    merging_slowness: NDArray[np.float64]


class Settings(NamedTuple):
    """Constants of :func:`reward`."""

    weights: Weights
    strengths: NDArray[np.float64]
    right_lane: int
    horizon: int
    end_at_crash: bool
    driver_terms: NDArray[np.int64]
    """Places in ``TERMS`` of the terms that the driver gets."""
    vehicle_ai_terms: NDArray[np.int64]


def settings_of(config: TeamConfig) -> Settings:
    """Constants of a team's settings."""
    return Settings(
        config.weights.numbers,
        config.alerts.effects.strengths,
        config.scene.lanes - 1,
        config.horizon,
        config.end_at_crash,
        *places(config.reward),
    )


class Rewarded(NamedTuple):
    """Rewards and ends of the step, to be filled. Arrays have shape (N,) unless noted."""

    terms: NDArray[np.float64]
    """Shape (8, N), in the order of ``TERMS``."""
    driver: NDArray[np.float64]
    vehicle_ai: NDArray[np.float64]
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]
    over: NDArray[np.bool_]
    steps: NDArray[np.int64]


def reward(k: Any, moved: Moved, settings: Settings, rewarded: Rewarded) -> None:
    """Fill in the terms, rewards and ends of team k; a team that had ended gets zeros."""
    active, crashed, intended = moved.active[k], moved.crashed[k], moved.intended[k]
    values = driving_values(
        settings.weights,
        crashed,
        moved.speed[k],
        moved.lane[k] == settings.right_lane,
        moved.merging_slowness[k],
        (intended == _MOVE_LEFT) | (intended == _MOVE_RIGHT),
    ) + attention_values(
        settings.weights,
        settings.strengths[moved.alert[k]],
        moved.distracted_before[k],
        moved.distracted[k],
    )
    for term in range(_TERMS):
        rewarded.terms[term, k] = choose(active, values[term], 0.0)
    rewarded.driver[k] = choose(active, add_up(values, settings.driver_terms), 0.0)
    rewarded.vehicle_ai[k] = choose(active, add_up(values, settings.vehicle_ai_terms), 0.0)
    steps = moved.steps[k] + choose(active, 1, 0)
    terminated = active & crashed & settings.end_at_crash
    truncated = active & np.logical_not(terminated) & (steps >= settings.horizon)
    rewarded.steps[k] = steps
    rewarded.terminated[k] = terminated
    rewarded.truncated[k] = truncated
    rewarded.over[k] = np.logical_not(active) | terminated | truncated
