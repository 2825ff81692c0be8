"""Steps of N teams over any world: the order of moves, the human model, the rewards.

:meth:`Teaming.turn` is a whole step. With sequential moves the driver acts first
(:meth:`Teaming.intend`), so that the vehicle AI's observation holds a^H_t when it acts
(:meth:`Teaming.step`). With simultaneous moves the vehicle AI is asked first, and its observation
still holds a^H_{t-1}.

Each team has its own turn: resetting some teams in mid-turn leaves the others in theirs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hmi_marl.checks import COUNT
from hmi_marl.envs import observations as obs
from hmi_marl.envs.config import DRIVER, VEHICLE_AI, TeamConfig
from hmi_marl.envs.copies import writeable
from hmi_marl.envs.drivers import Traits, check_traits
from hmi_marl.envs.executions import execution_for
from hmi_marl.envs.observation_values import first_columns
from hmi_marl.envs.seen_attention import seen_from_outside
from hmi_marl.envs.shown_teams import ShownTeams
from hmi_marl.envs.step_result import EndedTeams, StepResult, Then
from hmi_marl.envs.team_arrays import NO_SCORES, Group, Room, Rules, Teams
from hmi_marl.envs.team_checks import (
    check_actions,
    check_columns,
    check_mask,
    check_seeds,
    check_series,
    check_team_numbers,
)
from hmi_marl.envs.team_step import (
    AT_START,
    DISTRACTED,
    ENDED,
    INTENDED,
    PREVIOUS,
)
from hmi_marl.envs.worlds import World, fitting_world

Views = Sequence[str] | Room
"""Names of observations, or arrays for them and for rewards; see :meth:`Teaming.room`."""
Actor = NDArray[np.int64] | list[int] | Callable[[NDArray[np.float32]], NDArray[np.int64]]
"""Actions of one seat, shape (N,), or a function that gives them for its observations, (N, D)."""

STATE, TRAITS = "state", "traits"
"""Names of the whole team's state, and of the drivers' traits as they are, among what
:meth:`Teaming.views` gives."""


class Teaming(ShownTeams):
    """N teams of driver and vehicle AI.

    Team k's episode depends on seed k and team k's actions alone.

    Args:
        config: settings of every team.
        num_teams: N.
        world: a world's name, or a World with N copies of ``config.scene``.

    Raises:
        ValueError, TypeError: fewer than one team, or a world that does not fit.
    """

    def __init__(self, config: TeamConfig, num_teams: int = 1, world: str | World = "highway"):
        num_teams = COUNT("num_teams", num_teams)
        self.config = config
        self.alerts = config.alerts
        """Meaning of a^A."""
        self.num_teams = num_teams
        self.world = fitting_world(world, config.scene, num_teams)
        self.layouts = {
            DRIVER: obs.driver_layout(config),
            VEHICLE_AI: obs.vehicle_ai_layout(config),
        }
        self.state_layout = obs.state_layout(config)
        self._layouts = self.layouts | {STATE: self.state_layout, TRAITS: obs.TRAITS_LAYOUT}
        self._unseen = {agent: _nothing(num_teams, each) for agent, each in self.layouts.items()}
        """Observations for policies that read no part of them."""
        self._columns: dict[tuple[str, tuple[str, ...] | None], Group] = {}
        self._scored: dict[tuple[int, ...], NDArray[np.int64]] = {}
        """Columns of rewards, as arrays."""
        self._execution = execution_for(self.world, num_teams, Rules.of(config))
        self._population = config.population
        self._every = np.arange(num_teams)
        self._teams = Teams.new(num_teams)
        self._spare = np.empty_like(self._teams.state)
        """Room for the next state; the two take turns."""
        self._finals: dict[str, Group] = {}
        """Room for observations at the end of episodes."""

    @property
    def bytes_per_team(self) -> int:
        """Memory that each team takes, its batched world included, without what was returned."""
        arrays = (*self._teams, self._spare, *(group.rows for group in self._finals.values()))
        own = sum(array.nbytes for array in arrays) // self.num_teams
        return own + self._execution.bytes_per_team + getattr(self.world, "bytes_per_world", 0)

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Load a copy, with arrays of its own."""
        self.__dict__.update(writeable(state) | {"_columns": {}, "_scored": {}, "_finals": {}})

    def reset(self, seeds: ArrayLike, which: NDArray[np.bool_] | None = None) -> None:
        """Begin new episodes in the teams marked in ``which`` (shape (N,), all by default).

        Args:
            seeds: of the episodes, integers of shape (N,) in [0, 2^64); those of unmarked teams
                are not read.
            which: shape (N,), bool.

        Raises:
            ValueError, TypeError: seeds or a mask that do not fit, or a population that draws
                impossible traits. Nothing has changed then.
        """
        fresh = check_mask(which, self.num_teams)
        teams = np.flatnonzero(fresh)
        self.begin(teams, check_seeds(seeds, fresh)[teams])

    def begin(self, teams: NDArray[np.int64], seeds: NDArray[np.uint64]) -> None:
        """Begin new episodes in M teams.

        Args:
            teams: their numbers, int64 of shape (M,), each once.
            seeds: of their episodes, uint64 of shape (M,).

        Raises:
            ValueError, TypeError: a population that draws impossible traits. Nothing has changed.
        """
        teams = check_team_numbers(teams, self.num_teams)
        seeds = np.require(seeds, np.uint64, ("C", "A", "W"))
        if seeds.shape != teams.shape:
            raise ValueError(f"seeds of {len(teams)} teams have shape {teams.shape}")
        if not len(teams):
            return
        drawn = check_traits(self._population.draw(seeds), len(teams)).as_array()
        self._execution.begin(self._teams, teams, seeds, drawn)

    def hand_over(self, traits: Traits, which: NDArray[np.bool_] | None = None) -> None:
        """Change drivers in mid-episode. The new ones are attentive; car, time and v stay.

        Args:
            traits: of N drivers; those of unmarked teams are not used.
            which: the teams that change drivers, shape (N,), bool; all by default.

        Raises:
            ValueError, TypeError: impossible traits, a mask that does not fit, or a turn that has
                begun: another driver would carry out its intent. Nothing has changed then.
        """
        fresh = check_mask(which, self.num_teams)
        if (fresh & self.intent_given).any():
            raise ValueError("the wheel is handed over between turns; alert with step() first")
        new = check_traits(traits, self.num_teams).as_array()
        self._teams.traits[fresh] = new[fresh]
        self._teams.state[fresh, DISTRACTED:] = AT_START[DISTRACTED:]
        self.world.perceive(self.traits.inflation, fresh)

    def turn(
        self,
        driver: Actor,
        hmi: Actor,
        sequential: bool = True,
        views: Views = (),
        then: Then | None = None,
        looking_away: ArrayLike | None = None,
    ) -> StepResult:
        """Take one step of every team, each seat in its turn.

        Args:
            driver: a^H_t, or a function from the driver's observations to them.
            hmi: a^A_t, or a function from the vehicle AI's observations to them.
            sequential: whether the vehicle AI is asked after the driver and so sees a^H_t. If
                not, it is asked first and sees a^H_{t-1}.
            views, then, looking_away: see :meth:`step`.

        Raises:
            ValueError, TypeError: as :meth:`intend` and :meth:`step`. What a function raises, an
                action that is none, or a world that fails before its cars have moved, leaves the
                drivers as if they had not acted.
        """
        more = views, then, looking_away
        if sequential and callable(hmi):
            self.intend(self.ask(DRIVER, driver))
            try:
                return self._step(None, self.ask(VEHICLE_AI, hmi), *more)
            except Exception:
                self.withdraw()  # does nothing if the step has been taken
                raise
        alerts = self.ask(VEHICLE_AI, hmi)
        intents = check_actions(DRIVER, self.ask(DRIVER, driver), self.num_teams)
        had_acted = self._teams.intent_given.any()
        try:
            return self._step(intents, alerts, *more)
        except Exception:
            if not had_acted:
                self.withdraw()
            raise

    def ask(self, agent: str, actor: Actor) -> ArrayLike:
        """Return an actor's actions; one with an attribute ``reads`` is shown these parts only."""
        if not callable(actor):
            return actor
        return actor(self.observe(agent, getattr(actor, "reads", None)))

    def intend(self, driver_actions: ArrayLike, which: NDArray[np.bool_] | None = None) -> None:
        """Set the drivers' a^H_t, shape (N,), integers 0 to 4.

        Args:
            driver_actions: a^H_t; those of ended and of unmarked teams are not read.
            which: the teams in which the driver acts now, shape (N,), bool; all by default.

        Raises:
            ValueError: an action out of range, or a second intent in the same step.
        """
        acts = None if which is None else check_mask(which, self.num_teams)
        intents = check_actions(DRIVER, driver_actions, self.num_teams)
        self._execution.enter(self._teams, intents, None, acts)

    def withdraw(self) -> None:
        """Take back every a^H_t of the present turns; ``previous_intended`` stays."""
        state, given = self._teams.state, self._teams.intent_given
        state[given, INTENDED] = state[given, PREVIOUS]
        given[:] = False

    def step(
        self,
        alerts: ArrayLike,
        views: Views = (),
        then: Then | None = None,
        looking_away: ArrayLike | None = None,
    ) -> StepResult:
        """Take the step with the HMIs' a^A_t: attention, then the world, then rewards.

        Ended teams stay as they are and get zeros.

        Args:
            alerts: a^A_t, shape (N,), integers: 0 or 1 with the paper's alerts, 0 to k with k
                strengths.
            views: observations after the step to compute along with it, see :meth:`views`; or room
                for them and for rewards and ends, to be filled in.
            then: what teams do whose episode ends; by default nothing.
            looking_away: d_t where it is seen from outside, shape (N,): 1 while the driver looks
                away, 0 while at the road, -1 where the chain draws it, as it does by default. c_t,
                i_t and v_t follow as always. Those of ended teams are not read.

        Raises:
            ValueError: an action out of range, no :meth:`intend` before, ``then`` with
                ``looking_away``, a series of another number of teams, or room made by other teams.
        """
        return self._step(None, alerts, views, then, looking_away)

    def _step(
        self,
        intents: NDArray[np.int64] | None,
        alerts: ArrayLike,
        views: Views,
        then: Then | None,
        looking_away: ArrayLike | None,
    ) -> StepResult:
        """Take the step with a^A_t, and with a^H_t unless the drivers have acted already."""
        groups = self._groups(views, self.num_teams)
        scores = views.scores if isinstance(views, Room) else NO_SCORES
        moved, along = self._teams, groups
        if looking_away is not None:
            if then is not None:
                raise ValueError("with looking_away= episodes begin by reset(); leave out then=")
            given = check_actions("looking_away", looking_away, self.num_teams)
            moved = moved._replace(traits=seen_from_outside(moved.traits, given, moved.over))
            along = {}  # written afterwards, with the drivers' own traits
        finals = [self._final(name) for name in then.views] if then else []
        if then is not None:
            check_series(then.series, self.num_teams)
            then.series.look_ahead()  # before anything moves, since a population may fail
        rewards, ends, totals = self._execution.step(
            moved,
            intents,
            check_actions(VEHICLE_AI, alerts, self.num_teams),
            self._spare,
            tuple(along.values()),
            tuple(finals),
            then.series if then else None,
            scores,
        )
        before = self._teams.state
        self._teams, self._spare = Teams(self._spare, *self._teams[1:]), before
        ended = None
        if then is not None and len(teams := ends[:, ENDED].nonzero()[0]):
            assert totals is not None
            then.series.moved = True
            last = [group.rows.take(teams, axis=0) for group in finals]
            seen = dict(zip(then.views, last, strict=True))
            ended = EndedTeams(teams, seen, totals.take(teams, axis=0))
        if groups and not along:
            self._execution.write(self._teams, self._every, tuple(groups.values()))
        shown = {name: group.rows for name, group in groups.items()}
        return StepResult(rewards, ends, shown, ended)

    def observe(self, agent: str, parts: Iterable[str] | None = None) -> NDArray[np.float32]:
        """Return the agent's observations, shape (N, layout's size); see :mod:`observations`.

        Args:
            agent: whose observations.
            parts: names of the parts to compute, all by default. The others are 0; of none the
                result is read-only.

        Raises:
            KeyError: the layout has no such part.
        """
        if parts is None:
            return self.views((agent,))[agent]
        parts, shape = tuple(parts), (self.num_teams, self.layouts[agent].size)
        if not parts:
            return self._unseen[agent]
        rows = np.zeros(shape, np.float32)
        group = self._columns_of(agent, parts).another(rows)
        self._execution.write(self._teams, self._every, (group,))
        return rows

    def state(self) -> NDArray[np.float32]:
        """Return the whole team's state, shape (N, state_layout.size), for centralised critics."""
        return self.views((STATE,))[STATE]

    def views(
        self, names: Views, teams: NDArray[np.int64] | None = None
    ) -> dict[str, NDArray[np.float32]]:
        """Return several observations by name, computed together; no lidar is traced in vain.

        Args:
            names: agents, "state" for the whole team's state, or "traits" for the drivers' traits
                as they are; up to four. Or room for those of every team, to be filled in.
            teams: numbers of M teams, shape (M,); every team by default.

        Returns:
            Arrays of shape (M, size of the layout).
        """
        which = self._every if teams is None else check_team_numbers(teams, self.num_teams)
        groups = self._groups(names, len(which))
        if groups and len(which):
            self._execution.write(self._teams, which, tuple(groups.values()))
        return {name: group.rows for name, group in groups.items()}

    def room(self, names: Sequence[str], columns: tuple[int, ...] = ()) -> Room:
        """Return arrays for a step to fill in: observations, and what trainers read of the results.

        Args:
            names: of observations; see :meth:`views`.
            columns: of :attr:`StepResult.table`, for the rewards to hand out.

        Raises:
            ValueError: the table has no such column.
            KeyError: there is no such observation.
        """
        count = self.num_teams
        if columns not in self._scored:
            self._scored[columns] = check_columns(columns)
        groups = {name: self._columns_of(name).empty(count) for name in names}
        return Room.new(self, groups, self._scored[columns], count)

    def _groups(self, views: Views, count: int) -> dict[str, Group]:
        """Room for observations of so many teams, by name."""
        if isinstance(views, Room):
            if views.owner is not self or count != self.num_teams:
                raise ValueError("room for observations is filled by the teams that made it")
            return views.groups
        return {name: self._columns_of(name).empty(count) for name in views}

    def _final(self, name: str) -> Group:
        """Room for one observation at the end of episodes, always the same."""
        if name not in self._finals:
            self._finals[name] = self._columns_of(name).empty(self.num_teams)
        return self._finals[name]

    def _columns_of(self, name: str, parts: tuple[str, ...] | None = None) -> Group:
        """An observation's columns, without rows."""
        if (name, parts) not in self._columns:
            layout = self._layouts[name]
            no_rows = np.empty((0, layout.size), np.float32)
            self._columns[name, parts] = Group.of(no_rows, first_columns(layout, name, parts))
        return self._columns[name, parts]

    def whole_actions(self, actions: NDArray[Any], sizes: tuple[int, ...]) -> NDArray[np.int64]:
        """Return actions of shape (N, C) as int64 of shape (C, N); see :meth:`Execution.whole`."""
        return self._execution.whole(actions, sizes)


def _nothing(count: int, layout: obs.Layout) -> NDArray[np.float32]:
    """Zeros of shape (count, size of the layout), read-only."""
    return np.broadcast_to(np.zeros((), np.float32), (count, layout.size))
