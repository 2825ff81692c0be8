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
from hmi_marl.envs.team_step import Before, Decided, Moved, Rewarded, Settings
from hmi_marl.envs.worlds import World

FEW = 16
"""Teams below which a world that is not compiled is not worth compiling the loops for."""

Group = tuple[NDArray[np.float32], Columns]
"""Rows of one observation, shape (M, D), and its columns."""


class Execution(Protocol):
    """A way to apply the rules of :mod:`hmi_marl.envs.team_step` and to write observations."""

    def decide(self, before: Before, window: int, effects: Effects, decided: Decided) -> None:
        """Apply :func:`team_step.decide` to every team."""

    def reward(self, moved: Moved, settings: Settings, rewarded: Rewarded) -> None:
        """Apply :func:`team_step.reward` to every team."""

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

    def decide(self, before: Before, window: int, effects: Effects, decided: Decided) -> None:
        """See :meth:`Execution.decide`."""
        with np.errstate(over="ignore"):  # random bits are arithmetic modulo 2^64
            team_step.decide(EVERY, before, window, effects, decided)

    def reward(self, moved: Moved, settings: Settings, rewarded: Rewarded) -> None:
        """See :meth:`Execution.reward`."""
        team_step.reward(EVERY, moved, settings, rewarded)

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


def with_lidars(world: World, shown: Shown, groups: tuple[Group, ...]) -> Shown:
    """Return ``shown`` with the lidars that the groups read, as :meth:`World.lidar` gives them."""
    lidars: Mapping[str, Any] = {
        name: np.ascontiguousarray(world.lidar(inflated), np.float32).reshape(len(shown.speed), -1)
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
