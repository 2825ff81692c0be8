"""Steering and speed: ControlledVehicle, MDPVehicle and the traffic's IDMVehicle.act."""

from __future__ import annotations

import math

import numpy as np

from hmi_marl.envs.worlds.batched.compiler import compiled, inlined
from hmi_marl.envs.worlds.batched.elementary import arcsin, arctan, tan
from hmi_marl.envs.worlds.batched.lanes import (
    clip,
    follow_road,
    heading_at,
    is_reachable,
    lateral,
    not_zero,
    wrap_to_pi,
)
from hmi_marl.envs.worlds.batched.memory import (
    ACCELERATION,
    CAR_LENGTH,
    CRASHED,
    HEADING,
    LANE,
    LEFT,
    RIGHT,
    ROW,
    SLIP,
    SPEED,
    STEERING,
    TARGET_LANE,
    TARGET_SPEED,
    X0,
    Y0,
    X,
    Y,
)
from hmi_marl.envs.worlds.batched.neighbours import front_of
from hmi_marl.envs.worlds.batched.traffic import (
    ACC_MAX,
    acceleration,
    choose_lane,
    every_bit_counts,
)

KP_A = 1 / 0.6
KP_HEADING = 1 / 0.2
KP_LATERAL = 1 / 0.6
TAU_PURSUIT = 0.1
MAX_STEERING = math.pi / 3
MAX_SLIP = math.sqrt(3 / 7)
"""Sine of the slip angle at the largest steering angle: of the arctangent of tan(π/3) / 2."""

MOVE_LEFT, KEEP_SPEED, MOVE_RIGHT, SPEED_UP, SLOW_DOWN = range(5)


@compiled
def steer(f, i, lanes, table, v, lane):
    """steering_control towards a lane, as STEERING where every bit counts, else as SLIP.

    highway-env goes from the slip angle to a steering angle, arctan(2 tan(slip)), and in the motion
    back again. Of that detour only the limit on the steering angle can be seen.
    """
    f[SLIP, v], f[STEERING, v] = 0.0, 0.0
    if table[lane, ROW] < 0 or every_bit_counts(f, i, table, v):
        _steer_to_the_bit(f, lanes, v, lane)
        return
    r = f[Y, v] - lanes[lane, Y0]
    heading = f[HEADING, v]
    if r == 0.0 and heading == 0.0:
        return
    speed = not_zero(f[SPEED, v])
    correction = arcsin(clip(-KP_LATERAL * r / speed, -1.0, 1.0))
    rate = KP_HEADING * wrap_to_pi(clip(correction, -math.pi / 4, math.pi / 4) - heading)
    f[SLIP, v] = clip(CAR_LENGTH / 2 / speed * rate, -MAX_SLIP, MAX_SLIP)


@compiled
def _steer_to_the_bit(f, lanes, v, lane):
    """The same in highway-env's own steps."""
    s = f[X, v] - lanes[lane, X0]
    r = lateral(lanes, lane, s, f[Y, v])
    speed = not_zero(f[SPEED, v])
    correction = arcsin(clip(-KP_LATERAL * r / speed, -1.0, 1.0))
    wanted = heading_at(lanes, lane, s + f[SPEED, v] * TAU_PURSUIT)
    wanted += clip(correction, -math.pi / 4, math.pi / 4)
    rate = KP_HEADING * wrap_to_pi(wanted - f[HEADING, v])
    slip = arcsin(clip(CAR_LENGTH / 2 / speed * rate, -1.0, 1.0))
    f[STEERING, v] = clip(arctan(2 * tan(slip)), -MAX_STEERING, MAX_STEERING)


@inlined
def nearest_speed(speeds, speed):
    """MDPVehicle.speed_to_index."""
    last = len(speeds) - 1
    share = (speed - speeds[0]) / (speeds[last] - speeds[0])
    return int(clip(np.rint(share * last), 0.0, float(last)))


@compiled
def command(f, i, lanes, table, speeds, action):
    """The driven car's action, once in a policy step: MDPVehicle.act before the road acts."""
    if action == SPEED_UP or action == SLOW_DOWN:
        step = 1 if action == SPEED_UP else -1
        number = min(max(nearest_speed(speeds, f[SPEED, 0]) + step, 0), len(speeds) - 1)
        f[TARGET_SPEED, 0] = speeds[number]
    target = follow_road(lanes, table, i[TARGET_LANE, 0], f[X, 0])
    if action == MOVE_LEFT or action == MOVE_RIGHT:
        side = table[target, LEFT if action == MOVE_LEFT else RIGHT]
        if side >= 0 and is_reachable(lanes, table, side, f[X, 0], f[Y, 0]):
            target = side
    i[TARGET_LANE, 0] = target


@inlined
def act_driven(f, i, lanes, table):
    """The driven car in every simulator step."""
    target = follow_road(lanes, table, i[TARGET_LANE, 0], f[X, 0])
    i[TARGET_LANE, 0] = target
    steer(f, i, lanes, table, 0, target)
    f[ACCELERATION, 0] = KP_A * (f[TARGET_SPEED, 0] - f[SPEED, 0])


@inlined
def act_traffic(f, i, world, lanes, table, v):
    """Vehicle v of the traffic, which sees the new targets of those before it."""
    if i[CRASHED, v]:
        return
    i[TARGET_LANE, v] = follow_road(lanes, table, i[TARGET_LANE, v], f[X, v])
    choose_lane(f, i, world, lanes, table, v)
    lane, target = i[LANE, v], i[TARGET_LANE, v]
    steer(f, i, lanes, table, v, target)
    front = front_of(f, i, world, lanes, table, v, lane)
    wanted = acceleration(f, i, lanes, table, v, front)
    if lane != target:
        other = front_of(f, i, world, lanes, table, v, target)
        if other != front:
            wanted = min(wanted, acceleration(f, i, lanes, table, v, other))
    f[ACCELERATION, v] = clip(wanted, -ACC_MAX, ACC_MAX)
