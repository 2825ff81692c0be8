"""Collisions and impacts.

Restates the pairs of Road.step, RoadObject.handle_collisions and utils.are_polygons_intersecting.

A pair can be ruled out early where one of the axes that highway-env tests surely separates it. If
nothing is left, which is nearly always, that is all; otherwise every pair is gone through in
highway-env's order, since a later impact overwrites an earlier one.
"""

from __future__ import annotations

import math

import numpy as np

from hmi_marl.envs.worlds.batched import memory as m
from hmi_marl.envs.worlds.batched.compiler import compiled, inlined
from hmi_marl.envs.worlds.batched.motion import MAX_SPEED

_CAR_DIAGONAL = math.sqrt(m.CAR_LENGTH**2 + m.CAR_WIDTH**2)
_OBSTACLE_DIAGONAL = math.sqrt(2 * m.OBSTACLE_SIZE**2)
_SURELY = 1e-6


@inlined
def _half_sizes(world, thing):
    if thing == world[m.VEHICLES]:
        return m.OBSTACLE_SIZE / 2, m.OBSTACLE_SIZE / 2, _OBSTACLE_DIAGONAL
    return m.CAR_LENGTH / 2, m.CAR_WIDTH / 2, _CAR_DIAGONAL


@compiled
def _surely_apart(f, world, a, b, dt):
    """Whether one of the axes of object a separates it from b, now and within the next step."""
    half_length, half_width, _ = _half_sizes(world, a)
    other_length, other_width, _ = _half_sizes(world, b)
    cosine, sine = f[m.COS, a], f[m.SIN, a]
    dx, dy = f[m.X, b] - f[m.X, a], f[m.Y, b] - f[m.Y, a]
    vx = (f[m.SPEED, a] * cosine - f[m.SPEED, b] * f[m.COS, b]) * dt
    vy = (f[m.SPEED, a] * sine - f[m.SPEED, b] * f[m.SIN, b]) * dt
    turn_cos = abs(cosine * f[m.COS, b] + sine * f[m.SIN, b])
    turn_sin = abs(cosine * f[m.SIN, b] - sine * f[m.COS, b])
    across = abs(cosine * dy - sine * dx) - abs(cosine * vy - sine * vx)
    if across > half_width + other_length * turn_sin + other_width * turn_cos + _SURELY:
        return True
    along = abs(cosine * dx + sine * dy) - abs(cosine * vx + sine * vy)
    return along > half_length + other_length * turn_cos + other_width * turn_sin + _SURELY


@compiled
def _project(f, world, thing, nx, ny):
    """Interval that the object covers along an axis."""
    half_length, half_width, _ = _half_sizes(world, thing)
    cosine, sine = f[m.COS, thing], f[m.SIN, thing]
    middle = f[m.X, thing] * nx + f[m.Y, thing] * ny
    reach = half_length * abs(cosine * nx + sine * ny) + half_width * abs(cosine * ny - sine * nx)
    return middle - reach, middle + reach


@inlined
def _interval_distance(min_a, max_a, min_b, max_b):
    return min_b - max_a if min_a < min_b else min_a - max_b


@compiled
def _intersection(f, world, a, b, dt):
    """(intersecting, will intersect, translation x, y) of are_polygons_intersecting."""
    intersecting, will_intersect = True, True
    least, axis_x, axis_y = np.inf, 0.0, 0.0
    vx = f[m.SPEED, a] * f[m.COS, a] * dt - f[m.SPEED, b] * f[m.COS, b] * dt
    vy = f[m.SPEED, a] * f[m.SIN, a] * dt - f[m.SPEED, b] * f[m.SIN, b] * dt
    for turn in range(2):
        polygon = a if turn == 0 else b
        for k in range(4):
            nx, ny = -f[m.COS, polygon], -f[m.SIN, polygon]  # of the rear, then counter-clockwise
            for _ in range(k):
                nx, ny = ny, -nx
            min_a, max_a = _project(f, world, a, nx, ny)
            min_b, max_b = _project(f, world, b, nx, ny)
            if _interval_distance(min_a, max_a, min_b, max_b) > 0:
                intersecting = False
            velocity = nx * vx + ny * vy
            if velocity < 0:
                min_a += velocity
            else:
                max_a += velocity
            distance = _interval_distance(min_a, max_a, min_b, max_b)
            if distance > 0:
                will_intersect = False
            if not intersecting and not will_intersect:
                break
            if abs(distance) < least:
                least = abs(distance)
                towards = (f[m.X, a] - f[m.X, b]) * nx + (f[m.Y, a] - f[m.Y, b]) * ny
                axis_x, axis_y = (nx, ny) if towards > 0 else (-nx, -ny)
    if will_intersect:
        return intersecting, True, least * axis_x, least * axis_y
    return intersecting, False, 0.0, 0.0


@compiled
def _handle(f, i, world, a, b, dt):
    """handle_collisions of object a with the later object b."""
    dx, dy = f[m.X, b] - f[m.X, a], f[m.Y, b] - f[m.Y, a]
    reach = (_half_sizes(world, a)[2] + _half_sizes(world, b)[2]) / 2 + f[m.SPEED, a] * dt
    if math.sqrt(dx * dx + dy * dy) > reach or _surely_apart(f, world, a, b, dt):
        return
    intersecting, will_intersect, tx, ty = _intersection(f, world, a, b, dt)
    if will_intersect:
        i[m.HIT, a] = 1
        if b == world[m.VEHICLES]:
            f[m.IMPACT_X, a], f[m.IMPACT_Y, a] = tx, ty
        else:
            i[m.HIT, b] = 1
            f[m.IMPACT_X, a], f[m.IMPACT_Y, a] = tx / 2, ty / 2
            f[m.IMPACT_X, b], f[m.IMPACT_Y, b] = -tx / 2, -ty / 2
    if intersecting:
        i[m.CRASHED, a] = 1
        i[m.CRASHED, b] = 1


@compiled
def _collide_all(f, i, world, dt):
    for a in range(world[m.VEHICLES]):
        for b in range(a + 1, world[m.VEHICLES] + 1):
            _handle(f, i, world, a, b, dt)


@compiled
def collide(f, i, world, dt):
    """Handle all collisions after all vehicles have moved; ORDER must be up to date."""
    objects = world[m.VEHICLES] + 1
    reach = _CAR_DIAGONAL + (MAX_SPEED + 1) * dt
    for place in range(objects - 1):
        a = i[m.ORDER, place]
        for later in range(place + 1, objects):
            b = i[m.ORDER, later]
            if f[m.X, b] - f[m.X, a] > reach:
                break
            if abs(f[m.Y, b] - f[m.Y, a]) < reach and not _surely_apart(f, world, a, b, dt):
                _collide_all(f, i, world, dt)
                return
