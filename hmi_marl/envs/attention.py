r"""The distraction model: the (d, i, c) chain of the paper, over N teams at once.

In one step, given the alert a^A_t, first the counter c and the acceptance i are updated (the
paper's three relations for i_t and c_t), then the distraction d is drawn:

.. math::
    p(d_t = 1 | d_{t-1} = 0) = \max(0, \beta - \eta 1(i_t = 1)) \\
    p(d_t = 0 | d_{t-1} = 1) = \min(1, \alpha + \eta 1(i_t = 1))

Where alerts have several strengths, or cause fatigue, i is the number of the alert in effect, a
fourth number f the level of fatigue, and η 1(i_t = 1) becomes the η_t of
:mod:`hmi_marl.envs.alerts`; f is updated last.

All functions are pure, element by element, and know nothing of roads or agents. The compiled loops
over teams run the same functions; see :mod:`hmi_marl.envs.elementwise`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hmi_marl.checks import Whole
from hmi_marl.envs.alerts import PLAIN, Alerts, Effects, help_share, next_level
from hmi_marl.envs.drivers import Driver, Traits
from hmi_marl.envs.elementwise import choose, elementwise


@dataclass(frozen=True)
class Attention:
    """The state of N drivers' attention. Each field is an int64 array of shape (N,)."""

    distracted: NDArray[np.int64]
    """d: 1 when distracted."""
    accepted: NDArray[np.int64]
    """i: 1 while an accepted alert is in effect; of several strengths, which of them, 1 .. k."""
    counter: NDArray[np.int64]
    """c: steps since that alert, 0 .. window - 1."""
    fatigue: NDArray[np.int64]
    """f: level of fatigue from alerts; stays 0 without fatigue."""

    @classmethod
    def initial(cls, num_teams: int) -> Attention:
        """d_0 = i_0 = c_0 = f_0 = 0."""
        return cls(*(np.zeros(num_teams, np.int64) for _ in range(4)))


WINDOW = Whole(1, 10_000, "steps")
"""Range of N, the intervention window."""


def check_window(window: int) -> int:
    """Return N, the intervention window in steps, or raise if it is out of range."""
    return WINDOW("alert_window", window)


@elementwise
def next_acceptance(
    accepted: Any, counter: Any, alert: Any, window: Any
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """i_t and c_t from i_{t-1}, c_{t-1} and a^A_t (the paper's three relations).

    An alert is always accepted and restarts the window; without one, an acceptance lasts until
    c_{t-1} = N - 1. Of several strengths a weaker alert does not undo a stronger one: that goes on
    until its own window is over.

    Args:
        accepted, counter, alert: integers, broadcast against each other. i and a^A are 0 or 1, or
            which of several strengths.
        window: N, in steps.

    Returns:
        (i_t, c_t), int64 arrays of the broadcast shape.
    """
    goes_on = (accepted > alert) & (counter < window - 1)
    return choose(goes_on, accepted, alert), choose(goes_on, counter + 1, 0)


@elementwise
def distraction_probability(
    distracted: Any, helped: Any, beta: Any, alpha: Any, eta: Any
) -> NDArray[np.float64]:
    """p(d_t = 1 | d_{t-1}, i_t), the paper's two equations for d.

    Args:
        distracted: d_{t-1}.
        helped: the share of η that helps, in [0, 1]: with the paper's alerts i_t, after its
            update; with others see :meth:`Alerts.help`.
        beta, alpha, eta: traits. All five are broadcast against each other.
    """
    help_given = eta * helped
    becomes_distracted = np.maximum(0.0, beta - help_given)
    becomes_attentive = np.minimum(1.0, alpha + help_given)
    return choose(distracted == 1, 1.0 - becomes_attentive, becomes_distracted)


def next_attention(
    distracted: Any,
    accepted: Any,
    counter: Any,
    fatigue: Any,
    alert: Any,
    beta: Any,
    alpha: Any,
    eta: Any,
    draw: Any,
    window: int,
    effects: Effects,
) -> tuple[Any, Any, Any, Any]:
    """(d_t, i_t, c_t, f_t) from those of step t - 1 and a^A_t: c, then i, then d, then f.

    ``draw`` is uniform in [0, 1); d_t = 1 where it is below its probability.
    """
    next_accepted, next_counter = next_acceptance(accepted, counter, alert, window)
    helped = help_share(effects, next_accepted, fatigue)
    probability = distraction_probability(distracted, helped, beta, alpha, eta)
    next_distracted = choose(draw < probability, 1, 0)
    return next_distracted, next_accepted, next_counter, next_level(effects, fatigue, alert)


def step(
    attention: Attention,
    alert: NDArray[np.int64],
    traits: Traits,
    window: int,
    draws: NDArray[np.float64],
    alerts: Alerts = PLAIN,
) -> Attention:
    """One step of the chain for N teams: c, then i, then d, then f.

    Args:
        attention: (d, i, c, f) after step t - 1.
        alert: a^A_t, shape (N,).
        traits: of the N drivers.
        window: N, in steps.
        draws: uniform in [0, 1), shape (N,); d_t = 1 where the draw is below its probability.
        alerts: what a^A means.
    """
    after = next_attention(
        attention.distracted,
        attention.accepted,
        attention.counter,
        attention.fatigue,
        alert,
        traits.beta,
        traits.alpha,
        traits.eta,
        draws,
        window,
        alerts.effects,
    )
    return Attention(*after)


class Successors(NamedTuple):
    """Successors of every [a, d, i, c]: i and c for sure, d by chance. Shapes (2, 2, 2, N).

    With k strengths (k + 1, 2, k + 1, N), and with fatigue another axis f of F + 1 levels.
    """

    accepted: NDArray[np.int64]
    """i_t."""
    counter: NDArray[np.int64]
    """c_t."""
    distracted: NDArray[np.float64]
    """p(d_t = 1)."""
    fatigue: NDArray[np.int64]
    """f_t, 0 without fatigue."""


def successors(driver: Driver, window: int, alerts: Alerts = PLAIN) -> Successors:
    """The chain's transitions in the form that dynamic programming needs, O(N) in all."""
    states = alerts.shape(check_window(window))
    alert, distracted, accepted, counter, *levels = np.indices((alerts.choices, *states))
    fatigue = levels[0] if levels else np.zeros_like(counter)
    next_i, next_c = next_acceptance(accepted, counter, alert, window)
    p_distracted = distraction_probability(
        distracted, alerts.help(next_i, fatigue), driver.beta, driver.alpha, driver.eta
    )
    return Successors(next_i, next_c, p_distracted, alerts.next_fatigue(fatigue, alert))


def transition_matrix(driver: Driver, window: int) -> NDArray[np.float64]:
    """P[a, d, i, c, d', i', c']: the chain's transition probabilities, for inspection.

    Float64 of shape (2, 2, 2, N, 2, 2, N) with N = ``window``; the last three axes sum to 1. Its
    size is O(N²); :func:`successors` gives the same in O(N).
    """
    after = successors(driver, window)
    matrix = np.zeros((2, 2, 2, window, 2, 2, window))
    now = tuple(np.indices((2, 2, 2, window)))
    matrix[*now, 1, after.accepted, after.counter] = after.distracted
    matrix[*now, 0, after.accepted, after.counter] = 1.0 - after.distracted
    return matrix
