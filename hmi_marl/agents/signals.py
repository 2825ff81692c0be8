"""Keep the exact belief about hidden attention while teams play, and what each step tells of it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hmi_marl.agents.rollout import Observer
from hmi_marl.envs.step_result import StepResult
from hmi_marl.envs.teaming import Teaming
from hmi_marl.exact.signalling import Signal, read_signal


class SignalWatch(Observer):
    """Watch what a^H and v tell of d, from the start of the episodes on.

    The belief is that of an observer who knows the traits, sees a^H, v and the alerts, and not d.
    Alerts of any strength and fatigue are taken; a driver stays for the whole episode.
    """

    signal: Signal | None = None
    """Beliefs and signal of the last step; None before the first. Only of the teams in ``active``
    it is new."""
    active: NDArray[np.bool_]
    """Teams that took the last step, shape (N,)."""

    def before(self, teaming: Teaming) -> None:
        """Note what is known before the turn."""
        if self.signal is None:
            self._belief = np.zeros(teaming.num_teams)
            self._traits = teaming.traits
        self.active, self._last = ~teaming.over, teaming.applied
        self._fatigue = teaming.attention.fatigue

    def after(self, teaming: Teaming, result: StepResult) -> None:
        """Update the beliefs of the teams that took the step."""
        helped = teaming.alerts.help(teaming.attention.accepted, self._fatigue)
        seen = teaming.intended, teaming.applied
        self.signal = read_signal(self._belief, helped, self._traits, self._last, *seen)
        self._belief = np.where(self.active, self.signal.belief, self._belief)
