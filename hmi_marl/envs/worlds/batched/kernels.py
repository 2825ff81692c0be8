"""The loops over worlds: begin, step, look around.

Each loop takes worlds, some at a time, until none is left, and releases the GIL, so that several
threads can run it at once (:mod:`threads`). numba's own parallel loops are not used: they start
OpenMP, after which a forked process dies and idle threads keep the cores busy.
"""

from __future__ import annotations

import numpy as np

from hmi_marl.envs.worlds import base
from hmi_marl.envs.worlds.batched import memory as m
from hmi_marl.envs.worlds.batched.collisions import collide
from hmi_marl.envs.worlds.batched.compiler import compiled, kernel
from hmi_marl.envs.worlds.batched.control import act_driven, act_traffic, command
from hmi_marl.envs.worlds.batched.elementary import sin_cos
from hmi_marl.envs.worlds.batched.lanes import lateral
from hmi_marl.envs.worlds.batched.lidar import trace
from hmi_marl.envs.worlds.batched.motion import move
from hmi_marl.envs.worlds.batched.neighbours import NO_OBJECT, front_of, sort_by_x
from hmi_marl.envs.worlds.batched.spawn import begin
from hmi_marl.envs.worlds.batched.threads import take


@compiled
def advance(f, i, world, lanes, table, rows, speeds, action, substeps, dt):
    """One policy step of one world: Env._simulate."""
    command(f, i, lanes, table, speeds, action)
    vehicles = world[m.VEHICLES]
    for _ in range(substeps):
        act_driven(f, i, lanes, table)
        for v in range(1, vehicles):
            act_traffic(f, i, world, lanes, table, v)
        for v in range(vehicles):
            move(f, i, lanes, table, rows, v, dt)
        sort_by_x(f, i, world, lanes, rows)
        collide(f, i, world, dt)


@compiled
def read_ego(f, i, world, lanes, table, rows, numbers, flags, k):
    """Fill column k of the numbers and flags of :class:`worlds.base.Readings`."""
    lane = i[m.LANE, 0]
    numbers[base.X, k], numbers[base.Y, k] = f[m.X, 0], f[m.Y, 0]
    numbers[base.HEADING, k] = f[m.HEADING, 0]
    numbers[base.SPEED, k], numbers[base.TARGET_SPEED, k] = f[m.SPEED, 0], f[m.TARGET_SPEED, 0]
    across = lateral(lanes, lane, f[m.X, 0] - lanes[lane, m.X0], f[m.Y, 0])
    numbers[base.LATERAL, k] = across
    front = front_of(f, i, world, lanes, table, 0, lane)
    gap = np.inf
    if front != NO_OBJECT:
        length = m.OBSTACLE_SIZE if front == world[m.VEHICLES] else m.CAR_LENGTH
        gap = f[m.X, front] - f[m.X, 0] - (m.CAR_LENGTH + length) / 2
    numbers[base.GAP, k] = gap
    slowness = 0.0
    for v in range(world[m.VEHICLES]):
        if i[m.LANE, v] == 2 * rows:
            slowness += (f[m.TARGET_SPEED, v] - f[m.SPEED, v]) / f[m.TARGET_SPEED, v]
    numbers[base.MERGING_SLOWNESS, k] = slowness
    flags[base.LANE, k] = rows if table[lane, m.ROW] < 0 else table[lane, m.ROW]
    flags[base.CRASHED, k] = i[m.CRASHED, 0]


@kernel
def begin_worlds(progress, blocks, road, rows, speeds, seeds, which, low, high, room, readings):
    """Begin the episodes of the marked worlds; see :func:`spawn.begin`."""
    numbers, flags = readings
    floats, integers, worlds = blocks
    lanes, table = road
    draws, lane, start = room
    first, last = take(progress, 0, len(which))
    while first < last:
        for k in range(first, last):
            if which[k]:
                f, i, world = floats[k], integers[k], worlds[k]
                begin(
                    f, i, world, lanes, table, rows, speeds,
                    seeds[k], low, high, draws[k], lane[k], start[k],
                )  # fmt: skip
                read_ego(f, i, world, lanes, table, rows, numbers, flags, k)
        first, last = take(progress, last - first, len(which))


@kernel
def step_worlds(progress, blocks, road, rows, speeds, actions, which, substeps, dt, readings):
    """Take one policy step in the marked worlds; see :func:`advance`."""
    numbers, flags = readings
    floats, integers, worlds = blocks
    lanes, table = road
    first, last = take(progress, 0, len(which))
    while first < last:
        for k in range(first, last):
            if which[k]:
                f, i, world = floats[k], integers[k], worlds[k]
                advance(f, i, world, lanes, table, rows, speeds, actions[k], substeps, dt)
                read_ego(f, i, world, lanes, table, rows, numbers, flags, k)
        first, last = take(progress, last - first, len(which))


@kernel
def look_around(progress, blocks, which, inflation, directions, maximum_range, grids):
    """Trace the lidars of the marked worlds; see :func:`lidar.trace`."""
    floats, _integers, worlds = blocks
    first, last = take(progress, 0, len(which))
    while first < last:
        for k in range(first, last):
            if which[k]:
                trace(floats[k], worlds[k], inflation[k], directions, maximum_range, grids[k])
        first, last = take(progress, last - first, len(which))


@kernel
def fill_directions(progress, directions):
    """Fill in the unit vectors of evenly spread lidar rays, shape (cells, 2)."""
    cells = len(directions)
    first, last = take(progress, 0, cells)
    while first < last:
        for cell in range(first, last):
            sine, cosine = sin_cos(2 * np.pi / cells * cell)
            directions[cell, 0], directions[cell, 1] = cosine, sine
        first, last = take(progress, last - first, cells)
