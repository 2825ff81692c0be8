"""Quality of an HMI's alerts, step by step, measured by the exact optimum.

Returns of a few hundred episodes differ by luck far more than good HMIs differ from each other. The
loss of each alert (:func:`hmi_marl.exact.oracle.alert_losses`) does not: that of an optimal HMI is
0 in every single step.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hmi_marl.agents.hmis import strongest_alert
from hmi_marl.envs.attention import Attention
from hmi_marl.envs.config import TeamConfig
from hmi_marl.exact import oracle


@dataclass(frozen=True)
class AlertQuality:
    """Sums over the steps of E episodes. Arrays have shape (E,)."""

    followed: NDArray[np.int64]
    """Steps with the strongest alert if the driver was distracted one step before, else none."""
    lost: NDArray[np.float64]
    """Attention return lost against the optimum."""

    @classmethod
    def nothing_yet(cls, count: int) -> AlertQuality:
        """Zeros for ``count`` episodes that begin."""
        return cls(np.zeros(count, np.int64), np.zeros(count))

    def add(self, step: AlertQuality, active: NDArray[np.bool_]) -> AlertQuality:
        """Add one step of the episodes marked in ``active``, shape (E,)."""
        return AlertQuality(
            self.followed + active * step.followed, self.lost + np.where(active, step.lost, 0.0)
        )

    @classmethod
    def join(cls, several: Sequence[AlertQuality]) -> AlertQuality:
        """Put episodes together, in order."""
        return cls(
            np.concatenate([quality.followed for quality in several]),
            np.concatenate([quality.lost for quality in several]),
        )


class AlertJudge:
    """Judge of the alerts that are given to one driver.

    Args:
        team: settings with a single driver.

    Raises:
        ValueError: the driver is drawn from a population.
    """

    def __init__(self, team: TeamConfig) -> None:
        self._losses = oracle.alert_losses(**exact_settings(team))
        self._strongest, self._wearies = team.alerts.strongest, team.fatigue is not None

    def judge(self, step: int, before: Attention, alerts: NDArray[np.int64]) -> AlertQuality:
        """Judge one step of E teams, ``step`` steps after their start.

        Args:
            step: 0 for the first.
            before: attention before the step.
            alerts: a^A in the step, shape (E,).
        """
        state = [before.distracted, before.accepted, before.counter]
        if self._wearies:
            state.append(before.fatigue)
        followed = alerts == self._strongest * before.distracted
        return AlertQuality(followed.astype(np.int64), self._losses[step, alerts, *state])


def exact_settings(team: TeamConfig) -> dict[str, Any]:
    """Keywords by which the oracle's functions solve this team's problem.

    Raises:
        ValueError: the driver is drawn from a population.
    """
    if team.only_driver is None:
        raise ValueError("exact values are of one driver; name one, not a population")
    return {
        "driver": team.only_driver,
        "window": team.alert_window,
        "horizon": team.horizon,
        "weights": team.weights,
        "strengths": team.alert_strengths,
        "fatigue": team.fatigue,
    }


@dataclass(frozen=True)
class ExactRules:
    """Exact attention returns over an episode that runs its whole time, for one driver."""

    optimum: float
    """Return of the best alerts, attention seen."""
    when_distracted: float
    """Return of the strongest alert exactly when the driver was distracted one step before."""
    never: float
    """Return without alerts."""

    @classmethod
    def of(cls, team: TeamConfig) -> ExactRules:
        """Compute them for the team's driver."""
        settings = exact_settings(team)
        rule = strongest_alert(team.alerts, 0.0, 1.0)
        return cls(
            oracle.solve_alerts(**settings).total_return,
            oracle.evaluate(rule, **settings).total_return,
            oracle.evaluate(0.0, **settings).total_return,
        )

    def share_of_gain(self, lost_per_episode: float) -> float | None:
        """Share of what the best alerts gain over none: 1 for the optimum, 0 for no alerts.

        Args:
            lost_per_episode: attention return lost in an episode of the whole time.

        Returns:
            None where alerts can gain nothing.
        """
        gain = self.optimum - self.never
        return None if gain < _NOTHING else 1.0 - lost_per_episode / gain


_NOTHING = 1e-6
"""Difference in attention return below which two exact values are equal but for rounding."""
