"""HMIs that need no training, from none at all to the exact optimum."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from hmi_marl.agents.belief import DEFAULT_REVEALING, correct, predict, solve_belief
from hmi_marl.agents.memory import Draws, Memoryless
from hmi_marl.agents.oracle import solve_alerts
from hmi_marl.envs.attention import next_acceptance
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import Driver, get_driver
from hmi_marl.envs.observations import vehicle_ai_layout
from hmi_marl.envs.streams import Stream
from hmi_marl.envs.teaming import NO_ACTION


@runtime_checkable
class AttentionRule(Protocol):
    """An HMI whose alert depends on (t, d, i, c) alone, so that its returns are known exactly."""

    def alert_probability(self) -> NDArray[np.float64]:
        """In every [t, d, i, c]; broadcasts to (horizon, 2, 2, window), as the oracle takes it."""
        ...


def _need_attention(config: TeamConfig, who: str) -> None:
    if not config.ai_sees_attention:
        raise ValueError(
            f"{who} needs to see the driver's attention, which ai_sees_attention=False hides; "
            "use 'belief', which infers it"
        )


class RandomAlert:
    """Alert at a rate, whatever happens. Rate 0 never alerts, rate 1 always."""

    def __init__(self, rate: float) -> None:
        if not 0.0 <= rate <= 1.0:
            raise ValueError(f"an alert rate lies in [0, 1], but got {rate}")
        self.rate = float(rate)
        self._draws = Draws(Stream.HMI_POLICY)

    def reset(self, seeds: NDArray[np.uint64], which: NDArray[np.bool_] | None = None) -> None:
        """See :meth:`Policy.reset`."""
        self._draws.reset(seeds, which)

    def act(self, observations: NDArray[np.float32]) -> NDArray[np.int64]:
        """See :meth:`Policy.act`."""
        return (self._draws.next() < self.rate).astype(np.int64)

    def alert_probability(self) -> NDArray[np.float64]:
        """The rate, everywhere."""
        return np.array(self.rate)


class AlertWhenDistracted(Memoryless):
    """Alert exactly when the driver was distracted in the last step."""

    def __init__(self, config: TeamConfig) -> None:
        _need_attention(config, "'when-distracted'")
        self._layout = vehicle_ai_layout(config)

    def act(self, observations: NDArray[np.float32]) -> NDArray[np.int64]:
        """See :meth:`Policy.act`."""
        return (self._layout.scalar(observations, "distracted") == 1).astype(np.int64)

    def alert_probability(self) -> NDArray[np.float64]:
        """1 where d = 1."""
        return np.arange(2.0).reshape(1, 2, 1, 1)


class OptimalAlert(Memoryless):
    """The exact optimum of the alert problem for a given driver model, attention seen."""

    def __init__(self, model: str | Driver, config: TeamConfig) -> None:
        self.model = get_driver(model)
        _need_attention(config, "the optimum over (t, d, i, c)")
        self._layout = vehicle_ai_layout(config)
        self._horizon, self._window = config.horizon, config.alert_window
        self._policy = solve_alerts(
            self.model, config.alert_window, config.horizon, config.weights
        ).policy

    def act(self, observations: NDArray[np.float32]) -> NDArray[np.int64]:
        """See :meth:`Policy.act`."""
        scalar = self._layout.scalar
        step = _step(scalar(observations, "time"), self._horizon)
        distracted = (scalar(observations, "distracted") == 1).astype(np.int64)
        accepted = (scalar(observations, "accepted") == 1).astype(np.int64)
        counter = np.rint(scalar(observations, "counter") * self._window).astype(np.int64)
        return self._policy[step, distracted, accepted, counter].astype(np.int64)

    def alert_probability(self) -> NDArray[np.float64]:
        """The optimal policy itself."""
        return self._policy.astype(np.float64)


class BeliefAlert:
    """Keeps the Bayes belief over d from a^H and v, and alerts by the rule optimal on it.

    It never looks at d, i or c in its observation. See :mod:`hmi_marl.agents.belief`.

    Args:
        model: the driver whose traits the belief and the rule assume.
        config: of the team.
        revealing: assumed share of steps in which a^H differs from the last applied action.
        taking_turns: False in a parallel environment, where the AI sees a^H one step late.
    """

    def __init__(
        self,
        model: str | Driver,
        config: TeamConfig,
        revealing: float = DEFAULT_REVEALING,
        taking_turns: bool = True,
    ) -> None:
        self.model = get_driver(model)
        self._layout = vehicle_ai_layout(config)
        self._horizon, self._window = config.horizon, config.alert_window
        self._taking_turns = taking_turns
        self._rule = solve_belief(
            self.model, config.alert_window, config.horizon, config.weights, revealing, taking_turns
        )
        self.reset(np.zeros(1, np.uint64))

    def reset(self, seeds: NDArray[np.uint64], which: NDArray[np.bool_] | None = None) -> None:
        """See :meth:`Policy.reset`."""
        if which is None:
            which = np.ones(len(seeds), np.bool_)
            self.belief = np.zeros(len(seeds))
            self._accepted, self._counter = np.zeros((2, len(seeds)), np.int64)
            self._applied_before = np.full(len(seeds), NO_ACTION)
        self.belief = np.where(which, 0.0, self.belief)
        """p(d = 1) after the last step that was seen, shape (N,)."""
        self._accepted = np.where(which, 0, self._accepted)
        self._counter = np.where(which, 0, self._counter)
        self._applied_before = np.where(which, NO_ACTION, self._applied_before)

    def act(self, observations: NDArray[np.float32]) -> NDArray[np.int64]:
        """See :meth:`Policy.act`."""
        layout = self._layout
        step = _step(layout.scalar(observations, "time"), self._horizon)
        applied = layout.chosen(observations, "applied_action")
        self._see(step, layout.chosen(observations, "previous_intended_action"), applied)
        if self._taking_turns:
            intended = layout.chosen(observations, "intended_action")
            reveals = (applied != NO_ACTION) & (intended != applied)
        else:
            reveals = np.zeros(len(step), np.bool_)  # not known yet; the rule weighs both
        alert = self._rule.alert(step, reveals, self.belief, self._accepted, self._counter)
        self._accepted, self._counter = next_acceptance(
            self._accepted, self._counter, alert, self._window
        )
        return alert

    def _see(
        self, step: NDArray[np.int64], intended: NDArray[np.int64], applied: NDArray[np.int64]
    ) -> None:
        """Take in the last step: a^H_{t-1} and v_{t-1}, after v_{t-2}."""
        predicted = predict(self.belief, self._accepted, self.model)
        seen = correct(predicted, intended, self._applied_before, applied)
        self.belief = np.where(step > 0, seen, self.belief)
        self._applied_before = applied


def _step(time: NDArray[np.float32], horizon: int) -> NDArray[np.int64]:
    """Steps taken, from the share of the episode that is over; the last step's at its end."""
    return np.minimum(np.rint(time * horizon).astype(np.int64), horizon - 1)
