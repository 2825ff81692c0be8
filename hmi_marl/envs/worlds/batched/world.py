"""N compiled merges behind the World interface."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from hmi_marl.envs.scene import Scene, number_of_draws
from hmi_marl.envs.worlds.base import Ego, Snapshot
from hmi_marl.envs.worlds.batched.kernels import EGO_SPEED, KERNELS
from hmi_marl.envs.worlds.batched.lanes import lane_table
from hmi_marl.envs.worlds.batched.memory import (
    CRASHED,
    FLOATS,
    HEADING,
    INTEGERS,
    SPEED,
    VEHICLES,
    WORLD_INTEGERS,
    X,
    Y,
)

_PATIENCE = 2.0
_ready: set[str] = set()


@contextmanager
def _telling_of_compilation(kernel: str) -> Iterator[None]:
    """Say so on stderr if the first call of a kernel takes long, which is its compilation."""
    if kernel in _ready:
        yield
        return
    start = time.perf_counter()
    told = threading.Event()

    def tell() -> None:
        told.set()
        print("hmi-marl: compiling the batched world, once for this machine ...", file=sys.stderr)

    timer = threading.Timer(_PATIENCE, tell)
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
    _ready.add(kernel)
    if told.is_set():
        print(f"hmi-marl: compiled in {time.perf_counter() - start:.1f} s", file=sys.stderr)


class BatchedWorld:
    """N merges, compiled, behind the :class:`hmi_marl.envs.worlds.base.World` interface.

    Args:
        scene: fitted to the episode's duration.
        num_worlds: N.
        threads: to share the worlds among; all cores by default. Does not change results.
    """

    def __init__(self, scene: Scene, num_worlds: int, threads: int | None = None) -> None:
        most = int(numba.config.NUMBA_NUM_THREADS)  # type: ignore[attr-defined]
        if threads is not None and not 1 <= threads <= most:
            raise ValueError(f"threads lies in 1 to {most} on this machine, but got {threads}")
        self.scene = scene
        self.num_worlds = num_worlds
        self.threads = threads or most
        self._road = lane_table(scene)
        self._speeds = np.array(scene.target_speeds)
        high = scene.vehicle_range[1]
        objects = high + 3  # the driven car, the one on the ramp and the obstacle
        self._floats = np.zeros((num_worlds, FLOATS, objects))
        self._integers = np.zeros((num_worlds, INTEGERS, objects), np.int32)
        self._worlds = np.zeros((num_worlds, WORLD_INTEGERS), np.int32)
        self._blocks = self._floats, self._integers, self._worlds
        self._room = (
            np.zeros((num_worlds, number_of_draws(high))),
            np.zeros((num_worlds, high), np.int64),
            np.zeros((num_worlds, 2, high)),
        )
        """For drawing a scene: the draws, the lanes, the places and speeds."""
        self._told = np.zeros((num_worlds, 8)), np.zeros((num_worlds, 2), np.int64)
        """Of the driven cars, as read_ego fills it in."""
        self._inflation = np.ones(num_worlds)
        self._steps = np.zeros(num_worlds, np.int64)
        angle = 2 * np.pi / scene.lidar_cells * np.arange(scene.lidar_cells)
        self._directions = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        cells = (num_worlds, scene.lidar_cells, 2)
        self._seen = {inflated: np.zeros(cells, np.float32) for inflated in (False, True)}
        self._stale = {inflated: np.ones(num_worlds, np.bool_) for inflated in (False, True)}
        none = np.zeros(num_worlds, np.uint64)
        self.reset(none, self._inflation, np.ones(num_worlds, np.bool_))

    @property
    def bytes_per_world(self) -> int:
        """Memory that each world takes, besides what it hands out."""
        seen = (*self._seen.values(), *self._stale.values(), self._inflation, self._steps)
        blocks: tuple[NDArray[Any], ...] = (*self._blocks, *self._room, *self._told, *seen)
        return sum(block.nbytes for block in blocks) // self.num_worlds

    def reset(
        self,
        seeds: NDArray[np.uint64],
        inflation: NDArray[np.float64],
        which: NDArray[np.bool_],
    ) -> None:
        """See :meth:`World.reset`."""
        low, high = self.scene.vehicle_range
        rows, speeds = self.scene.lanes, self._speeds
        road, room = self._road, self._room
        self._run(
            "begin", self._blocks, road, rows, speeds, seeds, which, low, high, room, self._told
        )
        self._moved(which)
        self._inflation = np.where(which, inflation, self._inflation)
        self._steps = np.where(which, 0, self._steps)

    def step(self, actions: NDArray[np.int64], which: NDArray[np.bool_]) -> None:
        """See :meth:`World.step`."""
        scene = self.scene
        substeps = scene.simulation_frequency // scene.policy_frequency
        dt = 1 / scene.simulation_frequency
        rows, speeds = scene.lanes, self._speeds
        self._run(
            "step", self._blocks, self._road, rows, speeds, actions, which, substeps, dt, self._told
        )
        self._moved(which)
        self._steps = self._steps + which

    def halt(self, which: NDArray[np.bool_]) -> None:
        """See :meth:`World.halt`."""
        self._floats[which, SPEED, 0] = 0.0
        self._told[0][which, EGO_SPEED] = 0.0
        self._moved(which)

    def perceive(self, inflation: NDArray[np.float64], which: NDArray[np.bool_]) -> None:
        """See :meth:`World.perceive`."""
        self._inflation = np.where(which, inflation, self._inflation)
        self._stale[True] |= which

    def ego(self) -> Ego:
        """See :meth:`World.ego`."""
        numbers, flags = self._told[0].copy(), self._told[1].copy()
        x, y, heading, speed, target_speed, lateral, gap, slowness = numbers.T
        return Ego(
            x=x,
            y=y,
            heading=heading,
            speed=speed,
            target_speed=target_speed,
            lane=flags[:, 0],
            lateral=lateral,
            crashed=flags[:, 1] == 1,
            gap=gap,
            merging_slowness=slowness,
        )

    def lidar(self, inflated: bool) -> NDArray[np.float32]:
        """See :meth:`World.lidar`; traced when asked for, where something has moved since."""
        stale = self._stale[inflated]
        if stale.any():
            self._seen[inflated] = self._seen[inflated].copy()  # the last one was handed out
            inflation = self._inflation if inflated else np.ones(self.num_worlds)
            reach, seen = float(self.scene.lidar_range), self._seen[inflated]
            self._run("look", self._blocks, stale, inflation, self._directions, reach, seen)
            stale[:] = False
        return self._seen[inflated]

    def _moved(self, which: NDArray[np.bool_]) -> None:
        for stale in self._stale.values():
            stale |= which

    def snapshot(self, world: int) -> Snapshot:
        """See :meth:`World.snapshot`."""
        f, vehicles = self._floats[world], int(self._worlds[world, VEHICLES])
        return Snapshot(
            time=float(self._steps[world] / self.scene.policy_frequency),
            position=f[[X, Y], :vehicles].T.copy(),
            heading=f[HEADING, :vehicles].copy(),
            speed=f[SPEED, :vehicles].copy(),
            crashed=self._integers[world, CRASHED, :vehicles] == 1,
            obstacles=f[[X, Y], vehicles : vehicles + 1].T.copy(),
        )

    def _run(self, kernel: str, *arguments: object) -> None:
        numba.set_num_threads(self.threads)
        with _telling_of_compilation(kernel):
            getattr(KERNELS, kernel)(*arguments)
