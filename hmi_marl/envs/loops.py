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
from hmi_marl.envs.execution import Group, new_rewards, with_lidars
from hmi_marl.envs.worlds import World
from hmi_marl.envs.worlds.base import Readings
from hmi_marl.envs.worlds.batched.compiler import kernel, prepare
from hmi_marl.envs.worlds.batched.lidar import trace
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
def decide_teams(progress, active, alert, state, seeds, traits, window, effects, after):
    """Apply :func:`team_step.decide` to every team."""
    first, last = take(progress, 0, len(active))
    while first < last:
        for k in range(first, last):
            team_step.decide(k, active, alert, state, seeds, traits, window, effects, after)
        first, last = take(progress, last - first, len(active))


@kernel
def reward_teams(progress, active, alert, state, after, readings, settings, rewards, ends):
    """Apply :func:`team_step.reward` to every team."""
    numbers, flags = readings
    first, last = take(progress, 0, len(active))
    while first < last:
        for k in range(first, last):
            team_step.reward(
                k, active, alert, state, after, numbers, flags, settings, rewards, ends
            )
        first, last = take(progress, last - first, len(active))


@kernel
def write_teams(progress, teams, shown, scales, groups):
    """Write the observations of some teams into the rows of each group.

    Args:
        teams: numbers of M teams, in the order of the rows.
        shown, scales: see :func:`observation_values.write`.
        groups: pairs of rows, shape (M, D), and their columns; M = 0 for a group that is not wanted.
    """
    count = len(teams)
    first, last = take(progress, 0, count)
    while first < last:
        for row in range(first, last):
            for rows, columns in groups:
                if len(rows):
                    values.write(rows, row, columns, teams[row], shown, scales)
        first, last = take(progress, last - first, count)


@kernel
def look_and_write_teams(progress, sight, true, perceived, teams, shown, scales, groups):
    """Trace the lidars that are read and have changed, then do as :func:`write_teams`.

    One loop for both, since starting one on several threads costs as much as the writing.
    """
    count = len(teams)
    first, last = take(progress, 0, count)
    while first < last:
        for row in range(first, last):
            k = teams[row]
            f, world = sight.floats[k], sight.worlds[k]
            directions, reach = sight.directions, sight.lidar_range
            if true and sight.true_stale[k]:
                trace(f, world, 1.0, directions, reach, sight.true_lidar[k])
                sight.true_stale[k] = False
            if perceived and sight.perceived_stale[k]:
                inflation = sight.inflation[k]
                trace(f, world, inflation, directions, reach, sight.perceived_lidar[k])
                sight.perceived_stale[k] = False
            for rows, columns in groups:
                if len(rows):
                    values.write(rows, row, columns, k, shown, scales)
        first, last = take(progress, last - first, count)


_GROUPS = 3
"""Groups of observations that one loop writes."""
_NO_ROWS = np.empty((0, 0), np.float32)


class Compiled:
    """Apply the rules in the compiled loops; see :class:`hmi_marl.envs.execution.Execution`."""

    def __init__(self) -> None:
        self._prepared: set[str] = set()

    def decide(
        self,
        active: NDArray[np.bool_],
        alert: NDArray[np.int64],
        state: NDArray[np.int64],
        seeds: NDArray[np.uint64],
        traits: NDArray[np.float64],
        window: int,
        effects: alerts.Effects,
    ) -> NDArray[np.int64]:
        """See :meth:`Execution.decide`."""
        after = np.empty_like(state)
        self._share(
            decide_teams, len(active), active, alert, state, seeds, traits, window, effects, after
        )
        return after

    def reward(
        self,
        active: NDArray[np.bool_],
        alert: NDArray[np.int64],
        state: NDArray[np.int64],
        after: NDArray[np.int64],
        readings: Readings,
        settings: team_step.Settings,
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """See :meth:`Execution.reward`."""
        rewards, ends = new_rewards(len(active))
        self._share(
            reward_teams,
            len(active),
            active,
            alert,
            state,
            after,
            readings,
            settings,
            rewards,
            ends,
        )
        return rewards, ends

    def write(
        self,
        world: World,
        teams: NDArray[np.int64],
        shown: values.Shown,
        scales: values.Scales,
        groups: tuple[Group, ...],
    ) -> None:
        """See :meth:`Execution.write`."""
        true, perceived = (
            any(getattr(columns, name) for _, columns in groups)
            for name in ("true_lidar", "perceived_lidar")
        )
        nothing = (_NO_ROWS, groups[0][1])
        groups = (*groups, *[nothing] * (_GROUPS - len(groups)))
        if not hasattr(world, "sight"):
            shown = with_lidars(world, shown, groups)
            self._share(write_teams, len(teams), teams, shown, scales, groups)
            return
        sight = world.sight()
        cells = len(shown.intent_given), -1
        shown = shown._replace(
            true_lidar=sight.true_lidar.reshape(cells),
            perceived_lidar=sight.perceived_lidar.reshape(cells),
        )
        arguments = sight, true, perceived, teams, shown, scales, groups
        threads = world.sharing(len(teams))
        self._share(look_and_write_teams, len(teams), *arguments, threads=threads)

    def _share(self, loop: Any, count: int, *arguments: Any, threads: int = 1) -> None:
        if loop.__name__ not in self._prepared:
            prepare([(loop, (np.zeros(2, np.int64), *arguments))])
            self._prepared.add(loop.__name__)
        share(loop, count, threads, *arguments)
