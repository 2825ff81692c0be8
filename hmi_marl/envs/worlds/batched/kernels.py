"""The loops over worlds: begin, step, look around.

Each loop takes worlds, some at a time, until none is left, and releases the GIL, so that several
threads can run it at once (:mod:`threads`). numba's own parallel loops are not used: they start
OpenMP, after which a forked process dies and idle threads keep the cores busy.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hmi_marl.envs.worlds import base
from hmi_marl.envs.worlds.batched import memory as m
from hmi_marl.envs.worlds.batched.collisions import collide
from hmi_marl.envs.worlds.batched.compiler import compiled, inlined, kernel
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
    """Fill row k of the numbers and flags of :class:`worlds.base.Readings`."""
    lane = i[m.LANE, 0]
    numbers[k, base.X], numbers[k, base.Y] = f[m.X, 0], f[m.Y, 0]
    numbers[k, base.HEADING] = f[m.HEADING, 0]
    numbers[k, base.SPEED], numbers[k, base.TARGET_SPEED] = f[m.SPEED, 0], f[m.TARGET_SPEED, 0]
    across = lateral(lanes, lane, f[m.X, 0] - lanes[lane, m.X0], f[m.Y, 0])
    numbers[k, base.LATERAL] = across
    front = front_of(f, i, world, lanes, table, 0, lane)
    gap = np.inf
    if front != NO_OBJECT:
        length = m.OBSTACLE_SIZE if front == world[m.VEHICLES] else m.CAR_LENGTH
        gap = f[m.X, front] - f[m.X, 0] - (m.CAR_LENGTH + length) / 2
    numbers[k, base.GAP] = gap
    slowness = 0.0
    for v in range(world[m.VEHICLES]):
        if i[m.LANE, v] == 2 * rows:
            slowness += (f[m.TARGET_SPEED, v] - f[m.SPEED, v]) / f[m.TARGET_SPEED, v]
    numbers[k, base.MERGING_SLOWNESS] = slowness
    flags[k, base.LANE] = rows if table[lane, m.ROW] < 0 else table[lane, m.ROW]
    flags[k, base.CRASHED] = i[m.CRASHED, 0]


TRACED, CHANGED = range(2)
"""TRACED: a lidar is as the world is. CHANGED: it has to be traced again before it is read."""


class Merges(NamedTuple):
    """N worlds as the loops see them: arrays with an entry for each world, and constants."""

    floats: NDArray[np.float64]
    integers: NDArray[np.int32]
    worlds: NDArray[np.int32]
    lanes: NDArray[np.float64]
    table: NDArray[np.int64]
    rows: int
    """Main lanes."""
    speeds: NDArray[np.float64]
    """Target speeds to choose from [m/s]."""
    substeps: int
    """Simulator steps in a policy step."""
    dt: float
    """Duration of a simulator step [s]."""
    steps: NDArray[np.int64]
    """Policy steps since the start of the episode, shape (N,)."""
    numbers: NDArray[np.float64]
    flags: NDArray[np.int64]
    """Readings of the driven cars; see :class:`worlds.base.Readings`."""
    inflation: NDArray[np.float64]
    directions: NDArray[np.float64]
    """Unit vectors of the lidar's rays, shape (cells, 2)."""
    lidar_range: float
    true_lidar: NDArray[np.float32]
    """Shape (N, cells, 2)."""
    true_news: NDArray[np.uint8]
    """Whether each world's lidar has to be traced again, shape (N,): TRACED or CHANGED."""
    perceived_lidar: NDArray[np.float32]
    perceived_news: NDArray[np.uint8]


class Room(NamedTuple):
    """Room for drawing the scenes of N worlds."""

    draws: NDArray[np.float64]
    """Shape (N, draws of a scene)."""
    lane: NDArray[np.int64]
    """Shape (N, most vehicles)."""
    start: NDArray[np.float64]
    """Places and speeds, shape (N, 2, most vehicles)."""
    low: int
    """Least other vehicles."""
    high: int
    """Most other vehicles."""


@inlined
def lidars_changed(k, merges):
    """Note that both lidars of world k have to be traced again before they are read."""
    merges.true_news[k] = CHANGED
    merges.perceived_news[k] = CHANGED


@inlined
def move_world(k, merges, action):
    """Take one policy step in world k, and read its driven car."""
    f, i, world = merges.floats[k], merges.integers[k], merges.worlds[k]
    lanes, table, rows = merges.lanes, merges.table, merges.rows
    advance(
        f, i, world, lanes, table, rows, merges.speeds, action, merges.substeps, merges.dt
    )  # fmt: skip
    read_ego(f, i, world, lanes, table, rows, merges.numbers, merges.flags, k)
    merges.steps[k] += 1
    lidars_changed(k, merges)


@inlined
def halt_world(k, merges):
    """Stop the driven car of world k."""
    merges.floats[k, m.SPEED, 0] = 0.0
    merges.numbers[k, base.SPEED] = 0.0
    lidars_changed(k, merges)


@inlined
def look(k, merges, true, perceived):
    """Trace those lidars of world k that are wanted and have changed; see :func:`lidar.trace`."""
    f, world = merges.floats[k], merges.worlds[k]
    directions, reach = merges.directions, merges.lidar_range
    if true and merges.true_news[k] == CHANGED:
        trace(f, world, 1.0, directions, reach, merges.true_lidar[k])
        merges.true_news[k] = TRACED
    if perceived and merges.perceived_news[k] == CHANGED:
        trace(f, world, merges.inflation[k], directions, reach, merges.perceived_lidar[k])
        merges.perceived_news[k] = TRACED


@inlined
def begin_world(k, merges, room, seed, inflation):
    """Begin the episode of a seed in world k; see :func:`spawn.begin`."""
    draws, lane, start = room.draws, room.lane, room.start
    f, i, world = merges.floats[k], merges.integers[k], merges.worlds[k]
    lanes, table, rows = merges.lanes, merges.table, merges.rows
    begin(
        f, i, world, lanes, table, rows, merges.speeds,
        seed, room.low, room.high, draws[k], lane[k], start[k],
    )  # fmt: skip
    read_ego(f, i, world, lanes, table, rows, merges.numbers, merges.flags, k)
    merges.inflation[k] = inflation
    merges.steps[k] = 0
    lidars_changed(k, merges)


@kernel
def begin_worlds(progress, merges, room, which, seeds, inflation):
    """Begin the episodes of the worlds whose numbers stand in ``which``."""
    first, last = take(progress, 0, len(which))
    while first < last:
        for place in range(first, last):
            begin_world(which[place], merges, room, seeds[place], inflation[place])
        first, last = take(progress, last - first, len(which))


@kernel
def step_worlds(progress, merges, actions, which):
    """Take one policy step in the marked worlds; see :func:`advance`."""
    first, last = take(progress, 0, len(which))
    while first < last:
        for k in range(first, last):
            if which[k]:
                move_world(k, merges, actions[k])
        first, last = take(progress, last - first, len(which))


@kernel
def look_around(progress, merges, true, perceived):
    """Trace those lidars of every world that are wanted and have changed."""
    worlds = len(merges.steps)
    first, last = take(progress, 0, worlds)
    while first < last:
        for k in range(first, last):
            look(k, merges, true, perceived)
        first, last = take(progress, last - first, worlds)


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
