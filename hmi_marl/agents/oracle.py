r"""The exact optimum of the alert problem, and what any alert policy can reach.

With attention seen, alerting is a finite Markov decision process of its own: the state is
(d, i, c) of :mod:`hmi_marl.envs.attention`, the action a^A, the reward the three attention terms
of the paper's reward table, and nothing that the car does changes it. Dynamic programming over
(t, d, i, c) therefore gives exact answers:

.. math::
    V_t(s) = \max_a \sum_{s'} P(s' | s, a) [ r(s, a, s') + V_{t+1}(s') ], \quad V_T = 0

for an episode of T steps from d = i = c = 0. Since i and c move for sure, each state has two
successors, and a step of it costs O(N).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hmi_marl.agents.identify import identify as identify  # exact as well: who drives
from hmi_marl.envs.attention import Successors, check_window, successors
from hmi_marl.envs.drivers import Driver, get_driver
from hmi_marl.envs.rewards import ATTENTION_TERMS, RewardWeights, attention_terms

DEFAULT_WINDOW = 7
DEFAULT_HORIZON = 100
_TIE = 1e-12


@dataclass(frozen=True)
class AlertReturns:
    """Exact expectations over one episode of an alert policy for one driver."""

    driver: Driver
    window: int
    """N, in steps."""
    horizon: int
    """Steps in the episode."""
    rewards: dict[str, NDArray[np.float64]]
    """Expected reward of each attention term in each step, shape (horizon,)."""
    alert_rate: NDArray[np.float64]
    """Probability of an alert in each step, shape (horizon,)."""

    @property
    def distraction_return(self) -> float:
        """Expected sum of R_distraction."""
        return float(self.rewards["distraction"].sum())

    @property
    def total_return(self) -> float:
        """Expected attention return: the distraction, alert and accept-alert terms."""
        return float(sum(term.sum() for term in self.rewards.values()))

    @property
    def alerts(self) -> float:
        """Expected number of alerts."""
        return float(self.alert_rate.sum())

    def return_after(
        self, steps: ArrayLike, terms: Sequence[str] = ATTENTION_TERMS
    ) -> NDArray[np.float64]:
        """Expected sum of some reward terms over the first ``steps`` steps, of any shape.

        Raises:
            ValueError: not whole numbers from 0 to the horizon.
        """
        count = np.asarray(steps)
        whole = np.issubdtype(count.dtype, np.integer)
        if not whole or np.any((count < 0) | (count > self.horizon)):
            raise ValueError(f"steps are whole numbers from 0 to {self.horizon}, but got {steps!r}")
        by_step = np.sum([self.rewards[term] for term in terms], axis=0)
        return np.concatenate(([0.0], np.cumsum(by_step)))[count]


@dataclass(frozen=True)
class AlertSolution(AlertReturns):
    """The optimum: its exact returns, its policy and its value function."""

    policy: NDArray[np.int8]
    """policy[t, d, i, c] is 1 to alert, 0 not to. Shape (horizon, 2, 2, window)."""
    values: NDArray[np.float64]
    """Expected return from step t on. Shape (horizon + 1, 2, 2, window); the last is 0."""


class Reachable(NamedTuple):
    """The range of distraction returns between the worst and the best alert policy."""

    least: float
    most: float


def check_horizon(horizon: int) -> int:
    """Return the number of steps, or raise if it is not a positive integer."""
    if isinstance(horizon, bool) or not isinstance(horizon, (int, np.integer)):
        raise TypeError(f"horizon is a whole number of steps, not {horizon!r}")
    if horizon < 1:
        raise ValueError(f"horizon is at least 1 step, but got {horizon}")
    return int(horizon)


def _expected_rewards(after: Successors, weights: RewardWeights) -> dict[str, NDArray[np.float64]]:
    """Expected reward of each attention term, each of shape (2, 2, 2, N) = [a, d, i, c]."""
    alert, before, now = np.indices((2, 2, 2))
    terms = attention_terms(weights, alert=alert, distracted_before=before, distracted=now)
    p_now = np.stack([1.0 - after.distracted, after.distracted], axis=-1)
    return {name: np.einsum("adice,ade->adic", p_now, terms[name]) for name in ATTENTION_TERMS}


def _expected_value(after: Successors, value: NDArray[np.float64]) -> NDArray[np.float64]:
    """Of ``value`` [d, i, c] in the next step; shape (2, 2, 2, N) = [a, d, i, c]."""
    attentive = value[0, after.accepted, after.counter]
    distracted = value[1, after.accepted, after.counter]
    return (1.0 - after.distracted) * attentive + after.distracted * distracted


def _flow(after: Successors, joint: NDArray[np.float64]) -> NDArray[np.float64]:
    """Probability of each [d, i, c] in the next step, from that of [a, d, i, c] in this one."""
    window = joint.shape[-1]
    place = (after.accepted * window + after.counter).ravel()
    return np.stack(
        [
            np.bincount(place, (joint * p).ravel(), minlength=2 * window).reshape(2, window)
            for p in (1.0 - after.distracted, after.distracted)
        ]
    )


def solve_alerts(
    driver: str | Driver,
    window: int = DEFAULT_WINDOW,
    horizon: int = DEFAULT_HORIZON,
    weights: RewardWeights | None = None,
) -> AlertSolution:
    """The alert policy with the highest attention return, by dynamic programming.

    Where both choices are equally good the policy does not alert.

    Args:
        driver: a known driver's name, or a Driver.
        window: N, the intervention window in steps.
        horizon: steps in the episode.
        weights: of the reward terms; the paper's by default.

    Raises:
        ValueError: unknown driver, window < 1 or horizon < 1.
    """
    driver, window, horizon = get_driver(driver), check_window(window), check_horizon(horizon)
    weights = weights or RewardWeights()
    after = successors(driver, window)
    reward = sum(_expected_rewards(after, weights).values())
    policy = np.zeros((horizon, 2, 2, window), np.int8)
    values = np.zeros((horizon + 1, 2, 2, window))
    for t in reversed(range(horizon)):
        action_values = reward + _expected_value(after, values[t + 1])
        policy[t] = action_values[1] > action_values[0] + _TIE
        values[t] = np.where(policy[t], action_values[1], action_values[0])
    returns = evaluate(policy, driver, window, horizon, weights)
    return AlertSolution(**vars(returns), policy=policy, values=values)


def evaluate(
    alert_probability: ArrayLike,
    driver: str | Driver,
    window: int = DEFAULT_WINDOW,
    horizon: int = DEFAULT_HORIZON,
    weights: RewardWeights | None = None,
) -> AlertReturns:
    """Exact expected returns of a given HMI policy that sees the driver's attention.

    Args:
        alert_probability: of the policy in [t, d, i, c], each in [0, 1]; any shape that
            broadcasts to (horizon, 2, 2, window), so that a single number is a random HMI.
        driver, window, horizon, weights: as in :func:`solve_alerts`.

    Raises:
        ValueError: a probability outside [0, 1] or NaN, or a shape that does not fit.
    """
    driver, window, horizon = get_driver(driver), check_window(window), check_horizon(horizon)
    given = np.asarray(alert_probability, np.float64)
    try:
        probability = np.broadcast_to(given, (horizon, 2, 2, window))
    except ValueError:
        raise ValueError(
            f"alert_probability of shape {given.shape} does not broadcast to "
            f"(horizon, 2, 2, window) = {(horizon, 2, 2, window)}"
        ) from None
    if not np.all((probability >= 0) & (probability <= 1)):
        raise ValueError("every alert probability lies in [0, 1]")
    after = successors(driver, window)
    rewards = _expected_rewards(after, weights or RewardWeights())
    by_step = {name: np.zeros(horizon) for name in rewards}
    alert_rate = np.zeros(horizon)
    occupancy = np.zeros((2, 2, window))
    occupancy[0, 0, 0] = 1.0
    for t in range(horizon):
        joint = np.stack([1.0 - probability[t], probability[t]]) * occupancy
        alert_rate[t] = joint[1].sum()
        for name, reward in rewards.items():
            by_step[name][t] = (joint * reward).sum()
        occupancy = _flow(after, joint)
    return AlertReturns(driver, window, horizon, by_step, alert_rate)


def reachable(
    driver: str | Driver,
    window: int = DEFAULT_WINDOW,
    horizon: int = DEFAULT_HORIZON,
    weights: RewardWeights | None = None,
) -> Reachable:
    """The least and the most distraction return that any alert policy can reach.

    Arguments as in :func:`solve_alerts`. History-dependent and random policies are covered too,
    since in a Markov decision process a Markov policy attains both ends.
    """
    driver, window, horizon = get_driver(driver), check_window(window), check_horizon(horizon)
    after = successors(driver, window)
    reward = _expected_rewards(after, weights or RewardWeights())["distraction"]
    ends = []
    for choose in (np.min, np.max):
        value = np.zeros((2, 2, window))
        for _ in range(horizon):
            value = choose(reward + _expected_value(after, value), axis=0)
        ends.append(float(value[0, 0, 0]))
    return Reachable(*ends)
