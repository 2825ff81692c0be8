"""The vehicles ahead and behind: Road.neighbour_vehicles, with connected lanes.

Connected lanes follow each other in x, so the next in the order of x is the next along the road.
The next one ahead in each row of main lanes is noted once in a simulator step, in one pass; other
lanes are searched from the vehicle on. Equal leaders: the last in highway-env's list wins, equal
followers: the first.
"""

from __future__ import annotations

import numpy as np

from hmi_marl.envs.worlds.batched import memory as m
from hmi_marl.envs.worlds.batched.compiler import compiled
from hmi_marl.envs.worlds.batched.lanes import is_near

NO_OBJECT = -1


@compiled
def sort_by_x(f, i, world, lanes, rows):
    """Bring ORDER, RANK, FRONT and RAMP up to date; nearly nothing changes from step to step."""
    objects = world[m.VEHICLES] + 1
    for place in range(1, objects):
        mover = i[m.ORDER, place]
        x = f[m.X, mover]
        at = place
        while at > 0:
            other = i[m.ORDER, at - 1]
            if f[m.X, other] < x or (f[m.X, other] == x and other < mover):
                break
            i[m.ORDER, at] = other
            at -= 1
        i[m.ORDER, at] = mover
    ramp = lanes.shape[0] - 1
    low = lanes[ramp, m.X0] - m.LANE_MARGIN - 1.0
    high = lanes[ramp, m.X0] + lanes[ramp, m.LENGTH] + m.LANE_MARGIN + 1.0
    edge = lanes[ramp, m.Y0] - lanes[ramp, m.AMPLITUDE] - 3.0
    on_ramp, ties, x_ahead = 0, 0, np.inf
    for row in range(rows):
        world[m.LAST + row] = NO_OBJECT
    for place in range(objects - 1, -1, -1):
        thing = i[m.ORDER, place]
        i[m.RANK, thing] = place
        x, y = f[m.X, thing], f[m.Y, thing]
        if x == x_ahead:
            ties = 1
        x_ahead = x
        for row in range(rows):
            i[m.FRONT + row, thing] = world[m.LAST + row]
            if abs(y - lanes[row, m.Y0]) <= 3.0:
                world[m.LAST + row] = thing
        if y >= edge and low < x < high:
            i[m.RAMP, on_ramp] = thing
            on_ramp += 1
    world[m.RAMP_COUNT] = on_ramp
    world[m.TIES] = ties


@compiled
def _is_on(f, lanes, table, lane, thing):
    """Whether the object is on the lane or on one that it is connected to."""
    x, y = f[m.X, thing], f[m.Y, thing]
    if is_near(lanes, lane, x - lanes[lane, m.X0], y):
        return True
    for k in range(table[lane, m.CONNECTIONS]):
        other = table[lane, m.CONNECTED + k]
        if is_near(lanes, other, x - lanes[other, m.X0], y):
            return True
    return False


@compiled
def front_of(f, i, world, lanes, table, v, lane):
    """The vehicle or obstacle ahead of v, were v on this lane; NO_OBJECT if there is none."""
    row = table[lane, m.ROW]
    if row < 0 or world[m.TIES]:
        return _walk_ahead(f, i, world, lanes, table, v, lane)
    front = i[m.FRONT + row, v]
    if front != NO_OBJECT:
        if f[m.X, front] < lanes[lane, m.ROW_LOW]:
            return _walk_ahead(f, i, world, lanes, table, v, lane)
        if f[m.X, front] >= lanes[lane, m.ROW_HIGH]:
            front = NO_OBJECT
    if table[lane, m.SEGMENT] == m.BC:
        for k in range(world[m.RAMP_COUNT]):  # the ramp leads into every lane next to it
            thing = i[m.RAMP, k]
            ahead = f[m.X, thing] > f[m.X, v] and (
                front == NO_OBJECT or f[m.X, thing] < f[m.X, front]
            )
            if ahead and _is_on(f, lanes, table, lane, thing):
                front = thing
    return front


@compiled
def _walk_ahead(f, i, world, lanes, table, v, lane):
    """The next object ahead in the order of x, the last in the list among equals."""
    x, high = f[m.X, v], lanes[lane, m.ROW_HIGH]
    front = NO_OBJECT
    place = i[m.RANK, v]
    while place > 0 and f[m.X, i[m.ORDER, place - 1]] == x:
        place -= 1
    while place <= world[m.VEHICLES]:
        thing = i[m.ORDER, place]
        place += 1
        if f[m.X, thing] >= high or (front != NO_OBJECT and f[m.X, thing] > f[m.X, front]):
            break
        if thing != v and _is_on(f, lanes, table, lane, thing):
            front = thing
    return front


@compiled
def rear_of(f, i, world, lanes, table, v, lane):
    """The vehicle or obstacle behind v, were v on this lane; NO_OBJECT if there is none."""
    x, low = f[m.X, v], lanes[lane, m.ROW_LOW]
    rear = NO_OBJECT
    place = i[m.RANK, v]
    while place > 0:
        place -= 1
        thing = i[m.ORDER, place]
        if f[m.X, thing] < low or (rear != NO_OBJECT and f[m.X, thing] < f[m.X, rear]):
            break
        if f[m.X, thing] < x and _is_on(f, lanes, table, lane, thing):
            rear = thing
    return rear
