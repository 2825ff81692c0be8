"""The reference world: highway-env's own ``merge-generic-v1``, N of them in a loop.

Physics, traffic and steering are highway-env's, untouched. Added are the vehicles' starts (so that
a scene is a pure function of its seed, in every world) and the readings. The lidar's rays are
traced by highway-env's own observation class, on stand-ins for the other objects at their true
places with their perceived sizes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
from highway_env import utils
from highway_env.envs.common.observation import LidarObservation
from highway_env.envs.merge_env import ConnectedLaneMergeGenericEnv
from highway_env.vehicle.controller import ControlledVehicle
from highway_env.vehicle.objects import RoadObject
from numpy.typing import NDArray

from hmi_marl.envs.scene import (
    EGO_START,
    EGO_START_SPEED,
    MERGING_START,
    MERGING_START_SPEED,
    MERGING_TARGET_SPEED,
    Scene,
    Start,
    draw_start,
)
from hmi_marl.envs.worlds.base import Ego, Snapshot


@dataclass(frozen=True)
class PerceivedObject:
    """Another object as a driver sees it; named as highway-env's lidar reads it."""

    position: NDArray[np.float64]
    heading: float
    velocity: NDArray[np.float64]
    LENGTH: float
    WIDTH: float
    solid: bool = True

    @classmethod
    def of(cls, other: RoadObject, inflation: float) -> PerceivedObject:
        """``other`` with its length and width times ``inflation``."""
        return cls(
            other.position,
            other.heading,
            other.velocity,
            other.LENGTH * inflation,
            other.WIDTH * inflation,
        )

    def contains(self, point: NDArray[np.float64]) -> bool:
        """Whether a point (shape (2,), m) is inside the perceived rectangle."""
        dx, dy = point - self.position
        cosine, sine = np.cos(self.heading), np.sin(self.heading)
        along, across = cosine * dx + sine * dy, cosine * dy - sine * dx
        return bool(abs(along) <= self.LENGTH / 2 and abs(across) <= self.WIDTH / 2)


def trace(
    observer: RoadObject,
    others: Sequence[RoadObject],
    inflation: float,
    cells: int,
    maximum_range: float,
) -> NDArray[np.float32]:
    """Distance [m] and relative radial speed [m/s] per ray, shape (cells, 2).

    Equal to highway-env's lidar on a road where the other objects really have the inflated size;
    but for an observer inside such an object every ray reads 0 m.
    """
    perceived = [PerceivedObject.of(other, inflation) for other in others if other.solid]
    road = SimpleNamespace(vehicles=perceived, objects=[])
    lidar = LidarObservation(
        SimpleNamespace(road=road), cells=cells, maximum_range=maximum_range, normalize=False
    )
    lidar.observer_vehicle = observer
    grid = lidar.trace(observer.position, observer.velocity)
    if any(seen.contains(observer.position) for seen in perceived):
        grid[:, LidarObservation.DISTANCE] = 0.0
    return grid


def highway_config(scene: Scene) -> dict[str, object]:
    """The configuration of highway-env's generic merge that makes ``scene``'s road."""
    return {
        "lanes_count": scene.lanes,
        "before_merge_length": scene.before,
        "converge_merge_length": scene.converge,
        "parallel_merge_length": scene.parallel,
        "after_merge_length": scene.after,
        "policy_frequency": scene.policy_frequency,
        "simulation_frequency": scene.simulation_frequency,
        "action": {"type": "DiscreteMetaAction", "target_speeds": list(scene.target_speeds)},
    }


class MergeScene(ConnectedLaneMergeGenericEnv):  # type: ignore[misc]
    """``merge-generic-v1`` with the traffic placed by a :class:`Start`."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.start = draw_start(scene, 0)  # the base class resets once while it is built
        super().__init__(config=highway_config(scene))

    def restart(self, start: Start) -> None:
        """Begin an episode from ``start``."""
        self.start = start
        self.time = self.steps = 0
        self._reset()

    def _make_vehicles(self) -> None:
        road, last_lane = self.road, self.scene.lanes - 1
        position = road.network.get_lane(("a", "b", last_lane)).position(EGO_START, 0.0)
        ego = self.action_type.vehicle_class(road, position, speed=EGO_START_SPEED)
        road.vehicles.append(ego)
        self.vehicle = ego
        vehicle_class = utils.class_from_path(self.config["other_vehicles_type"])
        start = self.start
        for lane, along, speed in zip(start.lane, start.longitudinal, start.speed, strict=True):
            position = road.network.get_lane(("a", "b", int(lane))).position(along, 0.0)
            road.vehicles.append(vehicle_class(road, position, speed=float(speed)))
        position = road.network.get_lane(("j", "k", 0)).position(MERGING_START, 0.0)
        merging = vehicle_class(road, position, speed=MERGING_START_SPEED)
        merging.target_speed = MERGING_TARGET_SPEED
        road.vehicles.append(merging)

    def drive(self, action: int) -> None:
        """Take one policy step with this vehicle action."""
        self._simulate(action)

    def lane_number(self) -> int:
        """The driven car's main lane, or the number of main lanes when on the ramp."""
        origin, _, lane = self.vehicle.lane_index
        return self.scene.lanes if origin in ("j", "k") else int(lane)

    def gap(self) -> float:
        """Bumper to bumper to the next object ahead in the lane [m]."""
        front, _ = self.road.neighbour_vehicles(self.vehicle)
        if front is None:
            return float("inf")
        between = self.vehicle.lane_distance_to(front)
        return float(between - (self.vehicle.LENGTH + front.LENGTH) / 2)

    def merging_slowness(self) -> float:
        """Sum of (target - current) / target speed over vehicles in the lane that merges.

        highway-env's merge reward names lane ("b", "c", 2), which with more than two main lanes
        is one of them; the lane meant is the one to the right of them all.
        """
        merging_lane = ("b", "c", self.scene.lanes)
        return float(
            sum(
                (vehicle.target_speed - vehicle.speed) / vehicle.target_speed
                for vehicle in self.road.vehicles
                if vehicle.lane_index == merging_lane and isinstance(vehicle, ControlledVehicle)
            )
        )

    def lidar(self, inflation: float) -> NDArray[np.float32]:
        """See :func:`hmi_marl.envs.worlds.highway.trace`."""
        others = [other for other in self.road.vehicles if other is not self.vehicle]
        return trace(
            self.vehicle,
            others + self.road.objects,
            inflation,
            self.scene.lidar_cells,
            self.scene.lidar_range,
        )


class HighwayWorld:
    """N highway-env merges behind the :class:`hmi_marl.envs.worlds.base.World` interface."""

    def __init__(self, scene: Scene, num_worlds: int) -> None:
        self.scene = scene
        self.num_worlds = num_worlds
        self.merges = [MergeScene(scene) for _ in range(num_worlds)]
        self._inflation = np.ones(num_worlds)
        self._lidar: list[dict[float, NDArray[np.float32]]] = [{} for _ in self.merges]

    def reset(
        self,
        seeds: NDArray[np.uint64],
        inflation: NDArray[np.float64],
        which: NDArray[np.bool_],
    ) -> None:
        """See :meth:`World.reset`."""
        for k in np.flatnonzero(which):
            self.merges[k].restart(draw_start(self.scene, int(seeds[k])))
            self._inflation[k] = inflation[k]
            self._lidar[k].clear()

    def step(self, actions: NDArray[np.int64], which: NDArray[np.bool_]) -> None:
        """See :meth:`World.step`."""
        for k in np.flatnonzero(which):
            self.merges[k].drive(int(actions[k]))
            self._lidar[k].clear()

    def halt(self, which: NDArray[np.bool_]) -> None:
        """See :meth:`World.halt`."""
        for k in np.flatnonzero(which):
            self.merges[k].vehicle.speed = 0.0
            self._lidar[k].clear()

    def perceive(self, inflation: NDArray[np.float64], which: NDArray[np.bool_]) -> None:
        """See :meth:`World.perceive`."""
        self._inflation = np.where(which, inflation, self._inflation)

    def ego(self) -> Ego:
        """See :meth:`World.ego`."""
        merges = self.merges
        cars = [merge.vehicle for merge in merges]
        return Ego(
            x=np.array([car.position[0] for car in cars]),
            y=np.array([car.position[1] for car in cars]),
            heading=np.array([car.heading for car in cars], np.float64),
            speed=np.array([car.speed for car in cars], np.float64),
            target_speed=np.array([car.target_speed for car in cars], np.float64),
            lane=np.array([merge.lane_number() for merge in merges], np.int64),
            lateral=np.array([car.lane.local_coordinates(car.position)[1] for car in cars]),
            crashed=np.array([car.crashed for car in cars], np.bool_),
            gap=np.array([merge.gap() for merge in merges]),
            merging_slowness=np.array([merge.merging_slowness() for merge in merges]),
        )

    def lidar(self, inflated: bool) -> NDArray[np.float32]:
        """See :meth:`World.lidar`; traced when asked for, at most once a step."""
        grids = []
        for merge, inflation, seen in zip(self.merges, self._inflation, self._lidar, strict=True):
            factor = float(inflation) if inflated else 1.0
            if factor not in seen:
                seen[factor] = merge.lidar(factor)
            grids.append(seen[factor])
        return np.stack(grids)

    def snapshot(self, world: int) -> Snapshot:
        """See :meth:`World.snapshot`."""
        merge = self.merges[world]
        vehicles = merge.road.vehicles
        return Snapshot(
            time=merge.steps / self.scene.simulation_frequency,
            position=np.array([vehicle.position for vehicle in vehicles]),
            heading=np.array([vehicle.heading for vehicle in vehicles], np.float64),
            speed=np.array([vehicle.speed for vehicle in vehicles], np.float64),
            crashed=np.array([vehicle.crashed for vehicle in vehicles], np.bool_),
            obstacles=np.array([thing.position for thing in merge.road.objects]),
        )
