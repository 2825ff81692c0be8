"""Ways to take the step of N teams: by NumPy on arrays, or in compiled loops, for any world.

All give the same numbers to the last bit, by the same rules (:mod:`hmi_marl.envs.team_step`,
:mod:`hmi_marl.envs.observation_values`). NumPy suits a few teams in a world that is not compiled,
where numba need not be imported; the loops (:mod:`hmi_marl.envs.loops`) suit all else.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hmi_marl.envs import team_step
from hmi_marl.envs.config import DRIVER, VEHICLE_AI
from hmi_marl.envs.copies import OwnArrays
from hmi_marl.envs.elementwise import EVERY
from hmi_marl.envs.observation_values import Shown, write
from hmi_marl.envs.series import Series
from hmi_marl.envs.team_arrays import NO_SCORES, After, Group, Rules, Teams, lidars_shown
from hmi_marl.envs.team_step import Scores
from hmi_marl.envs.worlds import VEHICLE_ACTIONS, World
from hmi_marl.envs.worlds.base import CRASHED, SPEED, Readings


class WrongActionError(ValueError):
    """An action that is none; ``team``, ``column`` and ``value`` say which."""

    def __init__(self, actions: NDArray[Any], team: int, column: int) -> None:
        self.team, self.column, self.value = int(team), int(column), actions[team, column]
        super().__init__(f"action {self.value} of team {team} in column {column} is none")


class Execution(OwnArrays, ABC):
    """A way to take steps and to write observations of N teams in a world.

    Args:
        world: with N copies of a scene.
        rules: constants of the settings.
    """

    def __init__(self, world: World, rules: Rules) -> None:
        self.world, self.rules = world, rules
        self._readings = Readings.of(world.ego())
        self._every = np.arange(world.num_worlds)
        self._everywhere = np.ones(world.num_worlds, np.bool_)
        self._no_lidar = np.zeros((0, world.scene.lidar_cells, 2), np.float32)
        self._choices = len(VEHICLE_ACTIONS), len(rules.effects.strengths)

    @property
    def bytes_per_team(self) -> int:
        """Memory that is kept for each team."""
        return 0

    @property
    def readings(self) -> Readings:
        """The driven cars; later steps may write into these arrays."""
        return self._readings

    @abstractmethod
    def whole(self, actions: NDArray[Any], sizes: tuple[int, ...]) -> NDArray[np.int64]:
        """Return actions of shape (N, C), of any number type, as int64 of shape (C, N).

        Raises:
            WrongActionError: one is not a whole number from 0 to its column's size - 1.
        """

    @abstractmethod
    def enter(
        self,
        teams: Teams,
        intents: NDArray[np.int64] | None,
        alerts: NDArray[np.int64] | None,
        acts: NDArray[np.bool_] | None = None,
    ) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
        """Take the actions of one seat or both.

        Args:
            teams: the drivers' actions are written into them.
            intents: a^H, shape (N,); None if the drivers do not act now.
            alerts: a^A, shape (N,); None if the HMIs do not act now.
            acts: teams whose drivers act now, unless they are over; None for every team, and with
                alerts.

        Returns:
            Which teams take a step, shape (N,), and their alerts, 0 for the others; to be read if
            there are alerts.

        Raises:
            ValueError: a driver has acted already, or has not when its HMI acts, or an action is
                none. Nothing has changed then.
        """

    @abstractmethod
    def decide(
        self,
        teams: Teams,
        active: NDArray[np.bool_],
        alert: NDArray[np.int64],
        state: NDArray[np.int64],
    ) -> None:
        """Fill in the next state by :func:`team_step.decide`."""

    @abstractmethod
    def reward(
        self,
        teams: Teams,
        active: NDArray[np.bool_],
        alert: NDArray[np.int64],
        state: NDArray[np.int64],
        after: After,
    ) -> None:
        """Fill in rewards and ends, and add to totals, by :func:`team_step.reward`."""

    @abstractmethod
    def write(
        self,
        teams: Teams,
        which: NDArray[np.int64],
        groups: tuple[Group, ...],
    ) -> None:
        """Write observations of M teams, tracing the lidars that they show.

        Args:
            teams: all teams.
            which: numbers of the M teams.
            groups: what to write, with M rows each.
        """

    def step(
        self,
        teams: Teams,
        intents: NDArray[np.int64] | None,
        alerts: NDArray[np.int64],
        state: NDArray[np.int64],
        groups: tuple[Group, ...] = (),
        finals: tuple[Group, ...] = (),
        series: Series | None = None,
        scores: Scores = NO_SCORES,
    ) -> After:
        """Take a step.

        Args:
            teams: before the step; written into, but for what is in ``state``.
            intents: a^H_t, shape (N,); None if the drivers have acted already.
            alerts: a^A_t, shape (N,).
            state: of the teams after the step, to be filled in.
            groups: observations after the step, to be written for every team.
            finals: observations at the end of episodes, to be written in the rows of those teams
                whose episode ends; read only if there are ``series``.
            series: of episodes. Teams whose episode ends begin their next one at once; without
                series they stay as they are. Call :meth:`Series.look_ahead` before.
            scores: to be filled in.

        Raises:
            ValueError: see :meth:`enter`. Nothing has changed then. After any other error the
                drivers may have acted.
        """
        active, alert = self.enter(teams, intents, alerts)
        self.decide(teams, active, alert, state)
        self._move_world(active, state[:, team_step.APPLIED])
        after = After.new(len(alert))
        self.reward(teams, active, alert, state, after)
        if len(scores.dones):
            team_step.score(EVERY, after.rewards, after.ends, scores)
        teams.over[:] = after.ends[:, team_step.OVER]
        teams.intent_given[:] = False
        now = teams._replace(state=state)
        which = np.flatnonzero(after.ends[:, team_step.ENDED])
        if series is not None and len(which):
            if finals:
                self._write_some(now, which, finals)
            after = after._replace(last_totals=teams.totals.copy())
            self.begin(now, which, *series.go_on(which))
        if groups:
            self.write(now, self._every, groups)
        return after

    def _write_some(
        self, teams: Teams, which: NDArray[np.int64], groups: tuple[Group, ...]
    ) -> None:
        """Write the observations of some teams into their rows among those of all teams."""
        some = tuple(group.another(group.rows[which]) for group in groups)
        self.write(teams, which, some)
        for group, written in zip(groups, some, strict=True):
            group.rows[which] = written.rows

    def begin(
        self,
        teams: Teams,
        which: NDArray[np.int64],
        seeds: NDArray[np.uint64],
        traits: NDArray[np.float64],
    ) -> None:
        """Begin episodes in M teams.

        Args:
            teams: written into.
            which: numbers of the M teams.
            seeds: of the episodes, shape (M,).
            traits: of their drivers, shape (M, 4).
        """
        team_step.begin(
            which, seeds, traits, team_step.AT_START, *teams, np.zeros(team_step.TOTALS)
        )
        self._begin_world(teams, which, seeds, traits[:, team_step.INFLATION])

    def _begin_world(
        self,
        teams: Teams,
        which: NDArray[np.int64],
        seeds: NDArray[np.uint64],
        inflation: NDArray[np.float64],
    ) -> None:
        marks = np.zeros(len(teams.over), np.bool_)
        marks[which] = True
        # Copies, since a world may keep them.
        inflations = teams.traits[:, team_step.INFLATION].copy()
        self.world.reset(teams.seeds.copy(), inflations, marks)
        self._readings = Readings.of(self.world.ego())

    def refuse(
        self,
        refused: Sequence[int],
        intents: NDArray[np.int64] | None,
        alerts: NDArray[np.int64] | None,
    ) -> None:
        """Raise ValueError for the first reason; see :mod:`action_loops` for reasons and teams."""
        twice, no_intent, too_early, no_alert = refused
        if twice >= 0:
            raise ValueError("the drivers have already acted in this step; now alert with step()")
        if intents is not None and no_intent >= 0:
            raise _none_of(DRIVER, intents[no_intent], self._choices[0])
        if too_early >= 0:
            raise ValueError("the driver acts first: call intend() with the driver's action")
        if alerts is not None and no_alert >= 0:
            raise _none_of(VEHICLE_AI, alerts[no_alert], self._choices[1])

    def _move_world(self, active: NDArray[np.bool_], applied: NDArray[np.int64]) -> None:
        """Move the cars, but those that are crashed: these stand."""
        numbers, flags = self._readings
        standing = active & (flags[:, CRASHED] == 1)
        newly_standing = standing & (numbers[:, SPEED] != 0.0)
        if newly_standing.any():
            self.world.halt(newly_standing)
        self.world.step(applied.copy(), active & ~standing)
        self._readings = Readings.of(self.world.ego())

    def _shown(self, teams: Teams, groups: tuple[Group, ...]) -> Shown:
        """What observations show, with those lidars that the groups read."""
        true, perceived = (
            self._lidar(inflated) if wanted else self._no_lidar
            for inflated, wanted in zip((False, True), lidars_shown(groups), strict=True)
        )
        return Shown(true, perceived, *self.readings, teams.state, teams.intent_given, teams.traits)

    def _lidar(self, inflated: bool) -> NDArray[np.float32]:
        """A lidar of every team, shape (N, cells, 2); compiled loops take no read-only arrays."""
        return np.require(self.world.lidar(inflated), np.float32, ("C", "A", "W"))


def _none_of(agent: str, action: int, choices: int) -> ValueError:
    return ValueError(f"{agent} action {action} is out of range: it is one of 0 to {choices - 1}")


class InNumPy(Execution):
    """Apply the rules to the arrays of all teams at once."""

    def whole(self, actions: NDArray[Any], sizes: tuple[int, ...]) -> NDArray[np.int64]:
        """See :meth:`Execution.whole`."""
        with np.errstate(invalid="ignore"):  # NaN, which is found next
            whole = actions.astype(np.int64)
        wrong = (whole != actions) | (whole < 0) | (whole >= sizes)
        if wrong.any():
            column, team = np.argwhere(wrong.T)[0]
            raise WrongActionError(actions, team, column)
        return np.ascontiguousarray(whole.T)

    def enter(
        self,
        teams: Teams,
        intents: NDArray[np.int64] | None,
        alerts: NDArray[np.int64] | None,
        acts: NDArray[np.bool_] | None = None,
    ) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
        """See :meth:`Execution.enter`."""
        state, given = teams.state, teams.intent_given
        on = ~teams.over if acts is None else acts & ~teams.over
        nowhere = np.zeros_like(on)
        refused = [
            nowhere if intents is None else on & given,
            nowhere if intents is None else on & ((intents < 0) | (intents >= self._choices[0])),
            nowhere if alerts is None or intents is not None else on & ~given,
            nowhere if alerts is None else on & ((alerts < 0) | (alerts >= self._choices[1])),
        ]
        first = [int(each.argmax()) if each.any() else -1 for each in refused]
        self.refuse(first, intents, alerts)
        if intents is not None:
            np.copyto(state[:, team_step.PREVIOUS], state[:, team_step.INTENDED], where=on)
            np.copyto(state[:, team_step.INTENDED], intents, where=on)
            given |= on
        return on, np.where(on, 0 if alerts is None else alerts, 0)

    def decide(
        self,
        teams: Teams,
        active: NDArray[np.bool_],
        alert: NDArray[np.int64],
        state: NDArray[np.int64],
    ) -> None:
        """See :meth:`Execution.decide`."""
        window, effects = self.rules.window, self.rules.effects
        before, traits, seeds, *_ = teams
        with np.errstate(over="ignore"):  # random bits are arithmetic modulo 2^64
            team_step.decide(EVERY, active, alert, before, seeds, traits, window, effects, state)

    def reward(
        self,
        teams: Teams,
        active: NDArray[np.bool_],
        alert: NDArray[np.int64],
        state: NDArray[np.int64],
        after: After,
    ) -> None:
        """See :meth:`Execution.reward`."""
        settings, totals, before = self.rules.settings, teams.totals, teams.state
        numbers, flags = self._readings
        rewards, ends = after.rewards, after.ends
        team_step.reward(
            EVERY, active, alert, before, state, numbers, flags, settings, rewards, ends, totals
        )

    def write(
        self,
        teams: Teams,
        which: NDArray[np.int64],
        groups: tuple[Group, ...],
    ) -> None:
        """See :meth:`Execution.write`."""
        shown = self._shown(teams, groups)
        for group in groups:
            write(group.rows, EVERY, group.first, which, shown, self.rules.scales)
