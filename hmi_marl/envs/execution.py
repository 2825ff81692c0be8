"""Ways to take the step of N teams: by NumPy on arrays, or in compiled loops, for any world.

All give the same numbers to the last bit, by the same rules (:mod:`hmi_marl.envs.team_step`,
:mod:`hmi_marl.envs.observation_values`). NumPy suits a few teams in a world that is not compiled,
where numba need not be imported; the loops (:mod:`hmi_marl.envs.loops`) suit all else.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hmi_marl.envs import observation_values, team_step
from hmi_marl.envs.alerts import Effects
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.elementwise import EVERY
from hmi_marl.envs.observation_values import Columns, Scales, Shown, scales_of
from hmi_marl.envs.team_step import OVER, SUMS, Settings, settings_of
from hmi_marl.envs.worlds import World
from hmi_marl.envs.worlds.base import CRASHED, SPEED, Readings

FEW = 16
"""Teams below which a world that is not compiled is not worth compiling the loops for."""


class Rules(NamedTuple):
    """Constants of a team's settings that the rules need."""

    window: int
    """N, in steps."""
    effects: Effects
    settings: Settings
    scales: Scales

    @classmethod
    def of(cls, config: TeamConfig) -> Rules:
        """Constants of these settings."""
        effects = config.alerts.effects
        return cls(config.alert_window, effects, settings_of(config), scales_of(config))


class Teams(NamedTuple):
    """N teams as the rules see them; for the rows see :mod:`team_step`."""

    state: NDArray[np.int64]
    readings: Readings
    traits: NDArray[np.float64]
    seeds: NDArray[np.uint64]
    active: NDArray[np.bool_]
    """Teams whose episode goes on, shape (N,)."""
    intent_given: NDArray[np.bool_]


class Group(NamedTuple):
    """Observations to be written."""

    rows: NDArray[np.float32]
    """Shape (M, D)."""
    columns: Columns


class After(NamedTuple):
    """N teams after a step."""

    state: NDArray[np.int64]
    readings: Readings
    rewards: NDArray[np.float64]
    ends: NDArray[np.bool_]


def new_rewards(num_teams: int) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Arrays for :func:`team_step.reward` to fill in."""
    return np.empty((SUMS, num_teams)), np.empty((OVER + 1, num_teams), np.bool_)


def read_world(world: World) -> Readings:
    """Read the driven cars of any world."""
    read = getattr(world, "readings", None)
    return Readings.of(world.ego()) if read is None else read()


class Execution(ABC):
    """A way to take steps and to write observations of N teams in a world."""

    def __init__(self, world: World, rules: Rules) -> None:
        self.world, self.rules = world, rules
        cells = world.scene.lidar_cells
        self._no_lidar = np.zeros((0, 2 * cells), np.float32)

    @abstractmethod
    def first_wrong(self, actions: NDArray[np.int64], acts: NDArray[np.bool_], choices: int) -> int:
        """First team that acts by a number outside 0 to choices - 1, -1 if there is none."""

    @abstractmethod
    def decide(self, teams: Teams, alert: NDArray[np.int64], after: NDArray[np.int64]) -> None:
        """Fill in ``after`` by :func:`team_step.decide`."""

    @abstractmethod
    def reward(
        self,
        teams: Teams,
        alert: NDArray[np.int64],
        after: NDArray[np.int64],
        readings: Readings,
        rewards: NDArray[np.float64],
        ends: NDArray[np.bool_],
    ) -> None:
        """Fill in ``rewards`` and ``ends`` by :func:`team_step.reward`."""

    @abstractmethod
    def write(self, teams: Teams, which: NDArray[np.int64], groups: tuple[Group, ...]) -> None:
        """Write observations of the M teams in ``which``, tracing the lidars that they show."""

    def step(self, teams: Teams, alert: NDArray[np.int64], groups: tuple[Group, ...] = ()) -> After:
        """Take a step in which both agents have acted.

        Args:
            teams: before the step.
            alert: a^A_t.
            groups: observations after the step, to be written for every team.
        """
        after = np.empty_like(teams.state)
        self.decide(teams, alert, after)
        readings = self._move_world(teams, after)
        rewards, ends = new_rewards(len(alert))
        self.reward(teams, alert, after, readings, rewards, ends)
        if groups:
            none = np.zeros(len(alert), np.bool_)
            then = teams._replace(state=after, readings=readings, intent_given=none)
            self.write(then, np.arange(len(alert)), groups)
        return After(after, readings, rewards, ends)

    def _move_world(self, teams: Teams, after: NDArray[np.int64]) -> Readings:
        """Move the cars, but those that are crashed: these stand."""
        numbers, flags = teams.readings
        standing = teams.active & (flags[CRASHED] == 1)
        newly_standing = standing & (numbers[SPEED] != 0.0)
        if newly_standing.any():
            self.world.halt(newly_standing)
        self.world.step(after[team_step.APPLIED], teams.active & ~standing)
        return read_world(self.world)

    def _shown(self, teams: Teams, groups: tuple[Group, ...]) -> Shown:
        """What observations show, with those lidars that the groups read."""
        count = len(teams.active)
        true, perceived = (
            np.require(self.world.lidar(inflated), np.float32, ("C", "W")).reshape(count, -1)
            if any(group.columns.shows_lidar(inflated) for group in groups)
            else self._no_lidar
            for inflated in (False, True)
        )
        return Shown(
            true, perceived, *teams.readings, teams.state, teams.intent_given, teams.traits
        )


class InNumPy(Execution):
    """Apply the rules to the arrays of all teams at once."""

    def first_wrong(self, actions: NDArray[np.int64], acts: NDArray[np.bool_], choices: int) -> int:
        """See :meth:`Execution.first_wrong`."""
        wrong = acts & ((actions < 0) | (actions >= choices))
        return int(wrong.argmax()) if wrong.any() else -1

    def decide(self, teams: Teams, alert: NDArray[np.int64], after: NDArray[np.int64]) -> None:
        """See :meth:`Execution.decide`."""
        window, effects = self.rules.window, self.rules.effects
        state, _, traits, seeds, active, _ = teams
        with np.errstate(over="ignore"):  # random bits are arithmetic modulo 2^64
            team_step.decide(EVERY, active, alert, state, seeds, traits, window, effects, after)

    def reward(
        self,
        teams: Teams,
        alert: NDArray[np.int64],
        after: NDArray[np.int64],
        readings: Readings,
        rewards: NDArray[np.float64],
        ends: NDArray[np.bool_],
    ) -> None:
        """See :meth:`Execution.reward`."""
        settings = self.rules.settings
        team_step.reward(
            EVERY, teams.active, alert, teams.state, after, *readings, settings, rewards, ends
        )

    def write(self, teams: Teams, which: NDArray[np.int64], groups: tuple[Group, ...]) -> None:
        """See :meth:`Execution.write`."""
        shown = self._shown(teams, groups)
        for rows, columns in groups:
            observation_values.write(rows, EVERY, columns, which, shown, self.rules.scales)


def execution_for(world: World, num_teams: int, rules: Rules) -> Execution:
    """Return the way that suits a world and a number of teams."""
    batched = hasattr(world, "take_step")
    if num_teams < FEW and not batched:
        return InNumPy(world, rules)
    from hmi_marl.envs.loops import InLoops, InOneLoop  # numba is slow to import

    return InOneLoop(world, rules) if batched else InLoops(world, rules)
