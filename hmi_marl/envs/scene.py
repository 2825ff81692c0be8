"""The merge scene: road, traffic, frequencies, lidar, and the vehicles' starts.

The road is highway-env's generic merge: ``lanes`` main lanes in the x direction with a ramp that
joins them from the right. The scene of an episode is a pure function of (Scene, seed), whichever
world drives it::

    ======================================================================  lane 0
    ----------------------------------------------------------------------  ...
    ======================================================================  lane lanes - 1
                           /  ______________/
    ______________________/  /
    ________________________/
    |<----- before ------>|<-converge->|<-parallel->|<------ after ------->|
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from hmi_marl.checks import Check, Checked, Real, Whole, shown
from hmi_marl.envs.streams import Stream, uniform

LANE_WIDTH = 4.0
EGO_START = 30.0
EGO_START_SPEED = 30.0
MERGING_START = 60.0
MERGING_START_SPEED = 20.0
MERGING_TARGET_SPEED = 30.0
TRAFFIC_SPEED = 30.0
TRAFFIC_SPEED_SPREAD = 2.0
SAFE_DISTANCE = 15.0
SPAWN_TRIES = 10
MIN_AFTER = 90.0
"""Shortest road after the merge that highway-env accepts [m]."""


def check_vehicles(name: str, vehicles: int | tuple[int, int]) -> int | tuple[int, int]:
    """Return a number of vehicles, or the least and the most of a range."""
    if not isinstance(vehicles, (tuple, list)):
        return _MOST_VEHICLES(name, vehicles)
    if len(vehicles) != 2:
        raise ValueError(f"{name} is a number or a (least, most) pair, not {shown(vehicles)}")
    low, high = _LEAST_VEHICLES(name, vehicles[0]), _MOST_VEHICLES(name, vehicles[1])
    if low > high:
        raise ValueError(f"{name}: the range {vehicles} runs backwards")
    return low, high


def _check_speeds(name: str, speeds: tuple[float, ...]) -> tuple[float, ...]:
    """Return target speeds, at least two, evenly spaced and increasing."""
    if not isinstance(speeds, (tuple, list, np.ndarray)):
        raise TypeError(f"{name} are a tuple of speeds, not {shown(speeds)}")
    if len(speeds) > MOST_SPEEDS:
        raise ValueError(f"{name} are at most {MOST_SPEEDS} speeds, but got {len(speeds)}")
    checked = tuple(_SPEED(f"each of {name}", speed) for speed in speeds)
    steps = np.diff(checked)
    if len(checked) < 2 or np.any(steps <= 0) or not np.allclose(steps, steps[0]):
        raise ValueError(
            f"{name} are at least two evenly spaced, increasing speeds, but got {shown(speeds)}"
        )
    return checked


VEHICLES = "1 to 50, or a pair of 0 to 50 and 1 to 50"
_LEAST_VEHICLES, _MOST_VEHICLES = Whole(0, 50), Whole(1, 50)  # a range may begin at none
_SPEED = Real(1.0, 40.0, "m/s")
MOST_SPEEDS = 40
Length = Annotated[float, Real(1.0, 10_000.0, "m")]
Speeds = Annotated[tuple[float, ...], Check(_check_speeds, "2 to 40 numbers in [1, 40] m/s")]
Frequency = Annotated[int, Whole(1, 1000, "Hz")]


@dataclass(frozen=True)
class Scene(Checked):
    """Road, traffic and sensing of an episode. Lengths in m, frequencies in Hz.

    Raises:
        ValueError, TypeError: a value out of its range, with what to use instead.
    """

    lanes: Annotated[int, Whole(1, 5)] = 3
    """Main lanes, 1 to 5, without the ramp."""
    vehicles: Annotated[int | tuple[int, int], Check(check_vehicles, VEHICLES)] = (1, 20)
    """Other vehicles on the main lanes, 1 to 50: a fixed number, or a range, from 0 on, that each
    episode draws from evenly. One more is on the ramp. As in highway-env, a vehicle that
    finds no free place in ten tries is left out."""
    before: Annotated[float, Real(MERGING_START, 10_000.0, "m")] = 150.0
    """Road before the ramp starts to converge, 60 to 10,000."""
    converge: Length = 80.0
    """Length over which the ramp approaches the highway, 1 to 10,000."""
    parallel: Length = 80.0
    """Length over which the ramp runs along the highway and vehicles can merge, 1 to 10,000."""
    after: Annotated[float, Real(MIN_AFTER, 1e6, "m")] | None = None
    """Road after the merge, 90 to 1,000,000. None: as long as the episode needs."""
    policy_frequency: Frequency = 5
    """Decisions per second, 1 to 1000."""
    simulation_frequency: Frequency = 15
    """Simulator steps per second, a multiple of ``policy_frequency`` up to 1000."""
    lidar_cells: Annotated[int, Whole(4, 360)] = 16
    """Number of lidar rays, evenly around the car, 4 to 360."""
    lidar_range: Length = 60.0
    """Range of the lidar, 1 to 10,000."""
    target_speeds: Speeds = (20.0, 25.0, 30.0)
    """Speeds [m/s] that speed_up and slow_down choose from: 2 to 40 of them, evenly spaced,
    increasing, 1 to 40 m/s."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.simulation_frequency % self.policy_frequency:
            raise ValueError(
                f"scene.policy_frequency = {self.policy_frequency} does not divide "
                f"simulation_frequency = {self.simulation_frequency}; try 5 and 15"
            )

    def _named(self, field: str) -> str:
        return f"scene.{field}"

    @property
    def vehicle_range(self) -> tuple[int, int]:
        """Least and most other vehicles."""
        if isinstance(self.vehicles, tuple):
            return self.vehicles
        return self.vehicles, self.vehicles

    @property
    def merge_end(self) -> float:
        """End of the merging lane [m]; traffic starts anywhere before."""
        return self.before + self.converge + self.parallel

    @property
    def length(self) -> float:
        """Length of the whole road [m], once ``after`` is known (see :meth:`fitted`)."""
        if self.after is None:
            raise ValueError("scene.after is still open; use scene.fitted(duration) first")
        return self.merge_end + self.after

    def fitted(self, duration: float) -> Scene:
        """Return this scene with a road too long to reach its end within ``duration`` seconds.

        Raises:
            ValueError: ``after`` was given and is too short for the driver's car.
        """
        fastest = max(self.target_speeds)
        if self.after is None:
            way = duration * max(fastest, TRAFFIC_SPEED + TRAFFIC_SPEED_SPREAD)
            return replace(self, after=max(MIN_AFTER, way + self.lidar_range))
        needed = EGO_START + duration * fastest - self.merge_end
        if self.after < needed:
            raise ValueError(
                f"scene.after = {self.after:g} m is too short for {duration:g} s at "
                f"{fastest:g} m/s: use at least {math.ceil(needed)}, or None to have it fitted"
            )
        return self


@dataclass(frozen=True)
class Start:
    """Starts of the traffic of one episode, one entry for each vehicle on the main lanes.

    The driver's car and the vehicle on the ramp always start alike (constants of this module).
    """

    lane: NDArray[np.int64]
    longitudinal: NDArray[np.float64]
    """Position along the lane [m]."""
    speed: NDArray[np.float64]
    """Speed [m/s], which is also the vehicle's target speed."""


def draw_start(scene: Scene, seed: int) -> Start:
    """Place the traffic by the rule of highway-env's generic merge, from one seed.

    The number of vehicles is drawn evenly from the scene's range; each tries up to ten random
    places on the main lanes up to the end of the merging lane and takes the first that is more
    than 15 m from every other vehicle in its lane.

    Draw number 0 of the scene stream gives the count; vehicle k's try j uses the draws
    1 + 3 (10 k + j) + (0: lane, 1: place, 2: speed), so any single draw can be made on its own.
    """
    low, high = scene.vehicle_range
    draws = uniform(seed, Stream.SCENE, np.arange(number_of_draws(high)))
    lane, longitudinal, speed = np.empty(high, np.int64), np.empty(high), np.empty(high)
    count = place(draws, low, high, scene.lanes, scene.merge_end, lane, longitudinal, speed)
    return Start(lane[:count], longitudinal[:count], speed[:count])


def number_of_draws(most_vehicles: int) -> int:
    """Number of uniform draws that a scene with at most so many vehicles may need."""
    return 1 + 3 * SPAWN_TRIES * most_vehicles


def place(
    draws: NDArray[np.float64],
    low: int,
    high: int,
    lanes: int,
    merge_end: float,
    lane: NDArray[np.int64],
    longitudinal: NDArray[np.float64],
    speed: NDArray[np.float64],
) -> int:
    """Apply the rule of :func:`draw_start` to given draws, in a form that can be compiled.

    Writes into ``lane``, ``longitudinal`` and ``speed`` (each of shape (high,)) and returns how
    many vehicles found a place.
    """
    placed = 0
    for vehicle in range(low + int(draws[0] * (high - low + 1))):
        for attempt in range(SPAWN_TRIES):
            first = 1 + 3 * (SPAWN_TRIES * vehicle + attempt)
            row = int(draws[first] * lanes)
            where = draws[first + 1] * merge_end
            free = row != lanes - 1 or abs(where - EGO_START) > SAFE_DISTANCE
            for other in range(placed):
                if lane[other] == row and abs(where - longitudinal[other]) <= SAFE_DISTANCE:
                    free = False
            if free:
                lane[placed] = row
                longitudinal[placed] = where
                speed[placed] = TRAFFIC_SPEED + (2 * draws[first + 2] - 1) * TRAFFIC_SPEED_SPREAD
                placed += 1
                break
    return placed
