"""What a :class:`hmi_marl.envs.teaming.Teaming` shows of its teams: copies of its arrays."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hmi_marl.envs.attention import Attention
from hmi_marl.envs.drivers import Traits, check_traits
from hmi_marl.envs.execution import Execution
from hmi_marl.envs.team_arrays import Teams
from hmi_marl.envs.team_step import (
    ALERTED,
    APPLIED,
    DISTRACTED,
    FATIGUE,
    INTENDED,
    PREVIOUS,
    STEPS,
)
from hmi_marl.envs.worlds import Ego
from hmi_marl.envs.worlds.base import CRASHED, GAP, SPEED, Readings


class ShownTeams:
    """N teams as others see them. Every array has shape (N,) unless noted."""

    _teams: Teams
    _execution: Execution

    # The arrays of the teams are written into, so these are copies.

    @property
    def seeds(self) -> NDArray[np.uint64]:
        """Seeds of the episodes, uint64."""
        return self._teams.seeds.copy()

    @property
    def over(self) -> NDArray[np.bool_]:
        """Teams without a running episode: ended, or not begun."""
        return self._teams.over.copy()

    @property
    def intent_given(self) -> NDArray[np.bool_]:
        """Teams in mid-turn: the driver has acted, the vehicle AI has not."""
        return self._teams.intent_given.copy()

    @property
    def steps(self) -> NDArray[np.int64]:
        """Steps taken in each team's episode. May be assigned, which moves the teams' clocks."""
        return self._teams.state[:, STEPS].copy()

    @steps.setter
    def steps(self, steps: NDArray[np.int64]) -> None:
        given = np.asarray(steps)
        if given.dtype.kind not in "iu":
            raise TypeError(f"steps are whole numbers, but got {given.dtype}")
        if given.shape != self._teams.over.shape or (given < 0).any():
            raise ValueError(f"steps are {len(self._teams.over)} numbers of at least 0")
        self._teams.state[:, STEPS] = given

    @property
    def intended(self) -> NDArray[np.int64]:
        """The latest a^H of each team, -1 before the first."""
        return self._teams.state[:, INTENDED].copy()

    @property
    def previous_intended(self) -> NDArray[np.int64]:
        """The a^H before the latest one, -1 if there is none."""
        return self._teams.state[:, PREVIOUS].copy()

    @property
    def applied(self) -> NDArray[np.int64]:
        """The latest v, -1 before the first."""
        return self._teams.state[:, APPLIED].copy()

    @property
    def alerted(self) -> NDArray[np.int64]:
        """The latest a^A, 0 to k."""
        return self._teams.state[:, ALERTED].copy()

    @property
    def attention(self) -> Attention:
        """The drivers' attention after the last step."""
        return Attention(*self._teams.state[:, DISTRACTED : FATIGUE + 1].T.copy())

    @property
    def traits(self) -> Traits:
        """The drivers' traits. May be assigned, which does not change what the lidars perceive."""
        return Traits(*self._teams.traits.T.copy())

    @traits.setter
    def traits(self, traits: Traits) -> None:
        self._teams.traits[:] = check_traits(traits, len(self._teams.over)).as_array()

    @property
    def crashed(self) -> NDArray[np.bool_]:
        """Teams whose car is crashed."""
        return self._execution.readings.flags[:, CRASHED] == 1

    @property
    def ego(self) -> Ego:
        """The driven cars."""
        numbers, flags = self._execution.readings
        return Readings(numbers.copy(), flags.copy()).ego()

    def time_headway(self) -> NDArray[np.float64]:
        """Time to the next object ahead in the lane [s], shape (N,); inf if none, or at 0 m/s."""
        numbers = self._execution.readings.numbers
        speed, gap = numbers[:, SPEED], numbers[:, GAP]
        moving = speed > 0
        return np.where(moving, np.maximum(gap, 0.0) / np.where(moving, speed, 1.0), np.inf)
