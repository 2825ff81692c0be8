"""The vehicles ahead and behind: Road.neighbour_vehicles, with connected lanes.

Connected lanes follow each other in x, so the next in the order of x is the next along the road.
The next one ahead in each row of main lanes is noted once in a simulator step, in one pass; other
lanes are searched from the vehicle on. Equal leaders: the last in highway-env's list wins, equal
followers: the first.
"""

from __future__ import annotations

import numpy as np

from hmi_marl.envs.worlds.batched.compiler import compiled
from hmi_marl.envs.worlds.batched.lanes import is_near
from hmi_marl.envs.worlds.batched.memory import (
    AMPLITUDE,
    BC,
    CONNECTED,
    CONNECTIONS,
    FRONT,
    LANE_MARGIN,
    LAST,
    LENGTH,
    ORDER,
    RAMP,
    RAMP_COUNT,
    RANK,
    ROW,
    ROW_HIGH,
    ROW_LOW,
    SEGMENT,
    TIES,
    VEHICLES,
    X0,
    Y0,
    X,
    Y,
)

NO_OBJECT = -1


@compiled
def sort_by_x(f, i, world, lanes, rows):
    """Bring ORDER, RANK, FRONT and RAMP up to date; nearly nothing changes from step to step."""
    objects = world[VEHICLES] + 1
    for place in range(1, objects):
        mover = i[ORDER, place]
        x = f[X, mover]
        at = place
        while at > 0:
            other = i[ORDER, at - 1]
            if f[X, other] < x or (f[X, other] == x and other < mover):
                break
            i[ORDER, at] = other
            at -= 1
        i[ORDER, at] = mover
    ramp = lanes.shape[0] - 1
    low = lanes[ramp, X0] - LANE_MARGIN - 1.0
    high = lanes[ramp, X0] + lanes[ramp, LENGTH] + LANE_MARGIN + 1.0
    edge = lanes[ramp, Y0] - lanes[ramp, AMPLITUDE] - 3.0
    on_ramp, ties, x_ahead = 0, 0, np.inf
    for row in range(rows):
        world[LAST + row] = NO_OBJECT
    for place in range(objects - 1, -1, -1):
        thing = i[ORDER, place]
        i[RANK, thing] = place
        x, y = f[X, thing], f[Y, thing]
        if x == x_ahead:
            ties = 1
        x_ahead = x
        for row in range(rows):
            i[FRONT + row, thing] = world[LAST + row]
            if abs(y - lanes[row, Y0]) <= 3.0:
                world[LAST + row] = thing
        if y >= edge and low < x < high:
            i[RAMP, on_ramp] = thing
            on_ramp += 1
    world[RAMP_COUNT] = on_ramp
    world[TIES] = ties


@compiled
def _is_on(f, lanes, table, lane, thing):
    """Whether the object is on the lane or on one that it is connected to."""
    x, y = f[X, thing], f[Y, thing]
    if is_near(lanes, lane, x - lanes[lane, X0], y):
        return True
    for k in range(table[lane, CONNECTIONS]):
        other = table[lane, CONNECTED + k]
        if is_near(lanes, other, x - lanes[other, X0], y):
            return True
    return False


@compiled
def front_of(f, i, world, lanes, table, v, lane):
    """The vehicle or obstacle ahead of v, were v on this lane; NO_OBJECT if there is none."""
    row = table[lane, ROW]
    if row < 0 or world[TIES]:
        return _walk_ahead(f, i, world, lanes, table, v, lane)
    front = i[FRONT + row, v]
    if front != NO_OBJECT:
        if f[X, front] < lanes[lane, ROW_LOW]:
            return _walk_ahead(f, i, world, lanes, table, v, lane)
        if f[X, front] >= lanes[lane, ROW_HIGH]:
            front = NO_OBJECT
    if table[lane, SEGMENT] == BC:
        for k in range(world[RAMP_COUNT]):  # the ramp leads into every lane next to it
            thing = i[RAMP, k]
            ahead = f[X, thing] > f[X, v] and (front == NO_OBJECT or f[X, thing] < f[X, front])
            if ahead and _is_on(f, lanes, table, lane, thing):
                front = thing
    return front


@compiled
def _walk_ahead(f, i, world, lanes, table, v, lane):
    """The next object ahead in the order of x, the last in the list among equals."""
    x, high = f[X, v], lanes[lane, ROW_HIGH]
    front = NO_OBJECT
    place = i[RANK, v]
    while place > 0 and f[X, i[ORDER, place - 1]] == x:
        place -= 1
    while place <= world[VEHICLES]:
        thing = i[ORDER, place]
        place += 1
        if f[X, thing] >= high or (front != NO_OBJECT and f[X, thing] > f[X, front]):
            break
        if thing != v and _is_on(f, lanes, table, lane, thing):
            front = thing
    return front


@compiled
def rear_of(f, i, world, lanes, table, v, lane):
    """The vehicle or obstacle behind v, were v on this lane; NO_OBJECT if there is none."""
    x, low = f[X, v], lanes[lane, ROW_LOW]
    rear = NO_OBJECT
    place = i[RANK, v]
    while place > 0:
        place -= 1
        thing = i[ORDER, place]
        if f[X, thing] < low or (rear != NO_OBJECT and f[X, thing] < f[X, rear]):
            break
        if f[X, thing] < x and _is_on(f, lanes, table, lane, thing):
            rear = thing
    return rear
