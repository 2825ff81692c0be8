"""One step of a team, without the world's part: the driver's attention, then rewards and the end.

The rules take k, which is a team's number where they are compiled and a slice of all teams in
NumPy; see :mod:`hmi_marl.envs.elementwise`. What is known about N teams stands in a few arrays with
a column for each quantity: whole numbers in ``state``, traits in ``traits``, the driven cars in
:class:`hmi_marl.envs.worlds.base.Readings`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hmi_marl.envs.alerts import Effects
from hmi_marl.envs.attention import next_attention
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import TRAIT_NAMES
from hmi_marl.envs.elementwise import choose, put_row
from hmi_marl.envs.rewards import TERMS, Weights, add_up, attention_values, driving_values, places
from hmi_marl.envs.streams import Stream, unit_draw
from hmi_marl.envs.worlds.base import CRASHED, LANE, MERGING_SLOWNESS, SPEED, VEHICLE_ACTIONS

NO_ACTION = -1
_MOVE_LEFT, _MOVE_RIGHT = VEHICLE_ACTIONS.index("move_left"), VEHICLE_ACTIONS.index("move_right")
_STREAM = np.uint64(Stream.ATTENTION)

# Columns of a state, int64 of shape (N, 9).
STEPS, INTENDED, PREVIOUS, APPLIED, ALERTED = range(5)
DISTRACTED, ACCEPTED, COUNTER, FATIGUE = range(5, 9)
COLUMNS = 9
"""STEPS: taken in the episode. INTENDED, PREVIOUS: the latest a^H and the one before it; APPLIED:
the latest v, -1 before the first. ALERTED: the latest a^A. Then d, i, c and f."""

AT_START = np.zeros(COLUMNS, np.int64)
AT_START[[INTENDED, PREVIOUS, APPLIED]] = NO_ACTION
"""State of a team at the start of an episode."""

BETA, ALPHA, ETA, INFLATION = range(len(TRAIT_NAMES))
"""Columns of traits, float64 of shape (N, 4)."""

_TERMS = len(TERMS)
OF_DRIVER, OF_VEHICLE_AI, OF_BOTH = range(_TERMS, _TERMS + 3)
SUMS = _TERMS + 3
"""Columns of rewards, float64 of shape (N, 11): each of ``TERMS``, each agent's sum, and the sum of
both agents."""
TERMINATED, TRUNCATED, ENDED, OVER = range(4)
"""Columns of ends, bool of shape (N, 4). ENDED: in this step; OVER: in this or an earlier one."""
LENGTH, ALERTS, CRASHES = range(SUMS, SUMS + 3)
TOTALS = SUMS + 3
"""Columns of totals, sums over the present episode, float64 of shape (N, 14): those of rewards,
then the number of steps and of alerts, and 1 if the car is crashed."""


def begin(
    k: Any,
    seed: Any,
    driver: NDArray[np.float64],
    start: NDArray[np.int64],
    state: NDArray[np.int64],
    traits: NDArray[np.float64],
    seeds: NDArray[np.uint64],
    over: NDArray[np.bool_],
    intent_given: NDArray[np.bool_],
    totals: NDArray[np.float64],
    no_totals: NDArray[np.float64],
) -> None:
    """Begin an episode in team k.

    Args:
        k: number of the team, or numbers of M teams.
        seed: of the episode.
        driver: traits of its driver.
        start: :data:`AT_START`.
        state, traits, seeds, over, intent_given, totals: of all teams, written into.
        no_totals: zeros.
    """
    seeds[k] = seed
    over[k] = False
    intent_given[k] = False
    put_row(state, k, 0, start)
    put_row(traits, k, 0, driver)
    put_row(totals, k, 0, no_totals)


def decide(
    k: Any,
    active: NDArray[np.bool_],
    alert: NDArray[np.int64],
    state: NDArray[np.int64],
    seeds: NDArray[np.uint64],
    traits: NDArray[np.float64],
    window: int,
    effects: Effects,
    after: NDArray[np.int64],
) -> None:
    """Count the step of team k, and fill in c_t, i_t, d_t, f_t and v_t.

    Args:
        k: number of the team.
        active: teams whose episode goes on; the others stay as they are.
        alert: a^A_t.
        state: when both agents have acted; a^H_t stands in it already.
        seeds: of the episodes.
        traits: of the drivers.
        window: N, in steps.
        effects: of the alerts.
        after: state after the step, to be filled.
    """
    on, applied, intended = active[k], state[k, APPLIED], state[k, INTENDED]
    d, i, c, f = next_attention(
        state[k, DISTRACTED],
        state[k, ACCEPTED],
        state[k, COUNTER],
        state[k, FATIGUE],
        alert[k],
        traits[k, BETA],
        traits[k, ALPHA],
        traits[k, ETA],
        unit_draw(seeds[k], _STREAM, np.uint64(state[k, STEPS])),
        window,
        effects,
    )
    keeps = (d == 1) & (applied != NO_ACTION)
    after[k, STEPS] = state[k, STEPS] + choose(on, 1, 0)
    after[k, INTENDED] = intended
    after[k, PREVIOUS] = state[k, PREVIOUS]
    after[k, APPLIED] = choose(on, choose(keeps, applied, intended), applied)
    after[k, ALERTED] = choose(on, alert[k], state[k, ALERTED])
    after[k, DISTRACTED] = choose(on, d, state[k, DISTRACTED])
    after[k, ACCEPTED] = choose(on, i, state[k, ACCEPTED])
    after[k, COUNTER] = choose(on, c, state[k, COUNTER])
    after[k, FATIGUE] = choose(on, f, state[k, FATIGUE])


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
        config.alerts.effects.strengths.copy(),  # compiled loops take what can be written to
        config.scene.lanes - 1,
        config.horizon,
        config.end_at_crash,
        *places(config.reward),
    )


def reward(
    k: Any,
    active: NDArray[np.bool_],
    alert: NDArray[np.int64],
    state: NDArray[np.int64],
    after: NDArray[np.int64],
    numbers: NDArray[np.float64],
    flags: NDArray[np.int64],
    settings: Settings,
    rewards: NDArray[np.float64],
    ends: NDArray[np.bool_],
    totals: NDArray[np.float64],
) -> None:
    """Fill in the terms, rewards and ends of team k; a team that had ended gets zeros.

    Args:
        k: number of the team.
        active: teams whose episode went on.
        alert: a^A_t.
        state, after: before the step, and after it.
        numbers, flags: readings of the driven cars after the step.
        settings: constants.
        rewards, ends: to be filled.
        totals: to be added to.
    """
    on, crashed, intended = active[k], flags[k, CRASHED] == 1, state[k, INTENDED]
    values = driving_values(
        settings.weights,
        crashed,
        numbers[k, SPEED],
        flags[k, LANE] == settings.right_lane,
        numbers[k, MERGING_SLOWNESS],
        (intended == _MOVE_LEFT) | (intended == _MOVE_RIGHT),
    ) + attention_values(
        settings.weights,
        settings.strengths[alert[k]],
        state[k, DISTRACTED],
        after[k, DISTRACTED],
    )
    driver = choose(on, add_up(values, settings.driver_terms), 0.0)
    vehicle_ai = choose(on, add_up(values, settings.vehicle_ai_terms), 0.0)
    for term in range(_TERMS):
        value = choose(on, values[term], 0.0)
        rewards[k, term] = value
        totals[k, term] += value
    rewards[k, OF_DRIVER] = driver
    rewards[k, OF_VEHICLE_AI] = vehicle_ai
    rewards[k, OF_BOTH] = driver + vehicle_ai
    totals[k, OF_DRIVER] += driver
    totals[k, OF_VEHICLE_AI] += vehicle_ai
    totals[k, OF_BOTH] += driver + vehicle_ai
    totals[k, LENGTH] += choose(on, 1.0, 0.0)
    totals[k, ALERTS] += choose(on & (alert[k] > 0), 1.0, 0.0)
    totals[k, CRASHES] = choose(crashed, 1.0, 0.0)
    terminated = on & crashed & settings.end_at_crash
    late = after[k, STEPS] >= settings.horizon
    truncated = on & np.logical_not(terminated) & late
    ends[k, TERMINATED] = terminated
    ends[k, TRUNCATED] = truncated
    ends[k, ENDED] = terminated | truncated
    ends[k, OVER] = np.logical_not(on) | terminated | truncated


class Scores(NamedTuple):
    """Rewards and ends of a step of N teams as trainers read them; see :func:`score`."""

    columns: NDArray[np.int64]
    """Columns of the rewards to hand out, shape (R,)."""
    rewards: NDArray[np.float32]
    """Shape (R, N)."""
    dones: NDArray[np.int64]
    """1 where the episode ended, else 0; shape (N,)."""
    time_outs: NDArray[np.bool_]
    """Where it ended by its time alone, shape (N,)."""


def score(k: Any, rewards: NDArray[np.float64], ends: NDArray[np.bool_], scores: Scores) -> None:
    """Fill in the scores of team k.

    Args:
        k: number of the team.
        rewards, ends: as :func:`reward` fills them in.
        scores: to be filled in.
    """
    for row in range(len(scores.columns)):
        scores.rewards[row, k] = rewards[k, scores.columns[row]]
    scores.dones[k] = choose(ends[k, ENDED], 1, 0)
    scores.time_outs[k] = ends[k, TRUNCATED]
