"""Arrays of N teams and constants of their settings, as the rules of a step see them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hmi_marl.envs import team_step
from hmi_marl.envs.alerts import Effects
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import TRAIT_NAMES
from hmi_marl.envs.observation_values import PERCEIVED_LIDAR, TRUE_LIDAR, Scales, scales_of
from hmi_marl.envs.team_step import Scores, Settings, settings_of


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
        own = effects._replace(  # compiled loops take arrays that can be written to
            strengths=effects.strengths.copy(), changes=effects.changes.copy()
        )
        return cls(config.alert_window, own, settings_of(config), scales_of(config))


class Teams(NamedTuple):
    """N teams as the rules see them, in arrays that are written into; see :mod:`team_step`."""

    state: NDArray[np.int64]
    traits: NDArray[np.float64]
    seeds: NDArray[np.uint64]
    over: NDArray[np.bool_]
    """Teams without a running episode: ended, or not begun. Shape (N,)."""
    intent_given: NDArray[np.bool_]
    """Teams in mid-turn: the driver has acted, the vehicle AI has not. Shape (N,)."""
    totals: NDArray[np.float64]

    @classmethod
    def new(cls, count: int) -> Teams:
        """N teams without episodes."""
        return cls(
            np.repeat(team_step.AT_START[None], count, axis=0),
            np.zeros((count, len(TRAIT_NAMES))),
            np.zeros(count, np.uint64),
            np.ones(count, np.bool_),
            np.zeros(count, np.bool_),
            np.zeros((count, team_step.TOTALS)),
        )


NO_SCORES = Scores(
    np.zeros(0, np.int64),
    np.zeros((0, 0), np.float32),
    np.zeros(0, np.int64),
    np.zeros(0, np.bool_),
)
"""Scores that are not wanted."""


class Group(NamedTuple):
    """Observations to be written."""

    rows: NDArray[np.float32]
    """Shape (M, D)."""
    first: NDArray[np.int64]
    """First column of each part; see :func:`first_columns`."""
    shows_true_lidar: bool
    shows_perceived_lidar: bool

    @classmethod
    def of(cls, rows: NDArray[np.float32], first: NDArray[np.int64]) -> Group:
        """Rows to be written with these columns."""
        return cls(rows, first, bool(first[TRUE_LIDAR] >= 0), bool(first[PERCEIVED_LIDAR] >= 0))

    def another(self, rows: NDArray[np.float32]) -> Group:
        """Other rows with the same columns."""
        return Group(rows, *self[1:])

    def empty(self, count: int) -> Group:
        """Other rows with the same columns, for so many teams, to be filled in."""
        return self.another(np.empty((count, self.rows.shape[1]), np.float32))


class Room(NamedTuple):
    """Arrays that a step fills in; made by :meth:`Teaming.room` for its own teams.

    Compiled loops look at nothing but their addresses.
    """

    owner: object
    """The teams that it was made for."""
    groups: dict[str, Group]
    """Observations by name."""
    scores: Scores
    """Rewards and ends."""

    @classmethod
    def new(
        cls, owner: object, groups: dict[str, Group], columns: NDArray[np.int64], count: int
    ) -> Room:
        """Room for the groups, and for rewards from these columns and ends of so many teams."""
        rewards = np.empty((len(columns), count), np.float32)
        dones, time_outs = np.empty(count, np.int64), np.empty(count, np.bool_)
        return cls(owner, groups, Scores(columns, rewards, dones, time_outs))

    def without_views(self) -> Room:
        """Room for the same rewards and ends alone."""
        return self._replace(groups={})


def lidars_shown(groups: tuple[Group, ...]) -> tuple[bool, bool]:
    """Whether any of the groups shows the true lidar, and the perceived one."""
    true = perceived = False
    for _, _, shows_true, shows_perceived in groups:
        true, perceived = true or shows_true, perceived or shows_perceived
    return true, perceived


class After(NamedTuple):
    """What a step gave N teams. The arrays are new in every step."""

    rewards: NDArray[np.float64]
    ends: NDArray[np.bool_]
    last_totals: NDArray[np.float64] | None
    """Totals of the episodes that ended, if the next ones began: shape (N, 14), of which only the
    rows of these teams are filled in."""

    @classmethod
    def new(cls, count: int, last_totals: NDArray[np.float64] | None = None) -> After:
        """Arrays to be filled in, whose columns are each in one piece."""
        rewards = np.empty((team_step.SUMS, count)).T
        return cls(rewards, np.empty((team_step.OVER + 1, count), np.bool_).T, last_totals)
