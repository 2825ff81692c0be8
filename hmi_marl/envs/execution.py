"""Two ways to apply the rules of a step to N teams: on arrays in NumPy, or in compiled loops.

Both give the same numbers to the last bit. NumPy suits a few teams in a world that is not compiled,
where numba need not be imported; the loops suit all else.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from hmi_marl.envs import observation_values, team_step
from hmi_marl.envs.alerts import Effects
from hmi_marl.envs.elementwise import EVERY
from hmi_marl.envs.observation_values import Columns, Scales, Shown
from hmi_marl.envs.team_step import OVER, SUMS, Settings
from hmi_marl.envs.worlds import World
from hmi_marl.envs.worlds.base import Readings

FEW = 16
"""Teams below which a world that is not compiled is not worth compiling the loops for."""

Group = tuple[NDArray[np.float32], Columns]
"""Rows of one observation, shape (M, D), and its columns."""


class Execution(Protocol):
    """A way to apply the rules of :mod:`hmi_marl.envs.team_step` and to write observations."""

    def decide(
        self,
        active: NDArray[np.bool_],
        alert: NDArray[np.int64],
        state: NDArray[np.int64],
        seeds: NDArray[np.uint64],
        traits: NDArray[np.float64],
        window: int,
        effects: Effects,
    ) -> NDArray[np.int64]:
        """Return the state after :func:`team_step.decide` of every team."""

    def reward(
        self,
        active: NDArray[np.bool_],
        alert: NDArray[np.int64],
        state: NDArray[np.int64],
        after: NDArray[np.int64],
        readings: Readings,
        settings: Settings,
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Return the rewards and ends that :func:`team_step.reward` gives every team."""

    def write(
        self,
        world: World,
        teams: NDArray[np.int64],
        shown: Shown,
        scales: Scales,
        groups: tuple[Group, ...],
    ) -> None:
        """Write observations of some teams, lidars included that ``groups`` show.

        Args:
            world: traces the lidars.
            teams: numbers of M teams.
            shown: what is shown; its lidars need not be filled in.
            scales: constants of the settings.
            groups: what to write into.
        """


class InNumPy:
    """Apply the rules to the arrays of all teams at once."""

    def decide(
        self,
        active: NDArray[np.bool_],
        alert: NDArray[np.int64],
        state: NDArray[np.int64],
        seeds: NDArray[np.uint64],
        traits: NDArray[np.float64],
        window: int,
        effects: Effects,
    ) -> NDArray[np.int64]:
        """See :meth:`Execution.decide`."""
        after = np.empty_like(state)
        with np.errstate(over="ignore"):  # random bits are arithmetic modulo 2^64
            team_step.decide(EVERY, active, alert, state, seeds, traits, window, effects, after)
        return after

    def reward(
        self,
        active: NDArray[np.bool_],
        alert: NDArray[np.int64],
        state: NDArray[np.int64],
        after: NDArray[np.int64],
        readings: Readings,
        settings: Settings,
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """See :meth:`Execution.reward`."""
        rewards, ends = new_rewards(len(active))
        team_step.reward(EVERY, active, alert, state, after, *readings, settings, rewards, ends)
        return rewards, ends

    def write(
        self,
        world: World,
        teams: NDArray[np.int64],
        shown: Shown,
        scales: Scales,
        groups: tuple[Group, ...],
    ) -> None:
        """See :meth:`Execution.write`."""
        shown = with_lidars(world, shown, groups)
        for rows, columns in groups:
            observation_values.write(rows, EVERY, columns, teams, shown, scales)


def new_rewards(num_teams: int) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Arrays for :func:`team_step.reward` to fill in."""
    return np.empty((SUMS, num_teams)), np.empty((OVER + 1, num_teams), np.bool_)


def with_lidars(world: World, shown: Shown, groups: tuple[Group, ...]) -> Shown:
    """Return ``shown`` with the lidars that the groups read, as :meth:`World.lidar` gives them."""
    lidars: Mapping[str, Any] = {
        name: np.ascontiguousarray(world.lidar(inflated), np.float32).reshape(
            len(shown.intent_given), -1
        )
        for name, inflated in (("true_lidar", False), ("perceived_lidar", True))
        if any(getattr(columns, name) for _, columns in groups)
    }
    return shown._replace(**lidars)


def execution_for(world: World, num_teams: int) -> Execution:
    """Return the way that suits a world and a number of teams."""
    if num_teams < FEW and not hasattr(world, "sight"):
        return InNumPy()
    from hmi_marl.envs.loops import Compiled  # numba is slow to import

    return Compiled()
