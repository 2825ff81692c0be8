"""Compiled loops that check actions and set them, in the order of a turn."""

from __future__ import annotations

import numpy as np

from hmi_marl.envs import team_step
from hmi_marl.envs.worlds.batched.compiler import kernel


@kernel
def check_actions(progress, actions, sizes, columns, found):
    """Copy actions of shape (N, C) to int64 of shape (C, N), in which they are whole numbers.

    ``found`` becomes the team and column of the first that is not, or not below its column's size,
    else -1.
    """
    found[0] = -1
    for column in range(len(sizes)):
        for team in range(len(actions)):
            value = actions[team, column]
            if not 0 <= value < sizes[column] or value != np.int64(value):
                found[0], found[1] = team, column
                return
            columns[column, team] = np.int64(value)


@kernel
def intend_teams(progress, teams, actions, choices, acts, found):
    """Set the drivers' actions; see :meth:`Execution.intend`."""
    state, over, given = teams.state, teams.over, teams.intent_given
    found[0], found[1] = -1, -1
    for k in range(len(over)):
        on = acts[k] and not over[k]
        if on and given[k] and found[0] < 0:
            found[0] = k
        if on and not 0 <= actions[k] < choices and found[1] < 0:
            found[1] = k
    if found[0] >= 0 or found[1] >= 0:
        return
    for k in range(len(over)):
        if acts[k] and not over[k]:
            state[k, team_step.PREVIOUS] = state[k, team_step.INTENDED]
            state[k, team_step.INTENDED] = actions[k]
            given[k] = True


@kernel
def admit_alerts(progress, teams, alerts, choices, active, alert, found):
    """Find out which teams take a step, and by which alerts; see :meth:`Execution.admit`."""
    found[0], found[1] = -1, -1
    for k in range(len(teams.over)):
        on = not teams.over[k]
        if on and not teams.intent_given[k] and found[0] < 0:
            found[0] = k
        if on and not 0 <= alerts[k] < choices and found[1] < 0:
            found[1] = k
        active[k] = on
        alert[k] = alerts[k] if on else 0
