"""What HMIs that cannot see attention keep from turn to turn: p(d) under each driver model."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import Driver
from hmi_marl.envs.observations import vehicle_ai_layout
from hmi_marl.envs.teaming import NO_ACTION
from hmi_marl.exact.bayes_filter import BayesFilter
from hmi_marl.exact.evidence import ChainEvidence


class AttentionWatch:
    """Follows N teams through their episodes, turn by turn.

    Args:
        drivers: the models under which p(d) is kept.
        config: of the teams.
    """

    def __init__(self, drivers: Sequence[str | Driver], config: TeamConfig) -> None:
        self._evidence = ChainEvidence(drivers, config)
        self._layout = vehicle_ai_layout(config)
        self._horizon = config.horizon
        self.reset(1)

    @property
    def filter(self) -> BayesFilter:
        """Holds p_k(d_{t-1} = 1), i_{t-1} and c_{t-1}."""
        return self._evidence.filter

    def reset(self, count: int, which: NDArray[np.bool_] | None = None) -> None:
        """Episodes begin in the marked teams out of ``count``; in all by default."""
        if which is None:
            self._evidence.reset(count)
            self._seen = np.full(count, -1)
        else:
            self._evidence.begin(which)
            self._seen = np.where(which, -1, self._seen)

    def observe(self, observations: NDArray[np.float32]) -> NDArray[np.int64]:
        """Take in a turn, shape (N, D); returns its step in the episode, shape (N,)."""
        step = step_of(self._layout.scalar(observations, "time"), self._horizon)
        self._evidence.observe(observations, step > self._seen)
        self._seen = step
        return step

    def reveals(self, observations: NDArray[np.float32]) -> NDArray[np.bool_]:
        """Whether the step will show d: a^H_t, seen taking turns, differs from v_{t-1}; (N,)."""
        applied = self._layout.chosen(observations, "applied_action")
        intended = self._layout.chosen(observations, "intended_action")
        return (applied != NO_ACTION) & (intended != applied)


def step_of(time: NDArray[np.float32], horizon: int) -> NDArray[np.int64]:
    """Steps taken, from the share of the episode that is over; the last step's at its end."""
    return np.minimum(np.rint(time * horizon).astype(np.int64), horizon - 1)
