"""Decisions of the traffic: gaps by the Intelligent Driver Model, lane changes by MOBIL.

These are IDMVehicle's acceleration, desired_gap, change_lane_policy and mobil.
"""

from __future__ import annotations

import math

from hmi_marl.envs.worlds.batched import memory as m
from hmi_marl.envs.worlds.batched.compiler import compiled, inlined
from hmi_marl.envs.worlds.batched.elementary import fma, fourth_power
from hmi_marl.envs.worlds.batched.lanes import clip, is_reachable, not_zero
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
    dvx = f[m.SPEED, v] * f[m.COS, v] - f[m.SPEED, front] * f[m.COS, front]
    dvy = f[m.SPEED, v] * f[m.SIN, v] - f[m.SPEED, front] * f[m.SIN, front]
    dv = fma(dvy, f[m.SIN, v], dvx * f[m.COS, v])
    speed = f[m.SPEED, v]
    return DISTANCE_WANTED + speed * TIME_WANTED + speed * dv / _TWICE_ROOT_AB


@inlined
def every_bit_counts(f, i, table, v):
    """Whether the vehicle might stop, where rounding errors grow: on the ramp, or slow."""
    return table[i[m.LANE, v], m.ROW] < 0 or f[m.SPEED, v] < SLOW


@compiled
def acceleration(f, i, lanes, table, v, front):
    """Acceleration of vehicle v behind ``front`` (or NO_OBJECT) [m/s²]."""
    wanted = clip(f[m.TARGET_SPEED, v], 0.0, lanes[i[m.LANE, v], m.SPEED_LIMIT])
    ratio = max(f[m.SPEED, v], 0.0) / abs(not_zero(wanted))
    result = COMFORT_ACC_MAX * (1 - fourth_power(ratio))
    if front != NO_OBJECT:
        closeness = desired_gap(f, v, front) / not_zero(f[m.X, front] - f[m.X, v])
        result -= COMFORT_ACC_MAX * (closeness * closeness)
    return result


LANE_CHANGE_DELAY = 1.0
MAX_BRAKING_IMPOSED = 2.0
MIN_ACC_GAIN = 0.2


@inlined
def _same_road(table, lane, other):
    a, b = table[lane, m.SEGMENT], table[other, m.SEGMENT]
    return a == b or (a == m.BC and b == m.MERGING) or (a == m.MERGING and b == m.BC)


@compiled
def _abort_if_taken(f, i, world, v):
    """Give a lane change up if a vehicle close ahead is changing into the same lane."""
    target = i[m.TARGET_LANE, v]
    for other in range(world[m.VEHICLES]):
        if other != v and i[m.LANE, other] != target and i[m.TARGET_LANE, other] == target:
            distance = f[m.X, other] - f[m.X, v]
            if 0 < distance < desired_gap(f, v, other):
                i[m.TARGET_LANE, v] = i[m.LANE, v]
                return


@compiled
def _is_worth_it(f, i, world, lanes, table, v, lane):
    """MOBIL with politeness 0, as highway-env's traffic has it, and no planned route."""
    preceding = front_of(f, i, world, lanes, table, v, lane)
    following = rear_of(f, i, world, lanes, table, v, lane)
    if (
        following != NO_OBJECT
        and following != world[m.VEHICLES]  # the obstacle does not brake
        and acceleration(f, i, lanes, table, following, v) < -MAX_BRAKING_IMPOSED
    ):
        return False
    now = front_of(f, i, world, lanes, table, v, i[m.LANE, v])
    gain = acceleration(f, i, lanes, table, v, preceding) - acceleration(f, i, lanes, table, v, now)
    return gain >= MIN_ACC_GAIN


@compiled
def choose_lane(f, i, world, lanes, table, v):
    """Start or give up a lane change; left is tried, then right, and right wins if both pass."""
    lane = i[m.LANE, v]
    if lane != i[m.TARGET_LANE, v]:
        if _same_road(table, lane, i[m.TARGET_LANE, v]):
            _abort_if_taken(f, i, world, v)
        return
    if not f[m.TIMER, v] > LANE_CHANGE_DELAY:
        return
    f[m.TIMER, v] = 0.0
    for side in (table[lane, m.LEFT], table[lane, m.RIGHT]):
        if (
            side >= 0
            and is_reachable(lanes, table, side, f[m.X, v], f[m.Y, v])
            and abs(f[m.SPEED, v]) >= 1
            and _is_worth_it(f, i, world, lanes, table, v, side)
        ):
            i[m.TARGET_LANE, v] = side
