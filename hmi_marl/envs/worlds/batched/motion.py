"""The kinematic bicycle: Vehicle.step, clip_actions and on_state_update."""

from __future__ import annotations

import math

from hmi_marl.envs.worlds.batched.compiler import compiled, inlined
from hmi_marl.envs.worlds.batched.elementary import arctan, sin_cos, tan
from hmi_marl.envs.worlds.batched.lanes import closest_lane
from hmi_marl.envs.worlds.batched.memory import (
    ACCELERATION,
    CAR_LENGTH,
    COS,
    CRASHED,
    HEADING,
    HIT,
    IMPACT_X,
    IMPACT_Y,
    LANE,
    SIN,
    SLIP,
    SPEED,
    STEERING,
    TIMER,
    X,
    Y,
)

MAX_SPEED = 40.0


@compiled
def _turn_to_the_bit(f, v, steering, dt):
    """Move along a curve in highway-env's own steps."""
    speed, heading = f[SPEED, v], f[HEADING, v]
    beta = arctan(0.5 * tan(steering))
    sine, cosine = sin_cos(heading + beta)
    f[X, v] += speed * cosine * dt
    f[Y, v] += speed * sine * dt
    sine, _ = sin_cos(beta)
    heading += speed * sine / (CAR_LENGTH / 2) * dt
    f[HEADING, v] = heading
    f[SIN, v], f[COS, v] = sin_cos(heading)


@inlined
def move(f, i, lanes, table, rows, v, dt):
    """Move vehicle v by one simulator step, crashed or not, and find its lane."""
    f[TIMER, v] += dt
    speed, acceleration = f[SPEED, v], f[ACCELERATION, v]
    slip, steering = f[SLIP, v], f[STEERING, v]
    if i[CRASHED, v]:
        slip, steering, acceleration = 0.0, 0.0, -speed
    if speed > MAX_SPEED:
        acceleration = min(acceleration, MAX_SPEED - speed)
    elif speed < -MAX_SPEED:
        acceleration = max(acceleration, -MAX_SPEED - speed)
    if steering != 0.0:
        _turn_to_the_bit(f, v, steering, dt)
    elif slip != 0.0:
        along, cosine, sine = math.sqrt(1.0 - slip * slip), f[COS, v], f[SIN, v]
        f[X, v] += speed * (cosine * along - sine * slip) * dt
        f[Y, v] += speed * (sine * along + cosine * slip) * dt
        f[HEADING, v] += speed * slip / (CAR_LENGTH / 2) * dt
        f[SIN, v], f[COS, v] = sin_cos(f[HEADING, v])
    else:
        f[X, v] += speed * f[COS, v] * dt
        f[Y, v] += speed * f[SIN, v] * dt
    if i[HIT, v]:
        f[X, v] += f[IMPACT_X, v]
        f[Y, v] += f[IMPACT_Y, v]
        i[CRASHED, v] = 1
        i[HIT, v] = 0
    f[SPEED, v] = speed + acceleration * dt
    i[LANE, v] = closest_lane(lanes, table, rows, i[LANE, v], f[X, v], f[Y, v], f[HEADING, v])
