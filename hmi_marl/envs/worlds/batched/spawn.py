"""Beginning an episode: the scene drawn from the seed, compiled, without Python."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from hmi_marl.envs import scene, streams
from hmi_marl.envs.scene import (
    EGO_START,
    EGO_START_SPEED,
    MERGING_START,
    MERGING_START_SPEED,
    MERGING_TARGET_SPEED,
)
from hmi_marl.envs.worlds.batched.compiler import compiled
from hmi_marl.envs.worlds.batched.control import nearest_speed
from hmi_marl.envs.worlds.batched.lanes import closest_lane
from hmi_marl.envs.worlds.batched.memory import (
    COS,
    FLOATS,
    INTEGERS,
    LANE,
    LENGTH,
    ORDER,
    SPEED,
    TARGET_LANE,
    TARGET_SPEED,
    TIMER,
    VEHICLES,
    X0,
    Y0,
    X,
    Y,
)
from hmi_marl.envs.worlds.batched.neighbours import sort_by_x
from hmi_marl.envs.worlds.batched.traffic import LANE_CHANGE_DELAY

_mix_bits: Any = njit(streams.mix_bits)
_place: Any = njit(scene.place)
_SCENE = np.uint64(streams.Stream.SCENE)


@compiled
def _draw(seed, counter):
    """streams.uniform of one number of the scene stream."""
    bits = _mix_bits(seed, _SCENE, np.uint64(counter))
    return np.float64(bits >> np.uint64(11)) * streams.TO_UNIT


@compiled
def _put(f, i, lanes, table, rows, v, x, y, speed):
    for field in range(FLOATS):
        f[field, v] = 0.0
    for field in range(INTEGERS):
        i[field, v] = 0
    f[X, v], f[Y, v], f[SPEED, v], f[TARGET_SPEED, v] = x, y, speed, speed
    f[COS, v] = 1.0
    f[TIMER, v] = ((x + y) * np.pi) % LANE_CHANGE_DELAY
    i[LANE, v] = closest_lane(lanes, table, rows, 3 * rows + 1, x, y, 0.0)
    i[TARGET_LANE, v] = i[LANE, v]
    i[ORDER, v] = v


@compiled
def begin(f, i, world, lanes, table, rows, speeds, seed, low, high, draws, start_lane, start):
    """Place all vehicles as draw_start does, in the initial state of highway-env's vehicles.

    Args:
        f, i, world, lanes, table: see :mod:`memory`.
        rows: main lanes.
        speeds: that the driven car chooses from.
        seed: the episode's seed, uint64.
        low, high: least and most other vehicles.
        draws, start_lane, start: room for the draws (number_of_draws(high),), the lanes (high,)
            and the places and speeds (2, high).
    """
    for counter in range(len(draws)):
        draws[counter] = _draw(seed, counter)
    merge_end = lanes[2 * rows, X0] + lanes[2 * rows, LENGTH]
    count = _place(draws, low, high, rows, merge_end, start_lane, start[0], start[1])
    _put(f, i, lanes, table, rows, 0, EGO_START, lanes[rows - 1, Y0], EGO_START_SPEED)
    f[TARGET_SPEED, 0] = speeds[nearest_speed(speeds, EGO_START_SPEED)]
    for k in range(count):
        y = lanes[start_lane[k], Y0]
        _put(f, i, lanes, table, rows, k + 1, start[0, k], y, start[1, k])
    ramp_y = lanes[3 * rows + 1, Y0]
    _put(f, i, lanes, table, rows, count + 1, MERGING_START, ramp_y, MERGING_START_SPEED)
    f[TARGET_SPEED, count + 1] = MERGING_TARGET_SPEED
    _put(f, i, lanes, table, rows, count + 2, merge_end, lanes[2 * rows, Y0], 0.0)
    world[VEHICLES] = count + 2
    sort_by_x(f, i, world, lanes, rows)
