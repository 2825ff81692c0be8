"""State that policies keep from step to step: nothing, random draws, or beliefs over attention."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import Driver
from hmi_marl.envs.observations import vehicle_ai_layout
from hmi_marl.envs.streams import Stream, uniform
from hmi_marl.exact.bayes_filter import BayesFilter
from hmi_marl.exact.evidence import ChainEvidence
from hmi_marl.exact.signalling import reveals


class Memoryless:
    """Base class of policies without memory."""

    memoryless = True
    """Whether several environments may share the object."""

    def reset(self, seeds: NDArray[np.uint64], which: NDArray[np.bool_] | None = None) -> None:
        """Do nothing."""


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
        """Return the next draw of every team, shape (N,), in [0, 1).

        Raises:
            RuntimeError: before the first :meth:`reset`.
        """
        if not len(self._seeds):
            raise RuntimeError("a policy that draws needs seeds: call reset(seeds) first")
        drawn = uniform(self._seeds, self._stream, self._steps)
        self._steps += np.uint64(1)
        return drawn


class AttentionWatch:
    """Keep p(d) of N teams under several driver models from the vehicle AI's observations.

    Args:
        drivers: the driver models.
        config: configuration of the teams.
    """

    def __init__(self, drivers: Sequence[str | Driver], config: TeamConfig) -> None:
        self._evidence = ChainEvidence(drivers, config)
        self._layout = vehicle_ai_layout(config)
        self._horizon = config.horizon
        self.reset(1)

    @property
    def filter(self) -> BayesFilter:
        """Filter that holds p_k(d_{t-1} = 1), i_{t-1} and c_{t-1}."""
        return self._evidence.filter

    def reset(self, count: int, which: NDArray[np.bool_] | None = None) -> None:
        """Begin episodes in the marked teams out of ``count``; in all by default."""
        self._evidence.reset(count, which)
        if which is None:
            self._seen = np.full(count, -1)
        else:
            self._seen = np.where(which, -1, self._seen)

    def observe(self, observations: NDArray[np.float32]) -> NDArray[np.int64]:
        """Update with a turn, shape (N, D); return its step in the episode, shape (N,)."""
        step = step_of(self._layout.scalar(observations, "time"), self._horizon)
        self._evidence.observe(observations, step > self._seen)
        self._seen = step
        return step

    def reveals(self, observations: NDArray[np.float32]) -> NDArray[np.bool_]:
        """Return whether the step will reveal d, since a^H_t differs from v_{t-1}; shape (N,)."""
        applied = self._layout.chosen(observations, "applied_action")
        intended = self._layout.chosen(observations, "intended_action")
        return reveals(intended, applied)


def step_of(time: NDArray[np.float32], horizon: int) -> NDArray[np.int64]:
    """Return the step from the elapsed share of the episode; at its end the last step."""
    return np.minimum(np.rint(time * horizon).astype(np.int64), horizon - 1)
