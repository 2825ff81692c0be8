r"""The exact optimum of the alert problem, and what any alert policy can reach.

With attention seen, alerting is a finite Markov decision process: the state is
(d, i, c) of :mod:`hmi_marl.envs.attention`, the action a^A, the reward the three attention terms
of the paper's reward table, and nothing that the car does changes it. Dynamic programming over
(t, d, i, c) therefore gives exact answers:

.. math::
    V_t(s) = \max_a \sum_{s'} P(s' | s, a) [ r(s, a, s') + V_{t+1}(s') ], \quad V_T = 0

for an episode of T steps from d = i = c = 0. Since i and c move for sure, each state has two
successors, and a step of it costs O(N).

Alerts of k strengths, and fatigue from alerts (:mod:`hmi_marl.envs.alerts`), are the same problem
with a^A and i in 0 .. k and, with fatigue, a fourth axis f in 0 .. F, which moves for sure as
well. Below, S is the shape of the states: (2, 2, window) with the paper's alerts,
(2, k + 1, window) with k strengths, and (2, k + 1, window, F + 1) with fatigue.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hmi_marl.checks import Whole, shown
from hmi_marl.envs.alerts import FULL, Alerts, Fatigue, check_strengths
from hmi_marl.envs.attention import check_window, successors
from hmi_marl.envs.drivers import Driver, get_driver
from hmi_marl.envs.rewards import ATTENTION_TERMS, RewardWeights, attention_terms
from hmi_marl.exact.episode_lengths import sum_first
from hmi_marl.exact.identify import identify as identify  # part of the oracle's interface
from hmi_marl.exact.trait_posterior import trait_posterior as trait_posterior  # this as well

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
    rate_by_strength: NDArray[np.float64]
    """The same for each strength, shape (k, horizon)."""

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

        See :mod:`hmi_marl.exact.episode_lengths` for the lengths of episodes that crashes ended.

        Raises:
            ValueError: not whole numbers from 0 to the horizon.
        """
        by_step = np.sum([self.rewards[term] for term in terms], axis=0)
        return sum_first(by_step, steps)


@dataclass(frozen=True)
class AlertSolution(AlertReturns):
    """The optimum: its exact returns, its policy and its value function."""

    policy: NDArray[np.int8]
    """policy[t, d, i, c] is a^A: 1 to alert, 0 not to; of k strengths, which of them. Shape
    (horizon, 2, 2, window), in general (horizon, *S), so policy[t, d, i, c, f] with fatigue."""
    values: NDArray[np.float64]
    """Expected return from step t on. Shape (horizon + 1, *S); the last is 0."""

    @property
    def alert_probability(self) -> NDArray[np.float64]:
        """The policy as :func:`evaluate` takes one: a 0 or 1 for each alert, (k, horizon, *S).

        With a single strength it is the policy itself, (horizon, *S).
        """
        strengths = len(self.rate_by_strength)
        if strengths == 1:
            return self.policy.astype(np.float64)
        return _each(self.policy, strengths)


class Reachable(NamedTuple):
    """The range of distraction returns between the worst and the best alert policy."""

    least: float
    most: float


HORIZON = Whole(1, 3_600_000, "steps")
"""Range of the steps of an episode."""
MOST_ENTRIES = 250_000_000
"""Most entries of the largest table of a problem: 2 GB."""


def check_horizon(horizon: int) -> int:
    """Return the number of steps of an episode, or raise if it is out of range."""
    return HORIZON("horizon", horizon)


def check_size(*shape: int) -> None:
    """Raise ValueError if a problem's largest table, of this shape, would not fit into memory."""
    if math.prod(shape) > MOST_ENTRIES:
        raise ValueError(
            f"the exact solution takes a table of {shown(math.prod(shape))} numbers, more than "
            f"{MOST_ENTRIES}; use a shorter horizon or window, or fewer strengths or levels"
        )


@dataclass(frozen=True)
class _Chain:
    """One driver's alert problem: effects of a^A in every state, arrays of shape (k + 1, *S)."""

    driver: Driver
    window: int
    horizon: int
    alerts: Alerts
    states: tuple[int, ...]
    """S."""
    p_distracted: NDArray[np.float64]
    """p(d_t = 1)."""
    place: NDArray[np.int64]
    """Index of (i_t, c_t), or (i_t, c_t, f_t), among all such, in the order of S."""
    rewards: dict[str, NDArray[np.float64]]
    """Expected reward of each attention term."""

    @classmethod
    def of(
        cls,
        driver: str | Driver,
        window: int,
        horizon: int,
        weights: RewardWeights | None,
        strengths: Sequence[float],
        fatigue: Fatigue | None,
    ) -> _Chain:
        """Check the arguments of :func:`solve_alerts` and make its problem."""
        driver, window, horizon = get_driver(driver), check_window(window), check_horizon(horizon)
        alerts = Alerts(check_strengths(strengths), fatigue)
        check_size(horizon + 1, alerts.choices, *alerts.shape(window))
        after = successors(driver, window, alerts)
        known = (after.accepted, after.counter, after.fatigue)
        sizes = (alerts.choices, window, alerts.levels + 1)
        action, before, now = np.indices((alerts.choices, 2, 2))
        terms = attention_terms(
            weights or RewardWeights(),
            alert=alerts.strength(action),
            distracted_before=before,
            distracted=now,
        )
        p_now = np.stack([1.0 - after.distracted, after.distracted], axis=-1)
        rewards = {
            name: np.einsum("ad...e,ade->ad...", p_now, terms[name]) for name in ATTENTION_TERMS
        }
        problem = driver, window, horizon, alerts, alerts.shape(window)
        return cls(*problem, after.distracted, np.ravel_multi_index(known, sizes), rewards)

    def expected(self, value: NDArray[np.float64]) -> NDArray[np.float64]:
        """Expectation of ``value``, shape S, in the next step: shape (k + 1, *S)."""
        attentive, distracted = value.reshape(2, -1)
        p = self.p_distracted
        return (1.0 - p) * attentive[self.place] + p * distracted[self.place]

    def action_values(self, value: NDArray[np.float64]) -> NDArray[np.float64]:
        """Expected return of every a^A; ``value``, shape S, is that from the next step on."""
        return sum(self.rewards.values()) + self.expected(value)

    def flow(self, joint: NDArray[np.float64]) -> NDArray[np.float64]:
        """Probability of each state in the next step, from that of [a, state] in this step."""
        states = joint.shape[1:]
        places, count = self.place.ravel(), math.prod(states[1:])
        after = [
            np.bincount(places, (joint * p).ravel(), minlength=count)
            for p in (1.0 - self.p_distracted, self.p_distracted)
        ]
        return np.asarray(after, np.float64).reshape(states)

    def returns(self, probability: NDArray[np.float64]) -> AlertReturns:
        """Returns of a policy that gives each alert with this probability, (k, horizon, *S)."""
        by_step = {name: np.zeros(self.horizon) for name in self.rewards}
        rate_by_strength = np.zeros((self.alerts.strongest, self.horizon))
        occupancy = np.zeros(self.states)
        occupancy.flat[0] = 1.0
        for t in range(self.horizon):
            alerting = probability[:, t]
            silence = np.maximum(0.0, 1.0 - alerting.sum(axis=0))
            joint = np.concatenate([silence[None], alerting]) * occupancy
            rate_by_strength[:, t] = joint[1:].reshape(len(alerting), -1).sum(axis=1)
            for name, reward in self.rewards.items():
                by_step[name][t] = (joint * reward).sum()
            occupancy = self.flow(joint)
        rate = rate_by_strength.sum(axis=0)
        return AlertReturns(self.driver, self.window, self.horizon, by_step, rate, rate_by_strength)


def _each(policy: NDArray[np.int8], strengths: int) -> NDArray[np.float64]:
    """1 where the policy gives the alert, for each of the alerts 1 .. k: shape (k, ...)."""
    return np.stack([policy == alert for alert in range(1, strengths + 1)]).astype(np.float64)


def solve_alerts(
    driver: str | Driver,
    window: int = DEFAULT_WINDOW,
    horizon: int = DEFAULT_HORIZON,
    weights: RewardWeights | None = None,
    *,
    strengths: Sequence[float] = FULL,
    fatigue: Fatigue | None = None,
) -> AlertSolution:
    """The alert policy with the highest attention return, by dynamic programming.

    Where several choices are equally good the policy takes the weakest, no alert before all others.

    Args:
        driver: a known driver's name, or a Driver.
        window: N, the intervention window in steps.
        horizon: steps in the episode.
        weights: of the reward terms; the paper's by default.
        strengths: of the alerts, rising within (0, 1]; the paper's one by default.
        fatigue: from alerts; none by default.

    Raises:
        ValueError, TypeError: unknown driver, a window or horizon out of range, strengths that do
            not rise, or a problem too large for memory.
    """
    chain = _Chain.of(driver, window, horizon, weights, strengths, fatigue)
    policy = np.zeros((chain.horizon, *chain.states), np.int8)
    values = np.zeros((chain.horizon + 1, *chain.states))
    for t in reversed(range(chain.horizon)):
        action_values = chain.action_values(values[t + 1])
        good = action_values >= action_values.max(axis=0) - _TIE
        policy[t] = good.argmax(axis=0)  # the first that is good
        values[t] = np.take_along_axis(action_values, policy[None, t].astype(np.int64), 0)[0]
    returns = chain.returns(_each(policy, chain.alerts.strongest))
    return AlertSolution(**vars(returns), policy=policy, values=values)


def alert_losses(
    driver: str | Driver,
    window: int = DEFAULT_WINDOW,
    horizon: int = DEFAULT_HORIZON,
    weights: RewardWeights | None = None,
    *,
    strengths: Sequence[float] = FULL,
    fatigue: Fatigue | None = None,
) -> NDArray[np.float64]:
    """Loss of attention return by each a^A in each state, with optimal alerts afterwards.

    Added up over the steps of an episode it is an HMI's distance from the optimum, with far less
    noise than the difference of two returns: a policy's expected return is the optimum's less the
    expected sum of its losses.

    Arguments as in :func:`solve_alerts`.

    Returns:
        losses[t, a, d, i, c], or [..., f] with fatigue: V_t(s) - Q_t(s, a), at least 0, shape
        (horizon, k + 1, *S).
    """
    chain = _Chain.of(driver, window, horizon, weights, strengths, fatigue)
    losses = np.zeros((chain.horizon, chain.alerts.choices, *chain.states))
    value = np.zeros(chain.states)
    for t in reversed(range(chain.horizon)):
        action_values = chain.action_values(value)
        value = action_values.max(axis=0)
        losses[t] = value - action_values
    return losses


def evaluate(
    alert_probability: ArrayLike,
    driver: str | Driver,
    window: int = DEFAULT_WINDOW,
    horizon: int = DEFAULT_HORIZON,
    weights: RewardWeights | None = None,
    *,
    strengths: Sequence[float] = FULL,
    fatigue: Fatigue | None = None,
) -> AlertReturns:
    """Exact expected returns of a given HMI policy that sees the driver's attention.

    Args:
        alert_probability: of the policy in [t, d, i, c], each in [0, 1], shape
            (horizon, 2, 2, window), where an axis of size 1 stands for all of it; or one number, a
            random HMI. With k strengths, of each of them, shape (k, horizon, *S); the rest to 1 is
            the probability of no alert.
        driver, window, horizon, weights, strengths, fatigue: as in :func:`solve_alerts`.

    Raises:
        ValueError, TypeError: a probability outside [0, 1], NaN or no number, several with a sum
            above 1, or a shape that does not fit.
    """
    chain = _Chain.of(driver, window, horizon, weights, strengths, fatigue)
    shape = chain.horizon, *chain.states
    return chain.returns(_checked_probability(alert_probability, chain.alerts, shape))


def _fits(size: int, wanted: int) -> bool:
    return size in (1, wanted)


def _checked_probability(
    alert_probability: ArrayLike, alerts: Alerts, shape: tuple[int, ...]
) -> NDArray[np.float64]:
    """The probability of each alert in every step and state, (k, horizon, *S), or an error."""
    given, wanted = np.asarray(alert_probability), (alerts.choices - 1, *shape)
    if given.dtype.kind not in "fiu":
        raise TypeError(f"alert_probability holds numbers, not {shown(alert_probability)}")
    if not np.all((given >= 0) & (given <= 1)):
        raise ValueError("every alert probability lies in [0, 1]")
    # Axes are never guessed: a table of fewer would be read as one of others of the same size.
    full = given[None] if given.ndim == len(shape) and alerts.choices == 2 else given
    fits = full.ndim == len(wanted) and all(map(_fits, full.shape, wanted))
    if not (fits or given.ndim == 0):
        axes = "(alerts, horizon, 2, alerts + 1, window"
        axes += ", levels + 1)" if alerts.fatigue else ")"
        raise ValueError(
            f"alert_probability is one number or has the axes {axes} = {wanted}, each of that size "
            f"or 1 (the first may be left out where it is 1), but its shape is {given.shape}"
        )
    probability = np.broadcast_to(full.astype(np.float64), wanted)
    if len(probability) > 1 and probability.sum(axis=0).max() > 1.0 + _TIE:
        raise ValueError(
            f"the probabilities of the {len(probability)} alerts add up to more than 1 somewhere; "
            "give one for each, shape (alerts, ...)"
        )
    return probability


def reachable(
    driver: str | Driver,
    window: int = DEFAULT_WINDOW,
    horizon: int = DEFAULT_HORIZON,
    weights: RewardWeights | None = None,
    *,
    strengths: Sequence[float] = FULL,
    fatigue: Fatigue | None = None,
) -> Reachable:
    """The least and the most distraction return that any alert policy can reach.

    Arguments as in :func:`solve_alerts`. History-dependent and random policies are covered too,
    since in a Markov decision process a Markov policy attains both ends.
    """
    problem = driver, window, horizon, weights
    ends = reachable_by_steps(*problem, strengths=strengths, fatigue=fatigue)[-1]
    return Reachable(*ends.tolist())


def reachable_by_steps(
    driver: str | Driver,
    window: int = DEFAULT_WINDOW,
    horizon: int = DEFAULT_HORIZON,
    weights: RewardWeights | None = None,
    *,
    strengths: Sequence[float] = FULL,
    fatigue: Fatigue | None = None,
) -> NDArray[np.float64]:
    """The least and the most distraction return in 0 to ``horizon`` steps, (horizon + 1, 2).

    Arguments as in :func:`solve_alerts`. Over episodes of several lengths no policy leaves the mean
    of their rows in expectation, even one that knew the lengths.
    """
    chain = _Chain.of(driver, window, horizon, weights, strengths, fatigue)
    ends = np.zeros((chain.horizon + 1, 2))
    for column, choose in enumerate((np.min, np.max)):
        value = np.zeros(chain.states)
        for steps in range(1, chain.horizon + 1):
            value = choose(chain.rewards["distraction"] + chain.expected(value), axis=0)
            ends[steps, column] = value.flat[0]
    return ends
