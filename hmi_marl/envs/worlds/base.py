"""The interface of a world: N roads side by side, each with one driven car.

A world knows roads and vehicles and nothing of attention, rewards or agents. ``highway`` and
``batched`` are the same merge: for the same seed they start from the same scene and report the same
quantities.

A custom world is any object with the methods of :class:`World`, given as ``world=`` to every
environment in place of a name; ``examples/new_world.py`` is a complete one. Its road has
``scene.lanes`` main lanes in the x direction. From :class:`Scene` it takes the lanes, the length,
the frequencies, the lidar and the target speeds; it need not read the lengths that describe the
merge (``before``, ``converge``, ``parallel``). Pictures show the merge's road, with this world's
vehicles on it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from hmi_marl.envs.scene import Scene

VEHICLE_ACTIONS = ("move_left", "keep_speed", "move_right", "speed_up", "slow_down")
"""The driver's actions, 0 to 4, in highway-env's order."""


@dataclass(frozen=True)
class Ego:
    """The driven cars of N worlds. Each field has shape (N,), float64 unless noted."""

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
    """int64: 0 (left) to lanes - 1 (right) for a main lane, ``lanes`` on any other, such as the
    ramp of the merge."""
    lateral: NDArray[np.float64]
    """Distance from the middle of that lane [m]."""
    crashed: NDArray[np.bool_]
    """bool."""
    gap: NDArray[np.float64]
    """Bumper to bumper to the next vehicle or obstacle ahead in the lane [m], inf if none."""
    merging_slowness: NDArray[np.float64]
    """Sum of (target - current) / target speed over vehicles in a lane that merges into the main
    lanes; 0 where no lane does."""


X, Y, HEADING, SPEED, TARGET_SPEED, LATERAL, GAP, MERGING_SLOWNESS = range(8)
"""Columns of the numbers of :class:`Readings`."""
LANE, CRASHED = range(2)
"""Columns of its flags."""
_NUMBERS = (
    "x", "y", "heading", "speed", "target_speed", "lateral", "gap", "merging_slowness",
)  # fmt: skip


class Readings(NamedTuple):
    """The fields of :class:`Ego` in two arrays, as the loops over teams read them."""

    numbers: NDArray[np.float64]
    """Shape (N, 8)."""
    flags: NDArray[np.int64]
    """Shape (N, 2)."""

    @classmethod
    def of(cls, ego: Ego) -> Readings:
        """Put the fields together."""
        numbers = np.stack([getattr(ego, name) for name in _NUMBERS], axis=1, dtype=np.float64)
        flags = [np.asarray(ego.lane, np.int64), np.asarray(ego.crashed, np.bool_).astype(np.int64)]
        return cls(numbers, np.stack(flags, axis=1))

    def ego(self) -> Ego:
        """The fields one by one, which share the memory of these arrays."""
        numbers = dict(zip(_NUMBERS, self.numbers.T, strict=True))
        return Ego(**numbers, lane=self.flags[:, LANE], crashed=self.flags[:, CRASHED] == 1)


@dataclass(frozen=True)
class Snapshot:
    """One world at one moment, for pictures. The driven car is vehicle 0."""

    time: float
    """Time since the start of the episode [s]."""
    position: NDArray[np.float64]
    """Shape (V, 2) [m]."""
    heading: NDArray[np.float64]
    """Shape (V,) [rad]."""
    speed: NDArray[np.float64]
    """Shape (V,) [m/s]."""
    crashed: NDArray[np.bool_]
    """Shape (V,)."""
    obstacles: NDArray[np.float64]
    """Middles of the fixed obstacles, shape (O, 2) [m]; O = 0 where there are none."""


class World(Protocol):
    """N roads with traffic. World k's episode depends on seed k and its car's actions alone.

    Arrays that were returned stay as they are: later calls do not write into them.
    """

    scene: Scene
    """Equal to :attr:`TeamConfig.scene` of the teams that drive here."""
    num_worlds: int
    """N."""

    def reset(
        self, seeds: NDArray[np.uint64], inflation: NDArray[np.float64], which: NDArray[np.bool_]
    ) -> None:
        """Start new episodes in the worlds marked in ``which``; all arguments have shape (N,)."""

    def step(self, actions: NDArray[np.int64], which: NDArray[np.bool_]) -> None:
        """Move the marked worlds by one policy step; ``actions`` index ``VEHICLE_ACTIONS``."""

    def halt(self, which: NDArray[np.bool_]) -> None:
        """Stop the driven car of the marked worlds, after a crash."""

    def perceive(self, inflation: NDArray[np.float64], which: NDArray[np.bool_]) -> None:
        """Change the marked worlds' inflation to another driver's; both have shape (N,)."""

    def ego(self) -> Ego:
        """Return the state of the driven cars."""

    def lidar(self, inflated: bool) -> NDArray[np.float32]:
        """Distance [m] and relative radial speed [m/s] per ray, shape (N, cells, 2).

        Ray k has the direction 2πk / cells from the x axis. A ray that hits nothing within
        ``scene.lidar_range`` reads that number in both columns. ``inflated``: as the driver
        perceives it, with every other object longer and wider by the world's inflation factor;
        inside an inflated object every ray reads 0 m.
        """

    def snapshot(self, world: int) -> Snapshot:
        """Return the present state of world number ``world``."""
