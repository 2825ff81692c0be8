"""What latent-trait models know of a step before the car acts: the situation x_t.

A car's action v_t depends on more than what is seen of the road. A distracted driver repeats
v_{t-1}, and an alert acts on the step in which it sounds and on those after it. So a situation is
the observed state s_t, and beside it v_{t-1} and how long ago the last alert was, both one-hot. All
of it can be observed of a person; nothing of it is d, i, c, a^H, a trait or the inflated lidar.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hmi_marl.envs.worlds import VEHICLE_ACTIONS

ACTIONS = len(VEHICLE_ACTIONS)
LONG_AGO = 10
"""Steps after which an alert counts as long ago: 2 s at 5 Hz."""
EXTRA = ACTIONS + LONG_AGO + 1
"""Columns of a situation beside the observed state: v_{t-1}, and the steps since the last alert."""


@dataclass
class Recent:
    """What situations remember of N drives: v_{t-1} and the time since the last alert."""

    count: int
    """N."""
    applied: NDArray[np.int64] = field(init=False)
    """v_{t-1}, shape (N,); -1 before the first step."""
    since_alert: NDArray[np.int64] = field(init=False)
    """Steps since the last alert, shape (N,): 0 if it sounds now, ``LONG_AGO`` if none did."""

    def __post_init__(self) -> None:
        self.applied = np.full(self.count, -1)
        self.since_alert = np.full(self.count, LONG_AGO)

    def forget(self, which: NDArray[np.bool_]) -> None:
        """New drives begin where ``which``, shape (N,), is set."""
        self.applied = np.where(which, -1, self.applied)
        self.since_alert = np.where(which, LONG_AGO, self.since_alert)

    def situation(
        self, states: NDArray[np.float32], alerts: NDArray[np.int64]
    ) -> NDArray[np.float32]:
        """x_t of shape (N, D + EXTRA) from s_t of shape (N, D) and a^A_t of shape (N,).

        The alert is remembered; :meth:`acted` tells what the car then did.
        """
        self.since_alert = np.where(alerts == 1, 0, np.minimum(self.since_alert + 1, LONG_AGO))
        width = states.shape[1]
        x = np.empty((len(states), width + EXTRA), np.float32)
        x[:, :width] = states
        x[:, width : width + ACTIONS] = self.applied[:, None] == np.arange(ACTIONS)
        x[:, width + ACTIONS :] = self.since_alert[:, None] == np.arange(LONG_AGO + 1)
        return x

    def acted(self, applied: NDArray[np.int64]) -> None:
        """The car did v_t, shape (N,)."""
        self.applied = applied


def situations(
    states: NDArray[np.float32], actions: NDArray[np.int64], alerts: NDArray[np.int64]
) -> NDArray[np.float32]:
    """x_0 to x_{T-1} of E drives, shape (E, T, D + EXTRA).

    Args:
        states: s_t before step t, shape (E, T, D).
        actions: v_t, shape (E, T); -1 after a drive's end.
        alerts: a^A_t, 0 or 1, shape (E, T).
    """
    recent = Recent(len(states))
    x = np.empty((*states.shape[:2], states.shape[2] + EXTRA), np.float32)
    for t in range(states.shape[1]):
        x[:, t] = recent.situation(states[:, t], alerts[:, t])
        recent.acted(actions[:, t])
    return x
