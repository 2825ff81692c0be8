"""The lidar: LidarObservation.trace and utils.distance_to_rect, with inflated objects.

Distances are computed in 64 bits and compared with what a ray of 32-bit numbers holds so far, as
highway-env does.
"""

from __future__ import annotations

import math

import numpy as np

from hmi_marl.envs.worlds.batched import memory as m
from hmi_marl.envs.worlds.batched.compiler import compiled, inlined
from hmi_marl.envs.worlds.batched.elementary import arctan2

_ROUGHNESS = 1e-4
"""Safely above the error of _rough_angle."""


@inlined
def _distance_to_rect(across, along, half_width, half_length, ray_across, ray_along):
    """Share of the ray, in the rectangle's own frame, at which it enters; inf if it does not.

    Args:
        across, along: the ray's origin from the rectangle's middle.
        half_width, half_length: of the rectangle.
        ray_across, ray_along: the whole ray.
    """
    first_1, last_1 = (-half_width - across) / ray_across, (half_width - across) / ray_across
    if ray_across < 0:
        first_1, last_1 = last_1, first_1
    first_2, last_2 = (-half_length - along) / ray_along, (half_length - along) / ray_along
    if ray_along < 0:
        first_2, last_2 = last_2, first_2
    between = first_2 - last_1 if first_1 < first_2 else first_1 - last_2
    to_first = first_1 - 1.0 if 0.0 < first_1 else 0.0 - last_1
    to_second = first_2 - 1.0 if 0.0 < first_2 else 0.0 - last_2
    if between <= 0 and to_first <= 0 and to_second <= 0:
        return max(first_1, first_2)
    return np.inf


@inlined
def _rough_angle(y, x):
    """atan2(y, x) to about 1e-5, several times faster."""
    a, b = abs(x), abs(y)
    ratio = min(a, b) / max(a, b, 1e-300)
    r2 = ratio * ratio
    angle = 0.05265332 + r2 * -0.01172120
    angle = 0.19354346 + r2 * (-0.11643287 + r2 * angle)
    angle = ratio * (0.99997726 + r2 * (-0.33262347 + r2 * angle))
    if b > a:
        angle = math.pi / 2 - angle
    if x < 0:
        angle = math.pi - angle
    return math.copysign(angle, y)


@inlined
def _is_unsure(angle, sector):
    """Could the rough angle lie in the next sector, or on the other side of a quarter turn?"""
    share = angle / sector
    near_edge = abs(share - np.rint(share)) * sector < _ROUGHNESS
    return near_edge or abs(abs(angle) - math.pi / 2) < _ROUGHNESS


@compiled
def _exact_angles(dx, dy, cosine, sine, half_length, half_width):
    """(angle of the middle, least and largest angle of a corner) by the exact arctangent."""
    least, most = np.inf, -np.inf
    for corner in range(4):
        a = half_length if corner >= 2 else -half_length
        b = half_width if corner == 1 or corner == 2 else -half_width
        angle = arctan2(dy + (sine * a + cosine * b), dx + (cosine * a - sine * b))
        least, most = min(least, angle), max(most, angle)
    return arctan2(dy, dx), least, most


@inlined
def _angles(dx, dy, cosine, sine, half_length, half_width, sector):
    """The same with half a sector added to each, as highway-env's lidar counts its cells.

    Only the cells that the angles fall into matter, so rough angles do unless one is near an edge.
    """
    half = sector / 2
    lx, ly = cosine * half_length, sine * half_length
    wx, wy = -sine * half_width, cosine * half_width
    middle = _rough_angle(dy, dx) + half
    first = _rough_angle(dy - ly - wy, dx - lx - wx)
    second = _rough_angle(dy - ly + wy, dx - lx + wx)
    third = _rough_angle(dy + ly + wy, dx + lx + wx)
    fourth = _rough_angle(dy + ly - wy, dx + lx - wx)
    least = min(min(first, second), min(third, fourth)) + half
    most = max(max(first, second), max(third, fourth)) + half
    if _is_unsure(middle, sector) or _is_unsure(least, sector) or _is_unsure(most, sector):
        middle, least, most = _exact_angles(dx, dy, cosine, sine, half_length, half_width)
        return middle + half, least + half, most + half
    return middle, least, most


@compiled
def trace(f, world, inflation, directions, maximum_range, grid):
    """Fill ``grid`` (cells, 2) with the driven car's lidar; ``directions`` has shape (cells, 2)."""
    cells = grid.shape[0]
    sector = 2 * math.pi / cells
    ox, oy = f[m.X, 0], f[m.Y, 0]
    ovx, ovy = f[m.SPEED, 0] * f[m.COS, 0], f[m.SPEED, 0] * f[m.SIN, 0]
    for cell in range(cells):
        grid[cell, 0] = maximum_range
        grid[cell, 1] = maximum_range
    reach = max(maximum_range, m.CAR_LENGTH * inflation) + 1.0
    inside = False
    for thing in range(1, world[m.VEHICLES] + 1):
        dx, dy = f[m.X, thing] - ox, f[m.Y, thing] - oy
        if abs(dx) > reach:
            continue
        obstacle = thing == world[m.VEHICLES]
        half_length = (m.OBSTACLE_SIZE if obstacle else m.CAR_LENGTH) / 2 * inflation
        half_width = (m.OBSTACLE_SIZE if obstacle else m.CAR_WIDTH) / 2 * inflation
        cosine, sine = f[m.COS, thing], f[m.SIN, thing]
        along, across = -(cosine * dx + sine * dy), -(cosine * dy - sine * dx)
        inside = inside or (abs(along) <= half_length and abs(across) <= half_width)
        center_distance = math.sqrt(dx * dx + dy * dy)
        if center_distance > maximum_range:
            continue
        vx, vy = f[m.SPEED, thing] * cosine - ovx, f[m.SPEED, thing] * sine - ovy
        middle, least, most = _angles(dx, dy, cosine, sine, half_length, half_width, sector)
        cell = math.floor(middle / sector) % cells
        distance = center_distance - half_width
        if distance <= grid[cell, 0]:
            grid[cell, 0] = distance
            grid[cell, 1] = vx * directions[cell, 0] + vy * directions[cell, 1]
        behind = least < -math.pi / 2 and math.pi / 2 < most
        if behind:
            least, most = most, least + 2 * math.pi
        start = math.floor(least / sector) % cells
        end = math.floor(most / sector) % cells
        number = end - start + 1 if start < end else cells - start + end + 1
        if start == end and not behind:
            number = 1  # all corners are in this cell: highway-env tries every ray, and hits none
        cell = start
        for _ in range(number):
            ray_x, ray_y = directions[cell, 0], directions[cell, 1]
            ray_along = maximum_range * (ray_x * cosine + ray_y * sine)
            ray_across = maximum_range * (ray_y * cosine - ray_x * sine)
            distance = maximum_range * _distance_to_rect(
                across, along, half_width, half_length, ray_across, ray_along
            )
            if distance <= grid[cell, 0]:
                grid[cell, 0] = distance
                grid[cell, 1] = vx * ray_x + vy * ray_y
            cell = cell + 1 if cell + 1 < cells else 0
    if inside:
        for cell in range(cells):
            grid[cell, 0] = 0.0
