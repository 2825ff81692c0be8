r"""Alerting without a driver-monitoring camera: the Bayes belief over d and its optimal rule.

With attention hidden the AI sees d only through the applied action. In the driver model
v_t = v_{t-1} if d_t = 1, else a^H_t, so a step *reveals* d_t when a^H_t differs from v_{t-1} and is
silent when they agree. i and c follow from the AI's own alerts and are known. The belief
b = p(d = 1) therefore moves by

.. math::
    b' = b (1 - \min(1, \alpha + \eta i')) + (1 - b) \max(0, \beta - \eta i')

in a silent step, and to the d that was seen in a revealing one. The first step is always silent,
since v_0 = a^H_0. On (t, b, i, c) this is again a Markov decision process, given the share of
revealing steps; it is solved here on a grid of beliefs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hmi_marl.checks import SHARE
from hmi_marl.envs.attention import check_window, distraction_probability, next_acceptance
from hmi_marl.envs.drivers import Driver, get_driver
from hmi_marl.envs.rewards import RewardWeights
from hmi_marl.exact import bayes_filter
from hmi_marl.exact.episode_lengths import sum_first
from hmi_marl.exact.oracle import check_horizon, check_size
from hmi_marl.exact.signalling import entropy

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
        """The rule for N teams, 1 to alert; every argument has shape (N,), or another one."""
        t, m = np.minimum(step, self.horizon - 1), reveals.astype(np.int64)
        return (look_up(self.advantage, (t, m), belief, (accepted, counter)) > 0).astype(np.int64)


def locate(belief: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """The grid point at or below each belief, and the fraction of the way to the next one."""
    position = belief * (GRID - 1)
    low = np.minimum(position.astype(np.int64), GRID - 2)
    return low, position - low


def look_up(
    table: NDArray[np.floating],
    before: tuple[NDArray[np.int64], ...],
    belief: NDArray[np.float64],
    after: tuple[NDArray[np.int64], ...],
) -> NDArray[np.float64]:
    """Entries of a table with an axis of beliefs, between its grid points along a line.

    Args:
        table: its axes are those of ``before``, then beliefs, then those of ``after``.
        before, after: places on the other axes; they and ``belief`` are broadcast to one shape.
        belief: p(d = 1).
    """
    low, fraction = locate(belief)
    below, above = table[*before, low, *after], table[*before, low + 1, *after]
    return (1 - fraction) * below + fraction * above


def predict(
    belief: NDArray[np.float64], accepted: NDArray[np.int64], driver: Driver
) -> NDArray[np.float64]:
    """p(d_t = 1) before v_t is seen, from b = p(d_{t-1} = 1) and i_t. Shapes broadcast."""
    return bayes_filter.predict(belief, 1.0 - belief, accepted, driver)[0]


def solve_belief(
    driver: str | Driver,
    window: int,
    horizon: int,
    weights: RewardWeights,
    revealing: float = DEFAULT_REVEALING,
    sequential: bool = True,
) -> BeliefSolution:
    """Dynamic programming over (t, b, i, c), with ``revealing`` of the steps showing d.

    Each step but the first reveals d independently with that probability. With ``sequential`` moves
    (a^H_t and v_{t-1} are both seen) the alert depends on whether the present step will; with
    simultaneous moves it does not, and both cases are weighed.

    Raises:
        ValueError: ``revealing`` outside [0, 1], or what :func:`oracle.solve_alerts` refuses.
    """
    driver, window, horizon = get_driver(driver), check_window(window), check_horizon(horizon)
    revealing = SHARE("revealing", revealing)
    check_size(horizon, 2, GRID, 2, window)
    return _solved(driver, window, horizon, weights, revealing, bool(sequential))


@lru_cache(maxsize=64)
def _solved(
    driver: Driver,
    window: int,
    horizon: int,
    weights: RewardWeights,
    revealing: float,
    sequential: bool,
) -> BeliefSolution:
    """The same for checked arguments; equal ones share a solution."""
    belief, accepted, counter = np.meshgrid(
        np.linspace(0.0, 1.0, GRID), np.arange(2), np.arange(window), indexing="ij"
    )
    advantage = np.empty((horizon, 2, *belief.shape), np.float32)
    value = np.zeros_like(belief)
    choices = [
        _Consequence.of(
            np.full(belief.shape, a), belief, accepted, counter, driver, window, weights
        )
        for a in (0, 1)
    ]
    for t in reversed(range(horizon)):
        share = revealing if t > 0 else 0.0
        silent = [choice.value_if_silent(value) for choice in choices]
        revealed = [choice.value_if_revealed(value) for choice in choices]
        if not sequential:
            both = [(1 - share) * s + share * r for s, r in zip(silent, revealed, strict=True)]
            silent = revealed = both
        advantage[t, 0] = silent[1] - silent[0]
        advantage[t, 1] = revealed[1] - revealed[0]
        value = (1 - share) * np.maximum(*silent) + share * np.maximum(*revealed)
    advantage.flags.writeable = False  # later calls return the same
    return BeliefSolution(driver, window, horizon, revealing, float(value[0, 0, 0]), advantage)


@dataclass(frozen=True)
class _Consequence:
    """Consequences of a^A_t where p(d_{t-1} = 1) is given; arrays of one shape."""

    reward: NDArray[np.float64]
    """Expected."""
    distracted: NDArray[np.float64]
    """p(d_t = 1)."""
    accepted: NDArray[np.int64]
    """i_t."""
    counter: NDArray[np.int64]
    """c_t."""

    @classmethod
    def of(
        cls,
        alert: NDArray[np.int64],
        distracted: NDArray[np.float64],
        accepted: NDArray[np.int64],
        counter: NDArray[np.int64],
        driver: Driver,
        window: int,
        weights: RewardWeights,
    ) -> _Consequence:
        next_i, next_c = next_acceptance(accepted, counter, alert, window)
        after = predict(distracted, next_i, driver)
        stays = distraction_probability(1, next_i, driver.beta, driver.alpha, driver.eta)
        recovers = distracted * (1.0 - stays)
        for_alert = np.where(
            alert == 1, weights.accept_alert * recovers, weights.alert * (1.0 - distracted)
        )
        return cls(weights.distraction * after + for_alert, after, next_i, next_c)

    def value_if_silent(self, value: NDArray[np.float64]) -> NDArray[np.float64]:
        low, fraction = locate(self.distracted)
        below = value[low, self.accepted, self.counter]
        above = value[low + 1, self.accepted, self.counter]
        return self.reward + (1 - fraction) * below + fraction * above

    def value_if_revealed(self, value: NDArray[np.float64]) -> NDArray[np.float64]:
        attentive = value[0, self.accepted, self.counter]
        distracted = value[-1, self.accepted, self.counter]
        return self.reward + (1 - self.distracted) * attentive + self.distracted * distracted


@dataclass(frozen=True)
class RuleOutcome:
    """Exact expectations of each step of an episode with a rule on the belief."""

    rewards: NDArray[np.float64]
    """Attention reward, shape (horizon,)."""
    information: NDArray[np.float64]
    """Information about d that a^H and v give to who knows the driver's traits [bits], shape
    (horizon,)."""

    @property
    def total_return(self) -> float:
        """Attention return of an episode that runs its whole time."""
        return float(self.rewards.sum())

    @property
    def bits(self) -> float:
        """Information in each step after the first [bits]."""
        return float(self.information[1:].mean()) if len(self.information) > 1 else 0.0

    def return_after(self, steps: ArrayLike) -> NDArray[np.float64]:
        """Attention return of the first ``steps`` steps, of any shape.

        See :mod:`hmi_marl.exact.episode_lengths` for the lengths of episodes that crashes ended.

        Raises:
            ValueError: not whole numbers from 0 to the horizon.
        """
        return sum_first(self.rewards, steps)


class _Paths(NamedTuple):
    """Paths from P last revelations of d, or from the start, on which d was not revealed again.

    Arrays have shape (P,). On a path nothing that the rule sees is random.
    """

    mass: NDArray[np.float64]
    """Probability of the path."""
    assumed: NDArray[np.float64]
    """Belief of the rule."""
    true: NDArray[np.float64]
    """p(d = 1) of the driver."""
    accepted: NDArray[np.int64]
    counter: NDArray[np.int64]

    def after(
        self, rule: BeliefSolution, t: int, reveals: bool, driver: Driver, weights: RewardWeights
    ) -> _Consequence:
        """Consequences of the rule's alerts in step t, which reveals d or does not."""
        here = np.full(self.mass.shape, t), np.full(self.mass.shape, reveals)
        alert = rule.alert(*here, self.assumed, self.accepted, self.counter)
        known = self.true, self.accepted, self.counter
        return _Consequence.of(alert, *known, driver, rule.window, weights)

    @classmethod
    def from_revelation(cls, mass: NDArray[np.float64], now: _Consequence, window: int) -> _Paths:
        """Begin a path in each (d, i, c) that a step with these consequences may reveal."""
        places = now.accepted * window + now.counter
        parts = [
            np.bincount(places, mass * p, minlength=2 * window)
            for p in (1.0 - now.distracted, now.distracted)
        ]
        d, i, c = (each.ravel() for each in np.indices((2, 2, window)))
        return cls(np.concatenate(parts), d.astype(np.float64), d.astype(np.float64), i, c)

    def join(self, others: _Paths) -> _Paths:
        """Put two sets of paths together, without those that are impossible."""
        mass, *rest = (np.concatenate(pair) for pair in zip(self, others, strict=True))
        return _Paths(mass[mass > 0], *(each[mass > 0] for each in rest))


def follow_rule(rule: BeliefSolution, driver: str | Driver, weights: RewardWeights) -> RuleOutcome:
    """Exact outcome of a rule with any driver, also another than the rule assumes.

    Between two steps that reveal d the rule sees nothing random, so that its belief, its alerts, i
    and c follow one path from each step and (d, i, c) in which d was revealed, and so does p(d) of
    the driver. All paths are followed side by side, each with its probability. All steps but the
    first reveal d with the share that the rule assumes.

    Args:
        rule: of :func:`solve_belief`.
        driver, weights: of the episode.
    """
    driver = get_driver(driver)
    rewards, information = np.zeros((2, rule.horizon))
    nothing, none = np.zeros(1), np.zeros(1, np.int64)
    paths = _Paths(np.ones(1), nothing, nothing, none, none)
    for t in range(rule.horizon):
        share = rule.revealing if t > 0 else 0.0
        silent, revealed = (paths.after(rule, t, m, driver, weights) for m in (False, True))
        rewards[t] = paths.mass @ ((1.0 - share) * silent.reward + share * revealed.reward)
        information[t] = share * (paths.mass @ entropy(revealed.distracted))
        assumed = predict(paths.assumed, silent.accepted, rule.driver)
        state = silent.distracted, silent.accepted, silent.counter
        paths = _Paths((1.0 - share) * paths.mass, assumed, *state).join(
            _Paths.from_revelation(share * paths.mass, revealed, rule.window)
        )
    return RuleOutcome(rewards, information)


def rule_return(rule: BeliefSolution, driver: str | Driver, weights: RewardWeights) -> float:
    """Exact attention return of a rule with any driver; see :func:`follow_rule`."""
    return follow_rule(rule, driver, weights).total_return


def filter_outcomes(
    drivers: Sequence[str | Driver],
    shares: Sequence[float],
    window: int,
    horizon: int,
    weights: RewardWeights,
    sequential: bool = True,
) -> dict[str, list[RuleOutcome]]:
    """Exact outcomes of the Bayes filter that knows the driver, by the share of revealing steps.

    Returns:
        For each driver's name an outcome for each share. Both the return and the information grow
        with the share.

    Raises:
        ValueError, TypeError: as :func:`solve_belief`.
    """
    known = [get_driver(driver) for driver in drivers]
    return {
        driver.name: [
            follow_rule(
                solve_belief(driver, window, horizon, weights, share, sequential), driver, weights
            )
            for share in shares
        ]
        for driver in known
    }
