r"""Alerting without a driver-monitoring camera: the Bayes belief over d and its optimal rule.

With attention hidden the AI sees d only through the applied action. The driver model says
v_t = v_{t-1} if d_t = 1, else a^H_t, so a step *reveals* d_t when a^H_t differs from v_{t-1} and
tells nothing when they agree. i and c follow from the AI's own alerts and are known. The belief
b = p(d = 1) therefore moves by

.. math::
    b' = b (1 - \min(1, \alpha + \eta i')) + (1 - b) \max(0, \beta - \eta i')

in a silent step, and to the d that was seen in a revealing one. The first step is always silent,
since v_0 = a^H_0. On (t, b, i, c) this is again a
Markov decision process, given how often steps reveal; it is solved here on a grid of beliefs.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from hmi_marl.agents.oracle import check_horizon
from hmi_marl.envs.attention import check_window, distraction_probability, next_acceptance
from hmi_marl.envs.drivers import Driver, get_driver
from hmi_marl.envs.rewards import RewardWeights

DEFAULT_REVEALING = 0.3
GRID = 201


@dataclass(frozen=True)
class BeliefSolution:
    """The optimal alert rule on the belief, for one driver model."""

    driver: Driver
    window: int
    horizon: int
    revealing: float
    """Assumed share of steps, of those after the first, in which a^H differs from the last
    applied action."""
    total_return: float
    """Expected attention return of the rule if the model is true."""
    advantage: NDArray[np.float32]
    """Value of alerting minus not alerting, [t, m, b, i, c] with m = 1 in a revealing step.
    Shape (horizon, 2, GRID, 2, window)."""

    def alert(
        self,
        step: NDArray[np.int64],
        reveals: NDArray[np.bool_],
        belief: NDArray[np.float64],
        accepted: NDArray[np.int64],
        counter: NDArray[np.int64],
    ) -> NDArray[np.int64]:
        """The rule for N teams, 1 to alert; every argument has shape (N,)."""
        low, fraction = _locate(belief)
        t = np.minimum(step, self.horizon - 1)
        m = reveals.astype(np.int64)
        below = self.advantage[t, m, low, accepted, counter]
        above = self.advantage[t, m, low + 1, accepted, counter]
        return ((1 - fraction) * below + fraction * above > 0).astype(np.int64)


def _locate(belief: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """The grid point at or below each belief, and how far it is to the next one."""
    position = belief * (GRID - 1)
    low = np.minimum(position.astype(np.int64), GRID - 2)
    return low, position - low


def predict(
    belief: NDArray[np.float64], accepted: NDArray[np.int64], driver: Driver
) -> NDArray[np.float64]:
    """p(d_t = 1) before v_t is seen, from b = p(d_{t-1} = 1) and i_t. Shapes broadcast."""
    traits = driver.beta, driver.alpha, driver.eta
    stays = distraction_probability(1, accepted, *traits)
    becomes = distraction_probability(0, accepted, *traits)
    return belief * stays + (1.0 - belief) * becomes


def correct(
    predicted: NDArray[np.float64],
    intended: NDArray[np.int64],
    applied_before: NDArray[np.int64],
    applied: NDArray[np.int64],
) -> NDArray[np.float64]:
    """The belief after v_t is seen: certain where a^H_t differs from v_{t-1}, else as predicted.

    Args:
        predicted: p(d_t = 1) from :func:`predict`, shape (N,).
        intended: a^H_t.
        applied_before: v_{t-1}, or -1 before the first step, in which v_0 = a^H_0 tells nothing.
        applied: v_t.
    """
    reveals = (applied_before >= 0) & (intended != applied_before)
    return np.where(reveals, (applied == applied_before).astype(np.float64), predicted)


@lru_cache(maxsize=64)
def solve_belief(
    driver: str | Driver,
    window: int,
    horizon: int,
    weights: RewardWeights,
    revealing: float = DEFAULT_REVEALING,
    sees_intent: bool = True,
) -> BeliefSolution:
    """Dynamic programming over (t, b, i, c), with ``revealing`` of the steps showing d.

    Each step but the first reveals d independently with that probability. Whether the present one
    will is known when alerting if ``sees_intent``, that is, when taking turns (a^H_t and v_{t-1}
    are both seen); at once it is not, and both cases are weighed.

    Raises:
        ValueError: ``revealing`` outside [0, 1], or what :func:`oracle.solve_alerts` refuses.
    """
    driver, window, horizon = get_driver(driver), check_window(window), check_horizon(horizon)
    if not 0.0 <= revealing <= 1.0:
        raise ValueError(f"revealing is a share in [0, 1], but got {revealing}")
    belief, accepted, counter = np.meshgrid(
        np.linspace(0.0, 1.0, GRID), np.arange(2), np.arange(window), indexing="ij"
    )
    advantage = np.empty((horizon, 2, *belief.shape), np.float32)
    value = np.zeros_like(belief)
    choices = [
        _Choice.of(alert, belief, accepted, counter, driver, window, weights) for alert in (0, 1)
    ]
    for t in reversed(range(horizon)):
        share = revealing if t > 0 else 0.0
        silent = [choice.value_if_silent(value) for choice in choices]
        revealed = [choice.value_if_revealed(value) for choice in choices]
        if not sees_intent:
            both = [(1 - share) * s + share * r for s, r in zip(silent, revealed, strict=True)]
            silent = revealed = both
        advantage[t, 0] = silent[1] - silent[0]
        advantage[t, 1] = revealed[1] - revealed[0]
        value = (1 - share) * np.maximum(*silent) + share * np.maximum(*revealed)
    return BeliefSolution(driver, window, horizon, revealing, float(value[0, 0, 0]), advantage)


@dataclass(frozen=True)
class _Choice:
    """What alerting, or not, leads to from every grid point; arrays of shape (GRID, 2, window)."""

    reward: NDArray[np.float64]
    distracted: NDArray[np.float64]
    accepted: NDArray[np.int64]
    counter: NDArray[np.int64]

    @classmethod
    def of(
        cls,
        alert: int,
        belief: NDArray[np.float64],
        accepted: NDArray[np.int64],
        counter: NDArray[np.int64],
        driver: Driver,
        window: int,
        weights: RewardWeights,
    ) -> _Choice:
        next_accepted, next_counter = next_acceptance(accepted, counter, alert, window)
        distracted = predict(belief, next_accepted, driver)
        recovers = belief * (
            1.0 - distraction_probability(1, next_accepted, driver.beta, driver.alpha, driver.eta)
        )
        for_alert = weights.accept_alert * recovers if alert else weights.alert * (1.0 - belief)
        reward = weights.distraction * distracted + for_alert
        return cls(reward, distracted, next_accepted, next_counter)

    def value_if_silent(self, value: NDArray[np.float64]) -> NDArray[np.float64]:
        low, fraction = _locate(self.distracted)
        below = value[low, self.accepted, self.counter]
        above = value[low + 1, self.accepted, self.counter]
        return self.reward + (1 - fraction) * below + fraction * above

    def value_if_revealed(self, value: NDArray[np.float64]) -> NDArray[np.float64]:
        attentive = value[0, self.accepted, self.counter]
        distracted = value[-1, self.accepted, self.counter]
        return self.reward + (1 - self.distracted) * attentive + self.distracted * distracted
