"""What a world is: N copies of the merge scene, side by side, each with one driven car.

A world knows roads and vehicles and nothing of attention, rewards or agents. Every
implementation starts from the same scene for the same seed and reports the same quantities, so
that the teaming code above does not know which one it drives.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from hmi_marl.envs.scene import Scene

VEHICLE_ACTIONS = ("move_left", "keep_speed", "move_right", "speed_up", "slow_down")
"""The driver's actions, 0 to 4, in highway-env's order."""


@dataclass(frozen=True)
class Ego:
    """The driven cars of N worlds. Each field has shape (N,), float64 unless said otherwise."""

    x: NDArray[np.float64]
    """Along the road [m]."""
    y: NDArray[np.float64]
    """Across the road, growing to the right [m]."""
    heading: NDArray[np.float64]
    """0 along the road [rad]."""
    speed: NDArray[np.float64]
    """[m/s]."""
    target_speed: NDArray[np.float64]
    """The speed that the car is being brought to [m/s]."""
    lane: NDArray[np.int64]
    """int64: 0 (left) to lanes - 1 (right) for a main lane, ``lanes`` on the ramp."""
    lateral: NDArray[np.float64]
    """Distance from the middle of that lane [m]."""
    crashed: NDArray[np.bool_]
    """bool."""
    gap: NDArray[np.float64]
    """Bumper to bumper to the next vehicle or obstacle ahead in the lane [m], inf if none."""
    merging_slowness: NDArray[np.float64]
    """Sum of (target - current) / target speed over vehicles in the merging lane."""


@dataclass(frozen=True)
class Snapshot:
    """One world at one moment, for pictures. The driven car is vehicle 0."""

    time: float
    """Since the start of the episode [s]."""
    position: NDArray[np.float64]
    """Shape (V, 2) [m]."""
    heading: NDArray[np.float64]
    """Shape (V,) [rad]."""
    speed: NDArray[np.float64]
    """Shape (V,) [m/s]."""
    crashed: NDArray[np.bool_]
    """Shape (V,)."""
    obstacles: NDArray[np.float64]
    """Middles of the fixed obstacles, shape (O, 2) [m]."""


class World(Protocol):
    """N merge scenes. Team k's episode depends on seed k alone.

    What is handed out stays as it is: later calls do not write into it.
    """

    scene: Scene
    num_worlds: int

    def reset(
        self,
        seeds: NDArray[np.uint64],
        inflation: NDArray[np.float64],
        which: NDArray[np.bool_],
    ) -> None:
        """Start new episodes in the worlds marked in ``which``; all arguments have shape (N,)."""

    def step(self, actions: NDArray[np.int64], which: NDArray[np.bool_]) -> None:
        """Move the marked worlds by one policy step; ``actions`` index ``VEHICLE_ACTIONS``."""

    def halt(self, which: NDArray[np.bool_]) -> None:
        """Bring the driven car of the marked worlds to a stand, after a crash."""

    def perceive(self, inflation: NDArray[np.float64], which: NDArray[np.bool_]) -> None:
        """Other eyes look out of the marked worlds' cars; both arguments have shape (N,)."""

    def ego(self) -> Ego:
        """The driven cars."""

    def lidar(self, inflated: bool) -> NDArray[np.float32]:
        """Distance [m] and relative radial speed [m/s] per ray, shape (N, cells, 2).

        Ray k looks into the direction 2πk / cells from the x axis. ``inflated``: as the driver
        perceives it, with every other object longer and wider by the world's inflation factor;
        inside an inflated object every ray reads 0 m.
        """

    def snapshot(self, world: int) -> Snapshot:
        """World number ``world`` as it stands."""
