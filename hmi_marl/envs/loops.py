"""Compiled loops over teams: the rules of a step, one team after the other, on several threads.

The rules are those that NumPy applies to all teams at once (:mod:`hmi_marl.envs.elementwise`).
Importing this module imports numba.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hmi_marl.envs import (
    compiled_rules,  # noqa: F401  (so that the rules can be compiled)
    team_step,
)
from hmi_marl.envs import observation_values as values
from hmi_marl.envs.action_loops import check_actions, enter_actions
from hmi_marl.envs.execution import Execution, WrongActionError
from hmi_marl.envs.series import Series
from hmi_marl.envs.team_arrays import NO_SCORES, After, Group, Rules, Teams, lidars_shown
from hmi_marl.envs.team_step import AT_START, TOTALS, Scores
from hmi_marl.envs.worlds import World
from hmi_marl.envs.worlds.base import CRASHED, SPEED, Readings
from hmi_marl.envs.worlds.batched import BatchedWorld
from hmi_marl.envs.worlds.batched.compiler import inlined, kernel, prepare_once, ready
from hmi_marl.envs.worlds.batched.kernels import (
    Merges,
    begin_world,
    halt_world,
    look,
    move_world,
)
from hmi_marl.envs.worlds.batched.prefetch import ask_for_rows
from hmi_marl.envs.worlds.batched.threads import new_progress, share, take


@kernel
def decide_teams(progress, teams, active, alert, rules, after):
    """Apply :func:`team_step.decide` to every team."""
    state, traits, seeds = teams.state, teams.traits, teams.seeds
    window, effects, _, _ = rules
    first, last = take(progress, 0, len(active))
    while first < last:
        for k in range(first, last):
            team_step.decide(k, active, alert, state, seeds, traits, window, effects, after)
        first, last = take(progress, last - first, len(active))


@kernel
def reward_teams(progress, teams, active, alert, rules, after, readings, rewards, ends):
    """Apply :func:`team_step.reward` to every team."""
    state, totals = teams.state, teams.totals
    _, _, settings, _ = rules
    numbers, flags = readings
    first, last = take(progress, 0, len(active))
    while first < last:
        for k in range(first, last):
            team_step.reward(
                k, active, alert, state, after, numbers, flags, settings, rewards, ends, totals
            )
        first, last = take(progress, last - first, len(active))


@inlined
def write_groups(groups, row, k, shown, scales):
    """Write the observations of team k into a row of each group; those not wanted have no rows."""
    for rows, first_of in groups:
        if len(rows):
            values.write(rows, row, first_of, k, shown, scales)


@kernel
def write_teams(progress, which, shown, rules, groups):
    """Write the observations of the teams in ``which`` into the rows of each group."""
    _, _, _, scales = rules
    first, last = take(progress, 0, len(which))
    while first < last:
        for row in range(first, last):
            write_groups(groups, row, which[row], shown, scales)
        first, last = take(progress, last - first, len(which))


@kernel
def look_and_write_teams(progress, merges, true, perceived, which, shown, rules, groups):
    """Trace the lidars that are read and have changed, then do as :func:`write_teams`."""
    _, _, _, scales = rules
    first, last = take(progress, 0, len(which))
    while first < last:
        for row in range(first, last):
            look(which[row], merges, true, perceived)
            write_groups(groups, row, which[row], shown, scales)
        first, last = take(progress, last - first, len(which))


class NextEpisodes(NamedTuple):
    """Where a step finds the next episodes of teams that end, and leaves their totals."""

    wanted: bool
    """Whether teams that end begin their next episode."""
    episodes: NDArray[np.int64]
    seeds_ahead: NDArray[np.uint64]
    traits_ahead: NDArray[np.float64]
    """See :class:`Series`."""
    start: NDArray[np.int64]
    no_totals: NDArray[np.float64]
    """See :func:`team_step.begin`."""
    last_totals: NDArray[np.float64]
    """Totals of the episodes that end, shape (N, 14); only their rows are written."""


@kernel
def step_teams(
    progress, merges, room, teams, active, alert, rules, after, rewards, ends, scores,
    following, finals, groups,
):  # fmt: skip
    """Take a whole step of every team: decide, move, reward, begin what follows, look and write.

    One loop over parts for all of it, since starting one on several threads costs as much as some
    of its parts. Within a part the teams take each of these in turn, since all of the machine code
    at once does not fit into the processor's instruction cache. ``rewards`` and ``ends`` have a row
    for each column of :class:`After`, so that they are of one type for one team and for many.
    """
    rewards, ends = rewards.T, ends.T
    state, traits, seeds, over, intent_given, totals = teams
    window, effects, settings, scales = rules
    numbers, flags = merges.numbers, merges.flags
    shown = values.Shown(
        merges.true_lidar, merges.perceived_lidar, numbers, flags, after, intent_given, traits
    )  # fmt: skip
    final_true, final_perceived, final_groups = finals
    true, perceived, all_groups = groups
    ahead = following.seeds_ahead.shape[1]
    first, last = take(progress, 0, len(active))
    while first < last:
        for k in range(first, last):
            team_step.decide(k, active, alert, state, seeds, traits, window, effects, after)
        ask_for_rows(totals, first, last)
        for rows, _ in all_groups:
            if len(rows):
                ask_for_rows(rows, first, last)
        for k in range(first, last):
            if active[k]:
                if flags[k, CRASHED] == 0:
                    move_world(k, merges, after[k, team_step.APPLIED])
                elif numbers[k, SPEED] != 0.0:
                    halt_world(k, merges)
        for k in range(first, last):
            team_step.reward(
                k, active, alert, state, after, numbers, flags, settings, rewards, ends, totals
            )
            if len(scores.dones):
                team_step.score(k, rewards, ends, scores)
            over[k] = ends[k, team_step.OVER]
            intent_given[k] = False
        for k in range(first, last):
            if following.wanted and ends[k, team_step.ENDED]:
                look(k, merges, final_true, final_perceived)
                write_groups(final_groups, k, k, shown, scales)
                for column in range(team_step.TOTALS):
                    following.last_totals[k, column] = totals[k, column]
                following.episodes[k] += 1
                place = following.episodes[k] % ahead
                seed, driver = following.seeds_ahead[k, place], following.traits_ahead[k, place]
                team_step.begin(
                    k, seed, driver, following.start, after, traits, seeds, over, intent_given,
                    totals, following.no_totals,
                )  # fmt: skip
                begin_world(k, merges, room, seed, driver[team_step.INFLATION])
        for k in range(first, last):
            look(k, merges, true, perceived)
        for rows, first_of in all_groups:
            if len(rows):
                for k in range(first, last):
                    values.write(rows, k, first_of, k, shown, scales)
        first, last = take(progress, last - first, len(active))


_GROUPS = 4
"""Groups of observations that one loop writes."""
_NO_GROUP = np.empty((0, 0), np.float32), np.full(len(values.PARTS), -1)


class InLoops(Execution):
    """Apply the rules in compiled loops, in any world."""

    def __init__(self, world: World, rules: Rules) -> None:
        super().__init__(world, rules)
        count = world.num_worlds
        self._found, self._refused = np.zeros(2, np.int64), np.zeros(4, np.int64)
        self._active, self._alert = np.zeros(count, np.bool_), np.zeros(count, np.int64)

    def whole(self, actions: NDArray[Any], sizes: tuple[int, ...]) -> NDArray[np.int64]:
        """See :meth:`Execution.whole`."""
        if not actions.flags.carray:
            actions = np.require(actions, None, ("C", "A", "W"))
        columns = np.empty((len(sizes), len(actions)), np.int64)
        if not check_actions(_NO_PROGRESS, actions, sizes, columns, self._found):
            raise WrongActionError(actions, *self._found)
        return columns

    def enter(
        self,
        teams: Teams,
        intents: NDArray[np.int64] | None,
        alerts: NDArray[np.int64] | None,
        acts: NDArray[np.bool_] | None = None,
    ) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
        """See :meth:`Execution.enter`; the arrays are the same at each call."""
        given = (_NO_ACTIONS if each is None else each for each in (intents, alerts))
        admitted = self._active, self._alert
        acting = self._everywhere if acts is None else acts
        arguments = teams, *given, acting, self._choices, *admitted, self._refused
        if not ready(enter_actions, *arguments)(_NO_PROGRESS, *arguments):
            self.refuse(self._refused.tolist(), intents, alerts)
        return admitted

    def decide(
        self,
        teams: Teams,
        active: NDArray[np.bool_],
        alert: NDArray[np.int64],
        state: NDArray[np.int64],
    ) -> None:
        """See :meth:`Execution.decide`."""
        self._run(decide_teams, len(alert), teams, active, alert, self.rules, state)

    def reward(
        self,
        teams: Teams,
        active: NDArray[np.bool_],
        alert: NDArray[np.int64],
        state: NDArray[np.int64],
        after: After,
    ) -> None:
        """See :meth:`Execution.reward`."""
        results = state, self.readings, after.rewards, after.ends
        self._run(reward_teams, len(alert), teams, active, alert, self.rules, *results)

    def write(
        self,
        teams: Teams,
        which: NDArray[np.int64],
        groups: tuple[Group, ...],
    ) -> None:
        """See :meth:`Execution.write`."""
        shown = self._shown(teams, groups)
        arguments = which, shown, self.rules, _filled_up(groups)
        self._run(write_teams, len(which), *arguments)

    def _run(self, loop: Any, count: int, *arguments: Any) -> None:
        prepare_once(loop, *arguments)
        share(loop, count, 1, *arguments)


class InOneLoop(InLoops):
    """Take the whole step of teams in batched worlds in one loop, on several threads."""

    world: BatchedWorld

    def __init__(self, world: BatchedWorld, rules: Rules) -> None:
        super().__init__(world, rules)
        count, nothing = world.num_worlds, (np.zeros((0, 1), np.uint64), np.zeros((0, 1, 4)))
        self._last_totals = np.zeros((count, TOTALS))
        self._nothing_follows = NextEpisodes(
            False, np.zeros(0, np.int64), *nothing, AT_START, _NO_TOTALS, np.zeros((0, TOTALS))
        )

    @property
    def bytes_per_team(self) -> int:
        """See :meth:`Execution.bytes_per_team`."""
        arrays = self._last_totals, self._active, self._alert, self._every, self._everywhere
        return sum(array.nbytes for array in arrays) // len(self._active)

    @property
    def readings(self) -> Readings:
        """See :meth:`Execution.readings`."""
        merges = self.world.arrays()
        return Readings(merges.numbers, merges.flags)

    def _begin_world(
        self,
        teams: Teams,
        which: NDArray[np.int64],
        seeds: NDArray[np.uint64],
        inflation: NDArray[np.float64],
    ) -> None:
        self.world.begin(which, seeds, inflation)

    def write(
        self,
        teams: Teams,
        which: NDArray[np.int64],
        groups: tuple[Group, ...],
    ) -> None:
        """See :meth:`Execution.write`."""
        merges = self.world.arrays()
        arguments = (
            merges, *lidars_shown(groups), which, self._showing(merges, teams), self.rules,
            _filled_up(groups),
        )  # fmt: skip
        loop = ready(look_and_write_teams, *arguments)
        share(loop, len(which), self.world.sharing(len(which)), *arguments)

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
        """See :meth:`Execution.step`."""
        admitted = self.enter(teams, intents, alerts)
        merges = self.world.arrays()
        after = After.new(len(alerts), self._last_totals)
        following = self._nothing_follows
        if series is not None:
            ahead = series.episodes, series.seeds, series.traits
            following = NextEpisodes(True, *ahead, AT_START, _NO_TOTALS, self._last_totals)
        arguments = (
            merges, self.world.room, teams, *admitted, self.rules, state, after.rewards.T,
            after.ends.T, scores, following,
            (*lidars_shown(finals), _filled_up(finals)),
            (*lidars_shown(groups), _filled_up(groups)),
        )  # fmt: skip
        self.world.take_step(ready(step_teams, *arguments), *arguments)
        return after

    def _showing(self, merges: Merges, teams: Teams) -> values.Shown:
        state, given, traits = teams.state, teams.intent_given, teams.traits
        true, perceived = merges.true_lidar, merges.perceived_lidar
        return values.Shown(true, perceived, merges.numbers, merges.flags, state, given, traits)


def _filled_up(groups: tuple[Group, ...]) -> tuple[tuple[NDArray[Any], NDArray[np.int64]], ...]:
    """As many groups as the loops are compiled for."""
    if len(groups) > _GROUPS:
        raise ValueError(f"at most {_GROUPS} observations are computed together")
    return (*[group[:2] for group in groups], *[_NO_GROUP] * (_GROUPS - len(groups)))


_NO_TOTALS, _NO_ACTIONS = np.zeros(TOTALS), np.zeros(0, np.int64)
_NO_PROGRESS = new_progress()
"""For loops that one thread alone runs."""
