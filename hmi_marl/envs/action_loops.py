"""Compiled loops that check actions and set them."""

from __future__ import annotations

import numpy as np

from hmi_marl.envs import team_step
from hmi_marl.envs.worlds.batched.compiler import kernel


@kernel
def check_actions(progress, actions, sizes, columns, found):
    """Copy actions of shape (N, C) to int64 of shape (C, N), in which they are whole numbers.

    Returns whether they are, and below their columns' sizes. If not, ``found`` becomes the team and
    column of the first that is not.
    """
    for column in range(len(sizes)):
        for team in range(len(actions)):
            value = actions[team, column]
            if not 0 <= value < sizes[column] or value != np.int64(value):
                found[0], found[1] = team, column
                return False
            columns[column, team] = np.int64(value)
    return True


TWICE, NO_INTENT, TOO_EARLY, NO_ALERT = range(4)
"""Reasons to refuse actions: a driver has acted already; its action is none; an alert before the
driver has acted; an alert that is none."""


@kernel
def enter_actions(progress, teams, intents, alerts, acts, choices, active, alert, refused):
    """Check the actions of one seat or both, and set them; see :meth:`Execution.enter`.

    A seat that does not act has no actions, and ``choices`` are the numbers of both seats' actions.
    Returns whether they are set. If not, ``refused`` holds the first team of each reason to refuse,
    -1 where there is none.
    """
    state, over, given = teams.state, teams.over, teams.intent_given
    drives, alerted = len(intents) > 0, len(alerts) > 0
    for reason in range(len(refused)):
        refused[reason] = -1
    for k in range(len(over) - 1, -1, -1):
        if acts[k] and not over[k]:
            if drives and given[k]:
                refused[TWICE] = k
            if drives and not 0 <= intents[k] < choices[0]:
                refused[NO_INTENT] = k
            if alerted and not drives and not given[k]:
                refused[TOO_EARLY] = k
            if alerted and not 0 <= alerts[k] < choices[1]:
                refused[NO_ALERT] = k
    for reason in range(len(refused)):
        if refused[reason] >= 0:
            return False
    for k in range(len(over)):
        on = acts[k] and not over[k]
        if drives and on:
            state[k, team_step.PREVIOUS] = state[k, team_step.INTENDED]
            state[k, team_step.INTENDED] = intents[k]
            given[k] = True
        if alerted:
            active[k] = on
            alert[k] = alerts[k] if on else 0
    return True
