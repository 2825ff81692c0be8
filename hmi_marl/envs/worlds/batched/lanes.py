"""The table of lanes, read from highway-env's own network, and geometry on it.

Restates highway_env.road.lane (StraightLane, SineLane, AbstractLane) and, of
highway_env.road.road.RoadNetwork, get_closest_lane_index and next_lane. All lanes of the merge run
in the x direction, so the longitudinal coordinate is x less the lane's start.
"""

from __future__ import annotations

import math

import numpy as np
from highway_env.road.lane import SineLane
from highway_env.road.road import RoadNetwork
from numpy.typing import NDArray

from hmi_marl.envs.scene import Scene
from hmi_marl.envs.worlds.batched import memory as m
from hmi_marl.envs.worlds.batched.compiler import compiled, inlined
from hmi_marl.envs.worlds.batched.elementary import arctan, sin_cos
from hmi_marl.envs.worlds.highway import MergeScene

_SEGMENTS = {
    ("a", "b"): m.AB,
    ("b", "c"): m.BC,
    ("c", "d"): m.CD,
    ("j", "k"): m.JK,
    ("k", "b"): m.KB,
}


def lane_table(scene: Scene) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """(floats, integers) of every lane in highway-env's graph order; see :mod:`memory`.

    With L main lanes: 0 .. L-1 before the merge, L .. 2L-1 next to it, 2L the merging lane,
    2L+1 .. 3L after it, 3L+1 and 3L+2 the ramp.
    """
    network = MergeScene(scene).road.network
    indices = list(network.lanes_dict())
    number = {index: k for k, index in enumerate(indices)}
    floats = np.zeros((len(indices), m.LANE_FLOATS))
    integers = np.zeros((len(indices), m.LANE_INTEGERS), np.int64)
    for index, k in number.items():
        lane = network.get_lane(index)
        floats[k, [m.X0, m.Y0]] = lane.start
        floats[k, [m.LENGTH, m.SPEED_LIMIT]] = lane.length, lane.speed_limit
        if isinstance(lane, SineLane):
            floats[k, [m.AMPLITUDE, m.PULSATION, m.PHASE]] = (
                lane.amplitude,
                lane.pulsation,
                lane.phase,
            )
        merging = index == ("b", "c", scene.lanes)
        integers[k, m.SEGMENT] = m.MERGING if merging else _SEGMENTS[index[:2]]
        end = lane.position(lane.length, 0)
        integers[k, m.NEXT] = number[network.next_lane(index, position=end)]
        sides = {side[2] - index[2]: number[side] for side in network.side_lanes(index)}
        integers[k, [m.LEFT, m.RIGHT]] = sides.get(-1, -1), sides.get(1, -1)
        integers[k, m.FORBIDDEN] = lane.forbidden
        on_ramp = merging or index[0] in ("j", "k")
        integers[k, m.ROW] = -1 if on_ramp else index[2]
        connected = _connected(network, index)
        integers[k, m.CONNECTIONS] = len(connected)
        integers[k, m.CONNECTED : m.CONNECTED + len(connected)] = [number[o] for o in connected]
        reach = [network.get_lane(other) for other in (index, *connected)]
        floats[k, m.ROW_LOW] = min(other.start[0] for other in reach) - m.LANE_MARGIN
        floats[k, m.ROW_HIGH] = max(other.end[0] for other in reach) + m.LANE_MARGIN
    return floats, integers


def _connected(network: RoadNetwork, index: tuple[str, str, int]) -> list[tuple[str, str, int]]:
    """The lanes that Road.neighbour_vehicles searches besides the lane itself."""
    origin, end, number = index
    found = [
        (end, next_end, number if number < len(lanes) else 0)
        for next_end, lanes in network.graph.get(end, {}).items()
    ]
    for previous_origin, ends in network.graph.items():
        if origin in ends:
            found.append((previous_origin, origin, number if number < len(ends[origin]) else 0))
    return found


@inlined
def not_zero(x):
    """highway_env.utils.not_zero."""
    if abs(x) > 1e-2:
        return x
    return 1e-2 if x >= 0 else -1e-2


@inlined
def clip(x, low, high):
    """np.clip of a number."""
    return min(max(x, low), high)


@inlined
def wrap_to_pi(x):
    """highway_env.utils.wrap_to_pi, its rounding included."""
    turned = x + math.pi
    if turned < 0.0 or turned >= 2 * math.pi:
        turned = turned % (2 * math.pi)
    return turned - math.pi


@inlined
def lateral(lanes, lane, s, y):
    """The r of local_coordinates at longitudinal s."""
    r = y - lanes[lane, m.Y0]
    if lanes[lane, m.AMPLITUDE] != 0.0:
        sine, _ = sin_cos(lanes[lane, m.PULSATION] * s + lanes[lane, m.PHASE])
        r -= lanes[lane, m.AMPLITUDE] * sine
    return r


@inlined
def heading_at(lanes, lane, s):
    """The lane's heading at longitudinal s."""
    if lanes[lane, m.AMPLITUDE] == 0.0:
        return 0.0
    _, cosine = sin_cos(lanes[lane, m.PULSATION] * s + lanes[lane, m.PHASE])
    return arctan(lanes[lane, m.AMPLITUDE] * lanes[lane, m.PULSATION] * cosine)


@compiled
def is_near(lanes, lane, s, y):
    """on_lane(margin=1) at longitudinal s."""
    if s < -m.LANE_MARGIN or s >= lanes[lane, m.LENGTH] + m.LANE_MARGIN:
        return False
    if abs(y - lanes[lane, m.Y0]) > 3.0 + lanes[lane, m.AMPLITUDE]:
        return False
    return abs(lateral(lanes, lane, s, y)) <= 3.0


@compiled
def is_reachable(lanes, table, lane, x, y):
    """is_reachable_from(position)."""
    if table[lane, m.FORBIDDEN]:
        return False
    s = x - lanes[lane, m.X0]
    if s < 0.0 or s >= lanes[lane, m.LENGTH] + m.LANE_MARGIN:
        return False
    return abs(lateral(lanes, lane, s, y)) <= 8.0


@inlined
def follow_road(lanes, table, lane, x):
    """The target lane of ControlledVehicle.follow_road."""
    if x - lanes[lane, m.X0] > lanes[lane, m.LENGTH] - m.LANE_MARGIN / 2:
        return table[lane, m.NEXT]
    return lane


@compiled
def _nearest_row(lanes, first, count, x, y, turn, best, nearest):
    """The closest of ``count`` parallel lanes from number ``first`` on, if it beats ``best``."""
    s = x - lanes[first, m.X0]
    beyond, short = max(s - lanes[first, m.LENGTH], 0.0), max(-s, 0.0)
    if beyond + short >= best:
        return best, nearest
    row = min(max(math.floor((y - lanes[first, m.Y0]) / 4.0), 0), count - 1)
    for lane in range(first + row, first + min(row + 2, count)):
        distance = ((abs(y - lanes[lane, m.Y0]) + beyond) + short) + turn
        if distance < best:
            best, nearest = distance, lane
    return best, nearest


@inlined
def closest_lane(lanes, table, rows, lane, x, y, heading):
    """get_closest_lane_index: the first minimum, in graph order, of distance_with_heading.

    Well within the main lane where it was, a vehicle stays: every other lane is farther.
    """
    if table[lane, m.ROW] >= 0:
        s = x - lanes[lane, m.X0]
        near = abs(y - lanes[lane, m.Y0]) + abs(heading) < 2.0
        if near and 0.0 < s < lanes[lane, m.LENGTH]:
            return lane
    return _closest_of_all(lanes, rows, x, y, heading)


@compiled
def _closest_of_all(lanes, rows, x, y, heading):
    turn = abs(wrap_to_pi(heading))
    best, nearest = _nearest_row(lanes, 0, rows, x, y, turn, np.inf, 0)
    best, nearest = _nearest_row(lanes, rows, rows, x, y, turn, best, nearest)
    best, nearest = _nearest_row(lanes, 2 * rows, 1, x, y, turn, best, nearest)
    best, nearest = _nearest_row(lanes, 2 * rows + 1, rows, x, y, turn, best, nearest)
    best, nearest = _nearest_row(lanes, 3 * rows + 1, 1, x, y, turn, best, nearest)
    lane = 3 * rows + 2
    if abs(y - lanes[lane, m.Y0]) - lanes[lane, m.AMPLITUDE] < best:
        s = x - lanes[lane, m.X0]
        turn = abs(wrap_to_pi(heading - heading_at(lanes, lane, s)))
        beyond, short = max(s - lanes[lane, m.LENGTH], 0.0), max(-s, 0.0)
        distance = ((abs(lateral(lanes, lane, s, y)) + beyond) + short) + turn
        if distance < best:
            nearest = lane
    return nearest
