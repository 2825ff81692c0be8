"""Results of a step of N teams, and what follows the end of an episode."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hmi_marl.envs.config import DRIVER, VEHICLE_AI
from hmi_marl.envs.rewards import TERMS
from hmi_marl.envs.series import Series
from hmi_marl.envs.team_step import ENDED, OF_DRIVER, OF_VEHICLE_AI, TERMINATED, TRUNCATED


class Then(NamedTuple):
    """Begin the next episode of its series in each team whose episode ends."""

    series: Series
    views: tuple[str, ...] = ()
    """Observations at the end of the episode to compute."""


class EndedTeams(NamedTuple):
    """M teams whose episode ended in a step."""

    teams: NDArray[np.int64]
    """Their numbers, shape (M,)."""
    views: dict[str, NDArray[np.float32]]
    """What was seen at the end, by name; shape (M, size of the layout) each."""
    totals: NDArray[np.float64]
    """Sums over the episode, (M, 14); for the columns see :mod:`team_step`."""


class StepResult(NamedTuple):
    """Rewards and ends of one step of N teams."""

    table: NDArray[np.float64]
    """Reward terms, each agent's reward and the sum of both, float64 of shape (N, 11); for the
    columns see :mod:`team_step`."""
    ends: NDArray[np.bool_]
    """How the step ended episodes, shape (N, 4); for the columns see :mod:`team_step`."""
    views: Mapping[str, NDArray[np.float32]] = MappingProxyType({})
    """Observations after the step that were asked for, by name; see :meth:`Teaming.views`."""
    ended_teams: EndedTeams | None = None
    """What is known about the episodes that ended, if the next ones have begun already."""

    @property
    def rewards(self) -> dict[str, NDArray[np.float64]]:
        """Reward of each agent, shape (N,)."""
        return {DRIVER: self.table[:, OF_DRIVER], VEHICLE_AI: self.table[:, OF_VEHICLE_AI]}

    @property
    def terms(self) -> dict[str, NDArray[np.float64]]:
        """Value of each reward term, shape (N,)."""
        return dict(zip(TERMS, self.table.T, strict=False))

    @property
    def terminated(self) -> NDArray[np.bool_]:
        """The episode ended by a crash, shape (N,)."""
        return self.ends[:, TERMINATED]

    @property
    def truncated(self) -> NDArray[np.bool_]:
        """The episode's time is over, shape (N,)."""
        return self.ends[:, TRUNCATED]

    @property
    def ended(self) -> NDArray[np.bool_]:
        """The episode ended, one way or the other, shape (N,)."""
        return self.ends[:, ENDED]
