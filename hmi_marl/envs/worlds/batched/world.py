"""N compiled merges behind the World interface."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from hmi_marl.envs.copies import writeable
from hmi_marl.envs.scene import Scene, number_of_draws
from hmi_marl.envs.worlds.base import SPEED, Ego, Readings, Snapshot
from hmi_marl.envs.worlds.batched import memory as m
from hmi_marl.envs.worlds.batched.compiler import prepare
from hmi_marl.envs.worlds.batched.kernels import (
    CHANGED,
    Merges,
    Room,
    begin_worlds,
    fill_directions,
    look_around,
    step_worlds,
)
from hmi_marl.envs.worlds.batched.lanes import lane_table
from hmi_marl.envs.worlds.batched.threads import (
    WORTH_A_THREAD,
    Pace,
    available,
    new_progress,
    share,
)

_CARRAY: tuple[Literal["C", "A", "W"], ...] = ("C", "A", "W")
"""Requirements of the compiled loops: arrays in one piece that can be written to."""
_LIDARS = {False: "true_lidar", True: "perceived_lidar"}
"""Names of the lidars, by whether others are inflated."""


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
        lanes, table = lane_table(scene)
        high = scene.vehicle_range[1]
        objects = high + 3  # the driven car, the one on the ramp and the obstacle
        self._floats = np.zeros((num_worlds, m.FLOATS, objects))
        self._integers = np.zeros((num_worlds, m.INTEGERS, objects), np.int32)
        self._worlds = np.zeros((num_worlds, m.WORLD_INTEGERS), np.int32)
        cells = (num_worlds, scene.lidar_cells, 2)
        self._merges = Merges(
            self._floats,
            self._integers,
            self._worlds,
            lanes,
            table,
            rows=scene.lanes,
            speeds=np.array(scene.target_speeds),
            substeps=scene.simulation_frequency // scene.policy_frequency,
            dt=1 / scene.simulation_frequency,
            steps=np.zeros(num_worlds, np.int64),
            numbers=np.zeros((num_worlds, 8)),
            flags=np.zeros((num_worlds, 2), np.int64),
            inflation=np.ones(num_worlds),
            directions=np.zeros((scene.lidar_cells, 2)),
            lidar_range=float(scene.lidar_range),
            true_lidar=np.zeros(cells, np.float32),
            true_news=np.full(num_worlds, CHANGED, np.uint8),
            perceived_lidar=np.zeros(cells, np.float32),
            perceived_news=np.full(num_worlds, CHANGED, np.uint8),
        )
        self.room = Room(
            np.zeros((num_worlds, number_of_draws(high))),
            np.zeros((num_worlds, high), np.int64),
            np.zeros((num_worlds, 2, high)),
            *scene.vehicle_range,
        )
        """Room for drawing scenes."""
        self._returned = dict.fromkeys(_LIDARS.values(), False)
        """Whether a lidar was returned as it is now, so that it must not be written into."""
        self._prepare()
        share(fill_directions, scene.lidar_cells, 1, self._merges.directions)
        everywhere = np.arange(num_worlds)
        self.begin(everywhere, np.zeros(num_worlds, np.uint64), np.ones(num_worlds))

    @property
    def bytes_per_world(self) -> int:
        """Memory that each world takes, without the arrays it has returned."""
        arrays = (*self._merges, *self.room)
        sizes = [each.nbytes for each in arrays if isinstance(each, np.ndarray)]
        return sum(sizes) // self.num_worlds

    def reset(
        self, seeds: NDArray[np.uint64], inflation: NDArray[np.float64], which: NDArray[np.bool_]
    ) -> None:
        """See :meth:`World.reset`."""
        worlds = np.flatnonzero(which)
        self.begin(worlds, np.asarray(seeds)[worlds], np.asarray(inflation)[worlds])

    def begin(
        self, worlds: NDArray[np.int64], seeds: NDArray[np.uint64], inflation: NDArray[np.float64]
    ) -> None:
        """The same for worlds named by their numbers; all arguments have the same shape."""
        self._keep_returned()
        arguments = self._begin_arguments(worlds, seeds, inflation)
        share(begin_worlds, len(worlds), self.sharing(len(worlds)), *arguments)

    def step(self, actions: NDArray[np.int64], which: NDArray[np.bool_]) -> None:
        """See :meth:`World.step`."""
        which = np.require(which, np.bool_, _CARRAY)
        actions = np.require(actions, np.int64, _CARRAY)
        self._keep_returned()
        self.take_step(step_worlds, self._merges, actions, which)

    def take_step(self, loop: Any, *arguments: Any) -> None:
        """Run a loop that steps the worlds, on one thread or several, whichever is faster."""
        self._pace.run(loop, self.num_worlds, self.threads, *arguments)

    def halt(self, which: NDArray[np.bool_]) -> None:
        """See :meth:`World.halt`."""
        self._floats[which, m.SPEED, 0] = 0.0
        self._merges.numbers[which, SPEED] = 0.0
        self._merges.true_news[which] = CHANGED
        self._merges.perceived_news[which] = CHANGED

    def perceive(self, inflation: NDArray[np.float64], which: NDArray[np.bool_]) -> None:
        """See :meth:`World.perceive`."""
        np.copyto(self._merges.inflation, inflation, where=which)
        self._merges.perceived_news[which] = CHANGED

    def ego(self) -> Ego:
        """See :meth:`World.ego`."""
        return self.readings().ego()

    def readings(self) -> Readings:
        """The same in two arrays, which no later call writes into."""
        return Readings(self._merges.numbers.copy(), self._merges.flags.copy())

    def lidar(self, inflated: bool) -> NDArray[np.float32]:
        """See :meth:`World.lidar`; traced when asked for, where something has moved since.

        It cannot be written to, since unless something moves it is shown again.
        """
        name = _LIDARS[inflated]
        news = self._merges.perceived_news if inflated else self._merges.true_news
        changed = int((news == CHANGED).sum())
        if changed:
            self._keep_returned()
            threads = self.sharing(changed)
            share(look_around, self.num_worlds, threads, self._merges, not inflated, inflated)
        self._returned[name] = True
        shown: NDArray[np.float32] = getattr(self._merges, name).view()
        shown.flags.writeable = False
        return shown

    def arrays(self) -> Merges:
        """The worlds as loops see them, for loops elsewhere that step them or trace lidars."""
        self._keep_returned()
        return self._merges

    def _keep_returned(self) -> None:
        """Leave the lidars that were returned to their holders, and go on with copies."""
        copies = {
            name: getattr(self._merges, name).copy()
            for name in self._returned
            if self._returned[name]
        }
        if copies:
            self._merges = self._merges._replace(**copies)
            self._returned = dict.fromkeys(self._returned, False)

    def snapshot(self, world: int) -> Snapshot:
        """See :meth:`World.snapshot`."""
        f, vehicles = self._floats[world], int(self._worlds[world, m.VEHICLES])
        return Snapshot(
            time=float(self._merges.steps[world] / self.scene.policy_frequency),
            position=f[[m.X, m.Y], :vehicles].T.copy(),
            heading=f[m.HEADING, :vehicles].copy(),
            speed=f[m.SPEED, :vehicles].copy(),
            crashed=self._integers[world, m.CRASHED, :vehicles] == 1,
            obstacles=f[[m.X, m.Y], vehicles : vehicles + 1].T.copy(),
        )

    def sharing(self, worlds: int) -> int:
        """Threads for a loop in which so many worlds have something to do."""
        return self._pace.threads(self.threads) if worlds >= 2 * WORTH_A_THREAD else 1

    def _begin_arguments(
        self, worlds: NDArray[np.int64], seeds: NDArray[np.uint64], inflation: NDArray[np.float64]
    ) -> tuple[Any, ...]:
        seeds = np.require(seeds, np.uint64, _CARRAY)
        inflation = np.require(inflation, np.float64, _CARRAY)
        return self._merges, self.room, worlds, seeds, inflation

    def _prepare(self) -> None:
        """Compile the loops, or load them."""
        none, everywhere = np.zeros(self.num_worlds, np.int64), np.ones(self.num_worlds, np.bool_)
        begin = self._begin_arguments(none, none.view(np.uint64), np.ones(self.num_worlds))
        calls: dict[Any, tuple[Any, ...]] = {
            begin_worlds: begin,
            step_worlds: (self._merges, none, everywhere),
            look_around: (self._merges, True, False),
            fill_directions: (self._merges.directions,),
        }
        progress = new_progress()
        prepare([(each, (progress, *arguments)) for each, arguments in calls.items()])

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Load a copy, with fewer threads where fewer are allowed, and arrays of its own.

        joblib hands large arrays to its workers as read-only memory maps.
        """
        self.__dict__.update(writeable(state))
        self._floats, self._integers, self._worlds = self._merges[:3]
        self.threads = min(self.threads, available())
        self._prepare()
