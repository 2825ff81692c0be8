"""Layout of a world's numbers: one block of floats, one of integers, and the table of lanes.

For world w, ``floats[w, X, v]`` is the x of vehicle v. Vehicle 0 is the driven car; after the last
vehicle comes the obstacle at the end of the merging lane, as an object that never moves.
"""

from __future__ import annotations

# Floats of a vehicle.
X, Y, HEADING, COS, SIN, SPEED, TARGET_SPEED, TIMER = range(8)
SLIP, STEERING, ACCELERATION, IMPACT_X, IMPACT_Y = range(8, 13)
FLOATS = 13
"""SLIP: sine of the slip angle that the steering asks for; where every bit counts STEERING, the
steering angle itself."""

# Integers of a vehicle.
LANE, TARGET_LANE, CRASHED, HIT = range(4)
ORDER, RANK, RAMP = range(4, 7)
FRONT = 7
MAX_ROWS = 5
INTEGERS = FRONT + MAX_ROWS
"""HIT: an impact waits to be applied. ORDER: objects by x; RANK: an object's place in it;
RAMP: objects near the ramp's converging part, the first RAMP_COUNT of them. FRONT + row: the next
object ahead that is in that row of main lanes."""

# Integers of a world.
VEHICLES, RAMP_COUNT, TIES = range(3)
LAST = 3
WORLD_INTEGERS = LAST + MAX_ROWS
"""TIES: two objects have the same x. LAST + row: place of the search for FRONT."""

# Floats of a lane.
X0, Y0, LENGTH, AMPLITUDE, PULSATION, PHASE, SPEED_LIMIT = range(7)
ROW_LOW, ROW_HIGH = range(7, 9)
LANE_FLOATS = 9
"""ROW_LOW, ROW_HIGH: range of x of a lane and those that it is connected to."""

# Integers of a lane.
SEGMENT, NEXT, LEFT, RIGHT, FORBIDDEN, ROW, CONNECTIONS = range(7)
CONNECTED = 7
LANE_INTEGERS = 10
"""ROW: which main lane from the left, -1 on the ramp. LEFT, RIGHT: the side lanes, -1 where there
is none. CONNECTED, +1, +2: next and previous lanes, in highway-env's order."""

AB, BC, CD, MERGING, JK, KB = range(6)
"""Segments: main lanes before, along and after the merge; the merging lane; the ramp before and
while it converges."""

CAR_LENGTH, CAR_WIDTH, OBSTACLE_SIZE = 5.0, 2.0, 2.0
LANE_MARGIN = 5.0
"""highway-env's AbstractLane.VEHICLE_LENGTH."""
