"""HMIs that need no training, from no alerts to the exact optimum."""

from __future__ import annotations

from functools import lru_cache
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from hmi_marl.agents.memory import AttentionWatch, Draws, Memoryless, step_of
from hmi_marl.checks import SHARE
from hmi_marl.envs.alerts import PLAIN, Alerts, Fatigue, need_plain
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import Driver, get_driver
from hmi_marl.envs.observations import vehicle_ai_layout
from hmi_marl.envs.rewards import RewardWeights
from hmi_marl.envs.streams import Stream
from hmi_marl.exact.hidden_attention import DEFAULT_REVEALING, solve_belief
from hmi_marl.exact.oracle import AlertSolution, solve_alerts


@runtime_checkable
class AttentionRule(Protocol):
    """An HMI that alerts by (t, d, i, c, f) alone, so that its returns can be computed exactly."""

    def alert_probability(self) -> NDArray[np.float64]:
        """Return p(alert) at [t, d, i, c(, f)] for each alert; see :func:`oracle.evaluate`."""
        ...


def _need_attention(config: TeamConfig, name: str) -> None:
    if not config.ai_sees_attention:
        raise ValueError(
            f"{name} needs to see the driver's attention, which ai_sees_attention=False hides; "
            "use 'belief', which infers it"
        )


def strongest_alert(alerts: Alerts, *probability: float) -> NDArray[np.float64]:
    """Return alert probabilities for the oracle of a rule that gives only the strongest alert.

    Args:
        probability: probability of that alert, one number, or one for d = 0 and one for d = 1.

    Returns:
        Probability of each alert, shape (k, 1, 1 or 2, 1, 1), or (k, 1, 1 or 2, 1, 1, 1) with
        fatigue; without the first axis if there is a single strength.
    """
    after_d = (1,) * (len(alerts.shape(1)) - 1)
    rule = np.zeros((alerts.strongest, 1, len(probability), *after_d))
    rule[-1, 0] = np.reshape(probability, (-1, *after_d))
    return rule if len(rule) > 1 else rule[0]


class RandomAlert:
    """Alert in each step with probability ``rate``, in [0, 1], by the strongest of ``alerts``."""

    reads: tuple[str, ...] = ()
    """Parts of the observation that it reads."""

    def __init__(self, rate: float, alerts: Alerts = PLAIN) -> None:
        self.rate = SHARE("an alert rate", rate)
        self._alerts = alerts
        self._draws = Draws(Stream.HMI_POLICY)

    @property
    def _certain(self) -> bool:
        """Whether no draw decides."""
        return self.rate in (0.0, 1.0)

    def reset(self, seeds: NDArray[np.uint64], which: NDArray[np.bool_] | None = None) -> None:
        """See :meth:`Policy.reset`."""
        if not self._certain:
            self._draws.reset(seeds, which)

    def act(self, observations: NDArray[np.float32]) -> NDArray[np.int64]:
        """See :meth:`Policy.act`."""
        if self._certain:
            return np.full(len(observations), self._alerts.strongest * int(self.rate))
        return self._alerts.strongest * (self._draws.next() < self.rate).astype(np.int64)

    def alert_probability(self) -> NDArray[np.float64]:
        """Return the rate for every state."""
        return strongest_alert(self._alerts, self.rate)


class AlertWhenDistracted(Memoryless):
    """Alert exactly when the driver was distracted in the last step, as strongly as possible."""

    reads: tuple[str, ...] = ("distracted",)
    """Parts of the observation that it reads."""

    def __init__(self, config: TeamConfig) -> None:
        _need_attention(config, "'when-distracted'")
        self._layout = vehicle_ai_layout(config)
        self._alerts = config.alerts

    def act(self, observations: NDArray[np.float32]) -> NDArray[np.int64]:
        """See :meth:`Policy.act`."""
        distracted = self._layout.scalar(observations, "distracted") == 1
        return self._alerts.strongest * distracted.astype(np.int64)

    def alert_probability(self) -> NDArray[np.float64]:
        """Return 1 where d = 1."""
        return strongest_alert(self._alerts, 0.0, 1.0)


class OptimalAlert(Memoryless):
    """Exact optimum for a driver model, alert strengths and fatigue, if attention is visible."""

    def __init__(self, model: str | Driver, config: TeamConfig) -> None:
        self.model = get_driver(model)
        _need_attention(config, "the optimum over (t, d, i, c)")
        self._layout = vehicle_ai_layout(config)
        self._alerts = config.alerts
        self._horizon, self._window = config.horizon, config.alert_window
        fatigue = () if config.fatigue is None else ("fatigue",)
        self.reads: tuple[str, ...] = ("time", "distracted", "accepted", "counter", *fatigue)
        """Parts of the observation that it reads."""
        self._solution = _optimum(
            self.model,
            config.alert_window,
            config.horizon,
            config.weights,
            config.alert_strengths,
            config.fatigue,
        )

    def act(self, observations: NDArray[np.float32]) -> NDArray[np.int64]:
        """See :meth:`Policy.act`."""
        scalar = self._layout.scalar
        step = step_of(scalar(observations, "time"), self._horizon)
        distracted = (scalar(observations, "distracted") == 1).astype(np.int64)
        accepted = self._alerts.nearest(scalar(observations, "accepted"))
        counter = np.rint(scalar(observations, "counter") * self._window).astype(np.int64)
        state = [step, distracted, accepted, counter]
        if self._alerts.fatigue is not None:
            level = scalar(observations, "fatigue") * self._alerts.levels
            state.append(np.rint(level).astype(np.int64))
        return self._solution.policy[tuple(state)].astype(np.int64)

    def alert_probability(self) -> NDArray[np.float64]:
        """Return the optimal policy."""
        return self._solution.alert_probability


@lru_cache(maxsize=8)  # a server makes the same few HMIs for each trip
def _optimum(
    model: Driver,
    window: int,
    horizon: int,
    weights: RewardWeights,
    strengths: tuple[float, ...],
    fatigue: Fatigue | None,
) -> AlertSolution:
    solution = solve_alerts(model, window, horizon, weights, strengths=strengths, fatigue=fatigue)
    solution.policy.flags.writeable = solution.values.flags.writeable = False
    return solution


class BeliefAlert:
    """Keep the Bayes belief over d from a^H and v, and alert by the rule that is optimal on it.

    It does not use d, i or c of its observation. See :mod:`hmi_marl.exact.hidden_attention`.

    Args:
        model: driver model of the belief and the rule.
        revealing: assumed share of steps in which a^H differs from the last applied action.
        sequential: False where both agents move simultaneously: the AI sees a^H one step late.
    """

    def __init__(
        self,
        model: str | Driver,
        config: TeamConfig,
        revealing: float = DEFAULT_REVEALING,
        sequential: bool = True,
    ) -> None:
        need_plain(config.alerts, "'belief', the Bayes belief over attention,")
        self.model = get_driver(model)
        self._sequential = sequential
        self._rule = solve_belief(
            self.model, config.alert_window, config.horizon, config.weights, revealing, sequential
        )
        self._attention = AttentionWatch([self.model], config)

    @property
    def belief(self) -> NDArray[np.float64]:
        """p(d = 1) after the last step that was seen, shape (N,)."""
        return self._attention.filter.distracted[:, 0].copy()

    def reset(self, seeds: NDArray[np.uint64], which: NDArray[np.bool_] | None = None) -> None:
        """See :meth:`Policy.reset`."""
        self._attention.reset(len(seeds), which)

    def act(self, observations: NDArray[np.float32]) -> NDArray[np.int64]:
        """See :meth:`Policy.act`."""
        step = self._attention.observe(observations)
        if self._sequential:
            reveals = self._attention.reveals(observations)
        else:
            reveals = np.zeros(len(step), np.bool_)  # not known yet; the rule weighs both
        now = self._attention.filter
        return self._rule.alert(step, reveals, self.belief, now.accepted, now.counter)
