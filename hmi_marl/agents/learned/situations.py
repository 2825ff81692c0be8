"""Situations: what a trait model reads of a step before the car acts.

A situation x_t holds the observed state s_t, v_{t-1} and the steps since the last alert, the latter
two one-hot, since v_t depends on more than the road: a distracted driver repeats v_{t-1}, and an
alert has effects in its own step and in later ones. All of it can be observed; it holds neither d,
i, c, a^H, traits nor the inflated lidar.
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
"""Columns of a situation after the observed state: v_{t-1} and the steps since the last alert."""


@dataclass
class Recent:
    """Memory of N drives for situations: v_{t-1} and the steps since the last alert."""

    count: int
    """N."""
    applied: NDArray[np.int64] = field(init=False)
    """v_{t-1}, shape (N,); -1 before the first step."""
    since_alert: NDArray[np.int64] = field(init=False)
    """Steps since the last alert, shape (N,): 0 if it is given now, ``LONG_AGO`` if none was."""

    def __post_init__(self) -> None:
        self.applied = np.full(self.count, -1)
        self.since_alert = np.full(self.count, LONG_AGO)

    def forget(self, which: NDArray[np.bool_]) -> None:
        """Begin new drives where ``which``, shape (N,), is set."""
        self.applied = np.where(which, -1, self.applied)
        self.since_alert = np.where(which, LONG_AGO, self.since_alert)

    def situation(
        self, states: NDArray[np.float32], alerts: NDArray[np.int64]
    ) -> NDArray[np.float32]:
        """Return x_t, shape (N, D + EXTRA), from s_t, shape (N, D), and a^A_t, shape (N,).

        The alert is remembered; pass the following v_t to :meth:`acted`.
        """
        self.since_alert = np.where(alerts == 1, 0, np.minimum(self.since_alert + 1, LONG_AGO))
        width = states.shape[1]
        x = np.empty((len(states), width + EXTRA), np.float32)
        x[:, :width] = states
        x[:, width : width + ACTIONS] = self.applied[:, None] == np.arange(ACTIONS)
        x[:, width + ACTIONS :] = self.since_alert[:, None] == np.arange(LONG_AGO + 1)
        return x

    def acted(self, applied: NDArray[np.int64]) -> None:
        """Remember the applied actions v_t, shape (N,)."""
        self.applied = applied


def situations(
    states: NDArray[np.float32], actions: NDArray[np.int64], alerts: NDArray[np.int64]
) -> NDArray[np.float32]:
    """Return x_0 to x_{T-1} of E drives, shape (E, T, D + EXTRA).

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
