"""Compiled loops over teams: the rules of a step, one team after the other, on several threads.

The rules are those that NumPy applies to all teams at once (:mod:`hmi_marl.envs.elementwise`);
here numba learns what they consist of. Importing this module imports numba.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba.extending import overload, register_jitable
from numpy.typing import NDArray

from hmi_marl.envs import alerts, attention, elementwise, rewards, streams, team_step
from hmi_marl.envs import observation_values as values
from hmi_marl.envs.execution import After, Execution, Group, Teams, new_rewards
from hmi_marl.envs.worlds.base import CRASHED, SPEED, Readings
from hmi_marl.envs.worlds.batched import BatchedWorld
from hmi_marl.envs.worlds.batched.compiler import kernel, prepare
from hmi_marl.envs.worlds.batched.kernels import Merges, halt_world, look, move_world
from hmi_marl.envs.worlds.batched.threads import share, take

_OPTIONS: dict[str, Any] = {"error_model": "numpy", "forceinline": True, "_nrt": False}

for rule in (
    alerts.help_share,
    alerts.next_level,
    attention.next_attention,
    elementwise.within,
    rewards.add_up,
    rewards.attention_values,
    rewards.driving_values,
    streams.mix_bits,
    streams.unit_draw,
    team_step.decide,
    team_step.reward,
    values.write,
):
    register_jitable(**_OPTIONS)(rule)


def _compile_inside(rule: Any) -> None:
    """Let compiled code call a rule that takes lists too, without the part that takes lists."""
    overload(rule, jit_options=_OPTIONS, strict=False)(lambda *_: rule.__wrapped__)


_compile_inside(attention.next_acceptance)
_compile_inside(attention.distraction_probability)


@overload(elementwise.choose, jit_options=_OPTIONS, strict=False)
def _choose(condition: Any, yes: Any, no: Any) -> Any:
    return lambda condition, yes, no: yes if condition else no


@overload(elementwise.put, jit_options=_OPTIONS, strict=False)
def _put(rows: Any, row: Any, column: Any, low: Any, high: Any, value: Any) -> Any:
    def put(rows: Any, row: Any, column: Any, low: Any, high: Any, value: Any) -> None:
        if column >= 0:
            rows[row, column] = elementwise.within(np.float32(value), low[column], high[column])

    return put


@overload(elementwise.put_one_hot, jit_options=_OPTIONS, strict=False)
def _put_one_hot(rows: Any, row: Any, column: Any, index: Any, size: Any) -> Any:
    def put_one_hot(rows: Any, row: Any, column: Any, index: Any, size: Any) -> None:
        if column >= 0:
            for value in range(size):
                rows[row, column + value] = 1.0 if value == index else 0.0

    return put_one_hot


@overload(elementwise.put_scaled, jit_options=_OPTIONS, strict=False)
def _put_scaled(
    rows: Any, row: Any, column: Any, low: Any, high: Any, values: Any, scale: Any
) -> Any:
    def put_scaled(
        rows: Any, row: Any, column: Any, low: Any, high: Any, values: Any, scale: Any
    ) -> None:
        if column >= 0:
            for place in range(len(values)):
                where = column + place
                rows[row, where] = elementwise.within(
                    values[place] / scale, low[where], high[where]
                )

    return put_scaled


@kernel
def find_wrong(progress, actions, acts, choices, found):
    """Put the first team that acts by a number outside 0 to choices - 1 into ``found``."""
    for k in range(len(actions)):
        if acts[k] and not 0 <= actions[k] < choices:
            found[0] = k
            return


@kernel
def decide_teams(progress, teams, alert, rules, after):
    """Apply :func:`team_step.decide` to every team."""
    state, _, traits, seeds, active, _ = teams
    window, effects, _, _ = rules
    first, last = take(progress, 0, len(active))
    while first < last:
        for k in range(first, last):
            team_step.decide(k, active, alert, state, seeds, traits, window, effects, after)
        first, last = take(progress, last - first, len(active))


@kernel
def reward_teams(progress, teams, alert, rules, after, readings, rewards, ends):
    """Apply :func:`team_step.reward` to every team."""
    state, _, _, _, active, _ = teams
    _, _, settings, _ = rules
    numbers, flags = readings
    first, last = take(progress, 0, len(active))
    while first < last:
        for k in range(first, last):
            team_step.reward(
                k, active, alert, state, after, numbers, flags, settings, rewards, ends
            )
        first, last = take(progress, last - first, len(active))


@kernel
def write_teams(progress, which, shown, rules, groups):
    """Write the observations of the teams in ``which`` into the rows of each group.

    Groups that are not wanted have no rows.
    """
    _, _, _, scales = rules
    first, last = take(progress, 0, len(which))
    while first < last:
        for row in range(first, last):
            for rows, columns in groups:
                if len(rows):
                    values.write(rows, row, columns, which[row], shown, scales)
        first, last = take(progress, last - first, len(which))


@kernel
def look_and_write_teams(progress, merges, true, perceived, which, shown, rules, groups):
    """Trace the lidars that are read and have changed, then do as :func:`write_teams`."""
    _, _, _, scales = rules
    first, last = take(progress, 0, len(which))
    while first < last:
        for row in range(first, last):
            look(which[row], merges, true, perceived)
            for rows, columns in groups:
                if len(rows):
                    values.write(rows, row, columns, which[row], shown, scales)
        first, last = take(progress, last - first, len(which))


@kernel
def step_teams(
    progress, merges, teams, alert, rules, after, rewards, ends, true, perceived, shown, groups
):
    """Take a whole step of every team: decide, move, reward, look and write.

    One loop for all of it, since starting one on several threads costs as much as some of its
    parts, and what a team needs stays in the processor's cache.
    """
    state, _, traits, seeds, active, _ = teams
    window, effects, settings, scales = rules
    numbers, flags = merges.numbers, merges.flags
    first, last = take(progress, 0, len(active))
    while first < last:
        for k in range(first, last):
            team_step.decide(k, active, alert, state, seeds, traits, window, effects, after)
            if active[k]:
                if flags[CRASHED, k] == 0:
                    move_world(k, merges, after[team_step.APPLIED, k])
                elif numbers[SPEED, k] != 0.0:
                    halt_world(k, merges)
            team_step.reward(
                k, active, alert, state, after, numbers, flags, settings, rewards, ends
            )
            look(k, merges, true, perceived)
            for rows, columns in groups:
                if len(rows):
                    values.write(rows, k, columns, k, shown, scales)
        first, last = take(progress, last - first, len(active))


_GROUPS = 3
"""Groups of observations that one loop writes."""
_NO_COLUMNS = values.Columns(
    np.full(len(values.PARTS), -1), np.empty(0, np.float32), np.empty(0, np.float32)
)
_NO_GROUP = Group(np.empty((0, 0), np.float32), _NO_COLUMNS)


class InLoops(Execution):
    """Apply the rules in compiled loops, in any world."""

    def first_wrong(self, actions: NDArray[np.int64], acts: NDArray[np.bool_], choices: int) -> int:
        """See :meth:`Execution.first_wrong`."""
        found = np.full(1, -1)
        self._run(find_wrong, len(acts), actions, acts, choices, found)
        return int(found[0])

    def decide(self, teams: Teams, alert: NDArray[np.int64], after: NDArray[np.int64]) -> None:
        """See :meth:`Execution.decide`."""
        self._run(decide_teams, len(alert), teams, alert, self.rules, after)

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
        results = readings, rewards, ends
        self._run(reward_teams, len(alert), teams, alert, self.rules, after, *results)

    def write(self, teams: Teams, which: NDArray[np.int64], groups: tuple[Group, ...]) -> None:
        """See :meth:`Execution.write`."""
        shown = self._shown(teams, groups)
        self._run(write_teams, len(which), which, shown, self.rules, _filled_up(groups))

    def _run(self, loop: Any, count: int, *arguments: Any) -> None:
        _prepare(loop, *arguments)
        share(loop, count, 1, *arguments)


class InOneLoop(InLoops):
    """Take the whole step of teams in batched worlds in one loop, on several threads."""

    world: BatchedWorld

    def write(self, teams: Teams, which: NDArray[np.int64], groups: tuple[Group, ...]) -> None:
        """See :meth:`Execution.write`."""
        merges = self.world.arrays()
        shown = self._showing(merges, teams.state, teams, *teams.readings)
        arguments = merges, *_lidars(groups), which, shown, self.rules, _filled_up(groups)
        _prepare(look_and_write_teams, *arguments)
        threads = self.world.sharing(len(which))
        share(look_and_write_teams, len(which), threads, *arguments)

    def step(self, teams: Teams, alert: NDArray[np.int64], groups: tuple[Group, ...] = ()) -> After:
        """See :meth:`Execution.step`."""
        merges, after = self.world.arrays(), np.empty_like(teams.state)
        rewards, ends = new_rewards(len(alert))
        then = teams._replace(intent_given=np.zeros(len(alert), np.bool_))
        shown = self._showing(merges, after, then, merges.numbers, merges.flags)
        results = after, rewards, ends, *_lidars(groups), shown, _filled_up(groups)
        arguments = merges, teams, alert, self.rules, *results
        _prepare(step_teams, *arguments)
        self.world.take_step(step_teams, *arguments)
        return After(after, self.world.readings(), rewards, ends)

    def _showing(
        self,
        merges: Merges,
        state: NDArray[np.int64],
        teams: Teams,
        numbers: NDArray[np.float64],
        flags: NDArray[np.int64],
    ) -> values.Shown:
        shape = len(teams.active), -1
        lidars = merges.true_lidar.reshape(shape), merges.perceived_lidar.reshape(shape)
        return values.Shown(*lidars, numbers, flags, state, teams.intent_given, teams.traits)


def _lidars(groups: tuple[Group, ...]) -> tuple[bool, bool]:
    """Whether the groups show the true lidar, and the perceived one."""
    true, perceived = (
        any(group.columns.shows_lidar(inflated) for group in groups) for inflated in (False, True)
    )
    return true, perceived


def _filled_up(groups: tuple[Group, ...]) -> tuple[Group, ...]:
    """As many groups as the loops are compiled for."""
    return (*groups, *[_NO_GROUP] * (_GROUPS - len(groups)))


_prepared: set[str] = set()


def _prepare(loop: Any, *arguments: Any) -> None:
    """Compile a loop before its first call."""
    if loop.__name__ not in _prepared:
        prepare([(loop, (np.zeros(2, np.int64), *arguments))])
        _prepared.add(loop.__name__)
