r"""The distraction model: the (d, i, c) chain of the paper, over N teams at once.

In one step, given the alert a^A_t, first the counter c and the acceptance i are updated (the
paper's three relations for i_t and c_t), then the distraction d is drawn:

.. math::
    p(d_t = 1 | d_{t-1} = 0) = \max(0, \beta - \eta 1(i_t = 1)) \\
    p(d_t = 0 | d_{t-1} = 1) = \min(1, \alpha + \eta 1(i_t = 1))

All functions are pure, element by element, and know nothing of roads or agents.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hmi_marl.envs.drivers import Driver, Traits


@dataclass(frozen=True)
class Attention:
    """Where N drivers' attention stands. Each field is an int64 array of shape (N,)."""

    distracted: NDArray[np.int64]
    """d: 1 when distracted."""
    accepted: NDArray[np.int64]
    """i: 1 while an accepted alert is in effect."""
    counter: NDArray[np.int64]
    """c: steps since that alert, 0 .. window - 1."""

    @classmethod
    def initial(cls, num_teams: int) -> Attention:
        """d_0 = i_0 = c_0 = 0."""
        return cls(*(np.zeros(num_teams, np.int64) for _ in range(3)))

    def where(self, mask: NDArray[np.bool_], other: Attention) -> Attention:
        """This where ``mask`` (shape (N,)) holds, ``other`` elsewhere."""
        return Attention(
            np.where(mask, self.distracted, other.distracted),
            np.where(mask, self.accepted, other.accepted),
            np.where(mask, self.counter, other.counter),
        )


def check_window(window: int) -> int:
    """Return N, the intervention window in steps, or raise if it is not a positive integer."""
    if isinstance(window, bool) or not isinstance(window, (int, np.integer)):
        raise TypeError(f"alert_window is a whole number of steps, not {window!r}")
    if window < 1:
        raise ValueError(f"alert_window is at least 1 step, but got {window}")
    return int(window)


def next_acceptance(
    accepted: ArrayLike, counter: ArrayLike, alert: ArrayLike, window: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """i_t and c_t from i_{t-1}, c_{t-1} and a^A_t (the paper's three relations).

    An alert is always accepted and restarts the window; without one, an acceptance lasts until
    c_{t-1} = N - 1.

    Args:
        accepted, counter, alert: integers, broadcast against each other.
        window: N, in steps.

    Returns:
        (i_t, c_t), int64 arrays of the broadcast shape.
    """
    accepted, counter, alert = np.broadcast_arrays(accepted, counter, alert)
    continues = (accepted == 1) & (alert == 0)
    next_accepted = np.where(continues, counter < window - 1, alert == 1).astype(np.int64)
    next_counter = np.where(continues, (counter + 1) % window, 0).astype(np.int64)
    return next_accepted, next_counter


def distraction_probability(
    distracted: ArrayLike, accepted: ArrayLike, beta: ArrayLike, alpha: ArrayLike, eta: ArrayLike
) -> NDArray[np.float64]:
    """p(d_t = 1 | d_{t-1}, i_t), the paper's two equations for d.

    Args:
        distracted: d_{t-1}.
        accepted: i_t, after its update.
        beta, alpha, eta: traits. All five are broadcast against each other.
    """
    help_given = np.asarray(eta) * (np.asarray(accepted) == 1)
    becomes_distracted = np.maximum(0.0, np.asarray(beta) - help_given)
    becomes_attentive = np.minimum(1.0, np.asarray(alpha) + help_given)
    return np.where(np.asarray(distracted) == 1, 1.0 - becomes_attentive, becomes_distracted)


def step(
    attention: Attention,
    alert: NDArray[np.int64],
    traits: Traits,
    window: int,
    draws: NDArray[np.float64],
) -> Attention:
    """One step of the chain for N teams: c, then i, then d.

    Args:
        attention: (d, i, c) after step t - 1.
        alert: a^A_t, shape (N,).
        traits: of the N drivers.
        window: N, in steps.
        draws: uniform in [0, 1), shape (N,); d_t = 1 where the draw is below its probability.
    """
    accepted, counter = next_acceptance(attention.accepted, attention.counter, alert, window)
    probability = distraction_probability(
        attention.distracted, accepted, traits.beta, traits.alpha, traits.eta
    )
    return Attention((draws < probability).astype(np.int64), accepted, counter)


class Successors(NamedTuple):
    """Where every [a, d, i, c] leads: i and c for sure, d by chance. Shapes (2, 2, 2, N)."""

    accepted: NDArray[np.int64]
    """i_t."""
    counter: NDArray[np.int64]
    """c_t."""
    distracted: NDArray[np.float64]
    """p(d_t = 1)."""


def successors(driver: Driver, window: int) -> Successors:
    """The chain's transitions in the form that dynamic programming needs, O(N) in all."""
    alert, distracted, accepted, counter = np.indices((2, 2, 2, check_window(window)))
    next_i, next_c = next_acceptance(accepted, counter, alert, window)
    p_distracted = distraction_probability(
        distracted, next_i, driver.beta, driver.alpha, driver.eta
    )
    return Successors(next_i, next_c, p_distracted)


def transition_matrix(driver: Driver, window: int) -> NDArray[np.float64]:
    """P[a, d, i, c, d', i', c']: the chain's transition probabilities, for inspection.

    It is O(N²) large; :func:`successors` says the same in O(N).

    Args:
        driver: whose traits.
        window: N, in steps.

    Returns:
        float64 array of shape (2, 2, 2, N, 2, 2, N); the last three axes sum to 1.
    """
    after = successors(driver, window)
    matrix = np.zeros((2, 2, 2, window, 2, 2, window))
    now = tuple(np.indices((2, 2, 2, window)))
    matrix[*now, 1, after.accepted, after.counter] = after.distracted
    matrix[*now, 0, after.accepted, after.counter] = 1.0 - after.distracted
    return matrix
