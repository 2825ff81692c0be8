"""The kinematic bicycle: Vehicle.step, clip_actions and on_state_update."""

from __future__ import annotations

import math

from hmi_marl.envs.worlds.batched import memory as m
from hmi_marl.envs.worlds.batched.compiler import compiled, inlined
from hmi_marl.envs.worlds.batched.elementary import arctan, sin_cos, tan
from hmi_marl.envs.worlds.batched.lanes import closest_lane

MAX_SPEED = 40.0


@compiled
def _turn_to_the_bit(f, v, steering, dt):
    """Move along a curve in highway-env's own steps."""
    speed, heading = f[m.SPEED, v], f[m.HEADING, v]
    beta = arctan(0.5 * tan(steering))
    sine, cosine = sin_cos(heading + beta)
    f[m.X, v] += speed * cosine * dt
    f[m.Y, v] += speed * sine * dt
    sine, _ = sin_cos(beta)
    heading += speed * sine / (m.CAR_LENGTH / 2) * dt
    f[m.HEADING, v] = heading
    f[m.SIN, v], f[m.COS, v] = sin_cos(heading)


@inlined
def move(f, i, lanes, table, rows, v, dt):
    """Move vehicle v by one simulator step, crashed or not, and find its lane."""
    f[m.TIMER, v] += dt
    speed, acceleration = f[m.SPEED, v], f[m.ACCELERATION, v]
    slip, steering = f[m.SLIP, v], f[m.STEERING, v]
    if i[m.CRASHED, v]:
        slip, steering, acceleration = 0.0, 0.0, -speed
    if speed > MAX_SPEED:
        acceleration = min(acceleration, MAX_SPEED - speed)
    elif speed < -MAX_SPEED:
        acceleration = max(acceleration, -MAX_SPEED - speed)
    if steering != 0.0:
        _turn_to_the_bit(f, v, steering, dt)
    elif slip != 0.0:
        along, cosine, sine = math.sqrt(1.0 - slip * slip), f[m.COS, v], f[m.SIN, v]
        f[m.X, v] += speed * (cosine * along - sine * slip) * dt
        f[m.Y, v] += speed * (sine * along + cosine * slip) * dt
        f[m.HEADING, v] += speed * slip / (m.CAR_LENGTH / 2) * dt
        f[m.SIN, v], f[m.COS, v] = sin_cos(f[m.HEADING, v])
    else:
        f[m.X, v] += speed * f[m.COS, v] * dt
        f[m.Y, v] += speed * f[m.SIN, v] * dt
    if i[m.HIT, v]:
        f[m.X, v] += f[m.IMPACT_X, v]
        f[m.Y, v] += f[m.IMPACT_Y, v]
        i[m.CRASHED, v] = 1
        i[m.HIT, v] = 0
    f[m.SPEED, v] = speed + acceleration * dt
    i[m.LANE, v] = closest_lane(
        lanes, table, rows, i[m.LANE, v], f[m.X, v], f[m.Y, v], f[m.HEADING, v]
    )
