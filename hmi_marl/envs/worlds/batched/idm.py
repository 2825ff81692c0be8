"""The Intelligent Driver Model: IDMVehicle.acceleration and desired_gap."""

from __future__ import annotations

import math

from hmi_marl.envs.worlds.batched.compiler import compiled, inlined
from hmi_marl.envs.worlds.batched.elementary import fma, fourth_power
from hmi_marl.envs.worlds.batched.lanes import clip, not_zero
from hmi_marl.envs.worlds.batched.memory import (
    COS,
    LANE,
    ROW,
    SIN,
    SPEED,
    SPEED_LIMIT,
    TARGET_SPEED,
    X,
)
from hmi_marl.envs.worlds.batched.neighbours import NO_OBJECT

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
