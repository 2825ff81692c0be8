"""highway-env's lidar on a road where other objects appear larger than they are.

The rays are traced by highway-env's own observation class, on stand-ins for the other objects at
their true places with their perceived sizes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
from highway_env.envs.common.observation import LidarObservation
from highway_env.vehicle.objects import RoadObject
from numpy.typing import NDArray


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
