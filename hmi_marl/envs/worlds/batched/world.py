"""N compiled merges behind the World interface."""

from __future__ import annotations

import time
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hmi_marl.envs.scene import Scene, number_of_draws
from hmi_marl.envs.worlds.base import SPEED, Ego, Readings, Snapshot
from hmi_marl.envs.worlds.batched import memory as m
from hmi_marl.envs.worlds.batched.compiler import prepare
from hmi_marl.envs.worlds.batched.kernels import (
    begin_worlds,
    fill_directions,
    look_around,
    step_worlds,
)
from hmi_marl.envs.worlds.batched.lanes import lane_table
from hmi_marl.envs.worlds.batched.threads import WORTH_A_THREAD, Pace, available, share

_CARRAY: tuple[Literal["C", "W"], ...] = ("C", "W")
"""Requirements of the compiled loops: arrays in one piece that can be written to."""


class Sight(NamedTuple):
    """The lidars of a batched world: what they are traced from, and what was traced."""

    floats: NDArray[np.float64]
    worlds: NDArray[np.int32]
    inflation: NDArray[np.float64]
    directions: NDArray[np.float64]
    lidar_range: float
    true_lidar: NDArray[np.float32]
    """Shape (N, cells, 2)."""
    true_stale: NDArray[np.bool_]
    """Worlds whose lidar has to be traced again before it is read, shape (N,)."""
    perceived_lidar: NDArray[np.float32]
    perceived_stale: NDArray[np.bool_]


class BatchedWorld:
    """N merges, compiled, behind the :class:`hmi_marl.envs.worlds.base.World` interface.

    Args:
        scene: fitted to the episode's duration.
        num_worlds: N.
        threads: to share the worlds among at most; all cores by default. Does not change results.
    """

    def __init__(self, scene: Scene, num_worlds: int, threads: int | None = None) -> None:
        most = available()
        if threads is not None and not 1 <= threads <= most:
            raise ValueError(f"threads lies in 1 to {most} on this machine, but got {threads}")
        self.scene = scene
        self.num_worlds = num_worlds
        self.threads = threads or most
        self._pace = Pace()
        self._road = lane_table(scene)
        self._speeds = np.array(scene.target_speeds)
        high = scene.vehicle_range[1]
        objects = high + 3  # the driven car, the one on the ramp and the obstacle
        self._floats = np.zeros((num_worlds, m.FLOATS, objects))
        self._integers = np.zeros((num_worlds, m.INTEGERS, objects), np.int32)
        self._worlds = np.zeros((num_worlds, m.WORLD_INTEGERS), np.int32)
        self._blocks = self._floats, self._integers, self._worlds
        self._room = (
            np.zeros((num_worlds, number_of_draws(high))),
            np.zeros((num_worlds, high), np.int64),
            np.zeros((num_worlds, 2, high)),
        )
        """Room for drawing a scene: the draws, the lanes, the places and speeds."""
        self._readings = Readings(np.zeros((8, num_worlds)), np.zeros((2, num_worlds), np.int64))
        """Readings of the driven cars, which read_ego fills in."""
        self._inflation = np.ones(num_worlds)
        self._steps = np.zeros(num_worlds, np.int64)
        self._directions = np.zeros((scene.lidar_cells, 2))
        cells = (num_worlds, scene.lidar_cells, 2)
        self._seen = {inflated: np.zeros(cells, np.float32) for inflated in (False, True)}
        self._stale = {inflated: np.ones(num_worlds, np.bool_) for inflated in (False, True)}
        self._returned = dict.fromkeys((False, True), False)
        """Whether the lidar in ``_seen`` was returned, so that it must stay as it is."""
        none, everywhere = np.zeros(num_worlds, np.uint64), np.ones(num_worlds, np.bool_)
        self._prepare()
        share(fill_directions, scene.lidar_cells, 1, self._directions)
        self.reset(none, self._inflation, everywhere)

    @property
    def bytes_per_world(self) -> int:
        """Memory that each world takes, without the arrays it has returned."""
        seen = (*self._seen.values(), *self._stale.values(), self._inflation, self._steps)
        blocks: tuple[NDArray[Any], ...] = (*self._blocks, *self._room, *self._readings, *seen)
        return sum(block.nbytes for block in blocks) // self.num_worlds

    def reset(
        self, seeds: NDArray[np.uint64], inflation: NDArray[np.float64], which: NDArray[np.bool_]
    ) -> None:
        """See :meth:`World.reset`."""
        which = np.require(which, np.bool_, _CARRAY)
        seeds = np.require(seeds, np.uint64, _CARRAY)
        self._share(begin_worlds, self._begin_arguments(seeds, which), int(which.sum()))
        self._moved(which)
        self._inflation = np.where(which, inflation, self._inflation)
        self._steps = np.where(which, 0, self._steps)

    def step(self, actions: NDArray[np.int64], which: NDArray[np.bool_]) -> None:
        """See :meth:`World.step`."""
        which = np.require(which, np.bool_, _CARRAY)
        actions = np.require(actions, np.int64, _CARRAY)
        threads, start = self._pace.threads(self.threads), time.perf_counter()
        share(step_worlds, self.num_worlds, threads, *self._step_arguments(actions, which))
        self._pace.note(threads, time.perf_counter() - start)
        self._moved(which)
        self._steps = self._steps + which

    def halt(self, which: NDArray[np.bool_]) -> None:
        """See :meth:`World.halt`."""
        self._floats[which, m.SPEED, 0] = 0.0
        self._readings.numbers[SPEED, which] = 0.0
        self._moved(which)

    def perceive(self, inflation: NDArray[np.float64], which: NDArray[np.bool_]) -> None:
        """See :meth:`World.perceive`."""
        self._inflation = np.where(which, inflation, self._inflation)
        self._stale[True] |= which

    def ego(self) -> Ego:
        """See :meth:`World.ego`."""
        return self.readings().ego()

    def readings(self) -> Readings:
        """The same in two arrays, which no later call writes into."""
        numbers, flags = self._readings
        return Readings(numbers.copy(), flags.copy())

    def lidar(self, inflated: bool) -> NDArray[np.float32]:
        """See :meth:`World.lidar`; traced when asked for, where something has moved since."""
        stale = self._stale[inflated]
        if stale.any():
            self._keep_returned(inflated)
            self._share(look_around, self._look_arguments(inflated), int(stale.sum()))
            stale[:] = False
        self._returned[inflated] = True
        return self._seen[inflated]

    def sight(self) -> Sight:
        """What lidars are traced from and into, for a loop that traces those it reads."""
        for inflated in (False, True):
            self._keep_returned(inflated)
        return Sight(
            self._floats,
            self._worlds,
            self._inflation,
            self._directions,
            float(self.scene.lidar_range),
            self._seen[False],
            self._stale[False],
            self._seen[True],
            self._stale[True],
        )

    def _keep_returned(self, inflated: bool) -> None:
        if self._returned[inflated]:
            self._seen[inflated] = self._seen[inflated].copy()
            self._returned[inflated] = False

    def _moved(self, which: NDArray[np.bool_]) -> None:
        for stale in self._stale.values():
            stale |= which

    def snapshot(self, world: int) -> Snapshot:
        """See :meth:`World.snapshot`."""
        f, vehicles = self._floats[world], int(self._worlds[world, m.VEHICLES])
        return Snapshot(
            time=float(self._steps[world] / self.scene.policy_frequency),
            position=f[[m.X, m.Y], :vehicles].T.copy(),
            heading=f[m.HEADING, :vehicles].copy(),
            speed=f[m.SPEED, :vehicles].copy(),
            crashed=self._integers[world, m.CRASHED, :vehicles] == 1,
            obstacles=f[[m.X, m.Y], vehicles : vehicles + 1].T.copy(),
        )

    def sharing(self, worlds: int) -> int:
        """Threads for a loop in which so many worlds have something to do."""
        return self._pace.threads(self.threads) if worlds >= 2 * WORTH_A_THREAD else 1

    def _share(self, kernel: Any, arguments: tuple[Any, ...], worlds: int) -> None:
        share(kernel, self.num_worlds, self.sharing(worlds), *arguments)

    def _begin_arguments(
        self, seeds: NDArray[np.uint64], which: NDArray[np.bool_]
    ) -> tuple[Any, ...]:
        scene, speeds = self.scene, self._speeds
        low, high = scene.vehicle_range
        place = self._blocks, self._road, scene.lanes, speeds
        return *place, seeds, which, low, high, self._room, self._readings

    def _step_arguments(
        self, actions: NDArray[np.int64], which: NDArray[np.bool_]
    ) -> tuple[Any, ...]:
        scene, speeds = self.scene, self._speeds
        substeps = scene.simulation_frequency // scene.policy_frequency
        dt = 1 / scene.simulation_frequency
        place = self._blocks, self._road, scene.lanes, speeds
        return *place, actions, which, substeps, dt, self._readings

    def _look_arguments(self, inflated: bool) -> tuple[Any, ...]:
        inflation = self._inflation if inflated else np.ones(self.num_worlds)
        reach, seen = float(self.scene.lidar_range), self._seen[inflated]
        stale = self._stale[inflated]
        return self._blocks, stale, inflation, self._directions, reach, seen

    def _prepare(self) -> None:
        """Compile the loops, or load them."""
        none, everywhere = np.zeros(self.num_worlds, np.int64), np.ones(self.num_worlds, np.bool_)
        progress = np.zeros(2, np.int64)
        calls: dict[Any, tuple[Any, ...]] = {
            begin_worlds: self._begin_arguments(none.view(np.uint64), everywhere),
            step_worlds: self._step_arguments(none, everywhere),
            look_around: self._look_arguments(inflated=True),
            fill_directions: (self._directions,),
        }
        prepare([(each, (progress, *arguments)) for each, arguments in calls.items()])

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Load a copy, with fewer threads where fewer are allowed, and arrays of its own.

        joblib hands large arrays to its workers as read-only memory maps.
        """
        self.__dict__.update({name: _writeable(value) for name, value in state.items()})
        self._blocks = self._floats, self._integers, self._worlds
        self.threads = min(self.threads, available())
        self._prepare()


def _writeable(value: Any) -> Any:
    """``value`` with copies in place of arrays that cannot be written to."""
    if isinstance(value, np.ndarray):
        return value if value.flags.writeable else value.copy()
    if type(value) is tuple:
        return tuple(_writeable(each) for each in value)
    if type(value) is dict:
        return {name: _writeable(each) for name, each in value.items()}
    return value
