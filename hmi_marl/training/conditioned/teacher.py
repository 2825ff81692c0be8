r"""Exact rules of known drivers, which an HMI learns from.

In training the traits of every simulated driver are known, and with them the rule that is optimal
on the exact belief p(d = 1) for this driver (:mod:`hmi_marl.exact.hidden_attention`). It gives the
advantage A of alerting now over silence, if the rule is followed afterwards. The regret of an HMI's
trip is, with the rule's own model of the steps that reveal attention,

.. math:: \sum_t |A_t| \, 1(\text{the HMI does not do what the rule does})

No HMI reads any of this while it drives.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hmi_marl.agents.memory import step_of
from hmi_marl.envs.attention import next_acceptance
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import Driver, Traits
from hmi_marl.envs.observations import vehicle_ai_layout
from hmi_marl.envs.team_step import NO_ACTION
from hmi_marl.exact.bayes_filter import predict, weigh
from hmi_marl.exact.evidence import chains
from hmi_marl.exact.hidden_attention import GRID, solve_belief
from hmi_marl.exact.signalling import reveals

_EVERY = 5
"""Points of the grid of beliefs between two that are kept; all would take gigabytes."""


class Teacher:
    """Advantage of alerting for each of N teams, by the exact rule of its own driver.

    Args:
        drivers: the N drivers.
        config: settings of the teams.
        revealing: assumed share of steps in which a^H differs from the last applied action.
    """

    def __init__(self, drivers: Sequence[Driver], config: TeamConfig, revealing: float) -> None:
        different, self._which = chains(drivers)
        game = config.alert_window, config.horizon, config.weights, revealing
        # A copy of each before the next one is solved, for a view would keep all of its beliefs.
        tables = (solve_belief(d, *game).advantage[:, :, ::_EVERY] for d in different)
        self._table = np.stack([table.astype(np.float16) for table in tables])
        """[driver, t, m, b, i, c]; see :class:`BeliefSolution`."""
        self._traits = Traits.of(drivers)
        self._layout = vehicle_ai_layout(config)
        self._window, self._horizon = config.alert_window, config.horizon
        self.reset()

    def reset(self) -> None:
        """Begin a trip of every driver."""
        count = len(self._which)
        self._distracted = np.zeros(count)
        self._accepted, self._counter = np.zeros((2, count), np.int64)
        self._applied = np.full(count, NO_ACTION)

    def advantage(self, observations: NDArray[np.float32]) -> NDArray[np.float64]:
        """Return the advantage in the vehicle AI's turn, shape (N,); once for each turn."""
        self._follow(observations)
        layout = self._layout
        step = step_of(layout.scalar(observations, "time"), self._horizon)
        intended = layout.chosen(observations, "intended_action")
        shows = reveals(intended, self._applied).astype(np.int64)
        place = self._distracted * ((GRID - 1) // _EVERY)
        low = np.minimum(place.astype(np.int64), (GRID - 1) // _EVERY - 1)
        before, after = (self._which, step, shows), (self._accepted, self._counter)
        below, above = (
            self._table[*before, at, *after].astype(np.float64) for at in (low, low + 1)
        )
        return below + (place - low) * (above - below)

    def _follow(self, observations: NDArray[np.float32]) -> None:
        """Update p(d), i and c by what became of the step before."""
        layout = self._layout
        applied = layout.chosen(observations, "applied_action")
        intended = layout.chosen(observations, "previous_intended_action")
        alerts = (layout.scalar(observations, "alerted") > 0).astype(np.int64)
        taken = applied != NO_ACTION
        accepted, counter = next_acceptance(self._accepted, self._counter, alerts, self._window)
        predicted = predict(self._distracted, 1.0 - self._distracted, accepted, self._traits)
        is_first = self._applied == NO_ACTION
        kept = (applied == self._applied).astype(np.float64)
        chosen = (applied == intended).astype(np.float64)
        distracted, attentive = weigh(*predicted, is_first, kept, chosen)
        total = distracted + attentive
        belief = np.where(total > 0, distracted / np.where(total > 0, total, 1.0), kept)
        self._distracted = np.where(taken, belief, self._distracted)
        self._accepted = np.where(taken, accepted, self._accepted)
        self._counter = np.where(taken, counter, self._counter)
        self._applied = np.where(taken, applied, self._applied)
