"""Decisions of the traffic: gaps by the Intelligent Driver Model, lane changes by MOBIL.

These are IDMVehicle's acceleration, desired_gap, change_lane_policy and mobil.
"""

from __future__ import annotations

import math

from hmi_marl.envs.worlds.batched.compiler import compiled, inlined
from hmi_marl.envs.worlds.batched.elementary import fma, fourth_power
from hmi_marl.envs.worlds.batched.lanes import clip, is_reachable, not_zero
from hmi_marl.envs.worlds.batched.memory import (
    BC,
    COS,
    LANE,
    LEFT,
    MERGING,
    RIGHT,
    ROW,
    SEGMENT,
    SIN,
    SPEED,
    SPEED_LIMIT,
    TARGET_LANE,
    TARGET_SPEED,
    TIMER,
    VEHICLES,
    X,
    Y,
)
from hmi_marl.envs.worlds.batched.neighbours import NO_OBJECT, front_of, rear_of

COMFORT_ACC_MAX = 3.0
ACC_MAX = 6.0
DISTANCE_WANTED = 10.0
TIME_WANTED = 1.5
SLOW = 15.0
_TWICE_ROOT_AB = 2 * math.sqrt(3.0 * 5.0)


@compiled
def desired_gap(f, v, front):
    """Gap that vehicle v wants to ``front`` [m]."""
    dvx = f[SPEED, v] * f[COS, v] - f[SPEED, front] * f[COS, front]
    dvy = f[SPEED, v] * f[SIN, v] - f[SPEED, front] * f[SIN, front]
    dv = fma(dvy, f[SIN, v], dvx * f[COS, v])
    speed = f[SPEED, v]
    return DISTANCE_WANTED + speed * TIME_WANTED + speed * dv / _TWICE_ROOT_AB


@inlined
def every_bit_counts(f, i, table, v):
    """Whether the vehicle might stop, where rounding errors grow: on the ramp, or slow."""
    return table[i[LANE, v], ROW] < 0 or f[SPEED, v] < SLOW


@compiled
def acceleration(f, i, lanes, table, v, front):
    """Acceleration of vehicle v behind ``front`` (or NO_OBJECT) [m/s²]."""
    wanted = clip(f[TARGET_SPEED, v], 0.0, lanes[i[LANE, v], SPEED_LIMIT])
    ratio = max(f[SPEED, v], 0.0) / abs(not_zero(wanted))
    result = COMFORT_ACC_MAX * (1 - fourth_power(ratio))
    if front != NO_OBJECT:
        closeness = desired_gap(f, v, front) / not_zero(f[X, front] - f[X, v])
        result -= COMFORT_ACC_MAX * (closeness * closeness)
    return result


LANE_CHANGE_DELAY = 1.0
MAX_BRAKING_IMPOSED = 2.0
MIN_ACC_GAIN = 0.2


@inlined
def _same_road(table, lane, other):
    a, b = table[lane, SEGMENT], table[other, SEGMENT]
    return a == b or (a == BC and b == MERGING) or (a == MERGING and b == BC)


@compiled
def _abort_if_taken(f, i, world, v):
    """Give a lane change up if a vehicle close ahead is changing into the same lane."""
    target = i[TARGET_LANE, v]
    for other in range(world[VEHICLES]):
        if other != v and i[LANE, other] != target and i[TARGET_LANE, other] == target:
            distance = f[X, other] - f[X, v]
            if 0 < distance < desired_gap(f, v, other):
                i[TARGET_LANE, v] = i[LANE, v]
                return


@compiled
def _is_worth_it(f, i, world, lanes, table, v, lane):
    """MOBIL with politeness 0, as highway-env's traffic has it, and no planned route."""
    preceding = front_of(f, i, world, lanes, table, v, lane)
    following = rear_of(f, i, world, lanes, table, v, lane)
    if (
        following != NO_OBJECT
        and following != world[VEHICLES]  # the obstacle does not brake
        and acceleration(f, i, lanes, table, following, v) < -MAX_BRAKING_IMPOSED
    ):
        return False
    now = front_of(f, i, world, lanes, table, v, i[LANE, v])
    gain = acceleration(f, i, lanes, table, v, preceding) - acceleration(f, i, lanes, table, v, now)
    return gain >= MIN_ACC_GAIN


@compiled
def choose_lane(f, i, world, lanes, table, v):
    """Start or give up a lane change; left is tried, then right, and right wins if both pass."""
    lane = i[LANE, v]
    if lane != i[TARGET_LANE, v]:
        if _same_road(table, lane, i[TARGET_LANE, v]):
            _abort_if_taken(f, i, world, v)
        return
    if not f[TIMER, v] > LANE_CHANGE_DELAY:
        return
    f[TIMER, v] = 0.0
    for side in (table[lane, LEFT], table[lane, RIGHT]):
        if (
            side >= 0
            and is_reachable(lanes, table, side, f[X, v], f[Y, v])
            and abs(f[SPEED, v]) >= 1
            and _is_worth_it(f, i, world, lanes, table, v, side)
        ):
            i[TARGET_LANE, v] = side
