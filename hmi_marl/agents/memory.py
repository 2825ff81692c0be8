"""What simple policies keep from step to step: nothing, or a place in a series of draws."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hmi_marl.envs.streams import Stream, uniform


class Memoryless:
    """A policy that has nothing to forget between episodes."""

    def reset(self, seeds: NDArray[np.uint64], which: NDArray[np.bool_] | None = None) -> None:
        """Nothing to do."""


class Draws:
    """One uniform draw per team and step, from the episode's seed and the step alone."""

    def __init__(self, stream: Stream) -> None:
        self._stream = stream
        self._seeds = np.zeros(0, np.uint64)
        self._steps = np.zeros(0, np.uint64)

    def reset(self, seeds: NDArray[np.uint64], which: NDArray[np.bool_] | None = None) -> None:
        """See :meth:`hmi_marl.envs.seats.Policy.reset`."""
        if which is None:
            self._seeds, self._steps = seeds.copy(), np.zeros(len(seeds), np.uint64)
        else:
            self._seeds = np.where(which, seeds, self._seeds)
            self._steps = np.where(which, np.uint64(0), self._steps)

    def next(self) -> NDArray[np.float64]:
        """The next draw of every team, shape (N,), in [0, 1).

        Raises:
            RuntimeError: before the first :meth:`reset`.
        """
        if not len(self._seeds):
            raise RuntimeError("a policy that draws needs seeds: call reset(seeds) first")
        drawn = uniform(self._seeds, self._stream, self._steps)
        self._steps += np.uint64(1)
        return drawn
