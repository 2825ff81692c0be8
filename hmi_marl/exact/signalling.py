r"""Signals about attention that is hidden: what a^H_t and v_t tell the HMI about d_t, in bits.

A driver whose a^H_t differs from v_{t-1} reveals d_t: the car either follows (d_t = 0) or repeats
its last action (d_t = 1). A driver who learns together with an HMI can choose such an a^H_t on
purpose, and so signal.

With b'_t the probability of d_t = 1 given all before, own alerts included, and h the binary
entropy, the information that step t gives about d_t is

.. math::
    I_t = h(b'_t) - E[h(b_t)] = m_t h(b'_t), \quad h(p) = -p \log_2 p - (1 - p) \log_2 (1 - p)

with m_t = 1 in a revealing step, in which h falls to 0, else 0. The choice of a^H_t itself says
nothing about d_t: drivers do not observe d, so that a^H_t depends on what is before, which the HMI
knows or which is independent of d. Therefore the sum over an episode, in expectation, is the mutual
information of the whole sequence of d and all that was seen:

.. math::
    \sum_t E[I_t] = I(d_0 \dots d_T;\ m_0, v_0, \dots, m_T, v_T)

With sequential moves the HMI sees a^H_t, and so m_t, before its alert a^A_t, and v_t after it; with
simultaneous moves it sees both after a^A_t. In both cases it knows before a^A_{t+1} what step t
revealed, so that the information is the same.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hmi_marl.envs.drivers import Driver, Traits
from hmi_marl.envs.team_step import NO_ACTION
from hmi_marl.exact.bayes_filter import predict


def entropy(probability: NDArray[np.float64]) -> NDArray[np.float64]:
    """Binary entropy h(p) of each probability [bits], from 0 to 1."""
    p = np.clip(probability, 0.0, 1.0)  # sums may be off by rounding
    return surprise(p) * p + surprise(1.0 - p) * (1.0 - p)


def surprise(probability: NDArray[np.float64]) -> NDArray[np.float64]:
    """Log loss -log2 p of what had this probability [bits]; for p = 0 a large number."""
    least = np.finfo(np.float64).tiny
    return np.abs(np.log2(np.maximum(probability, least)))


def reveals(intended: NDArray[np.int64], last: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Whether a^H_t reveals d_t, since it differs from v_{t-1}; never in the first step."""
    return (last != NO_ACTION) & (intended != last)


class Signal(NamedTuple):
    """Exact beliefs about d_t of N teams, before and after a^H_t and v_t. Arrays of shape (N,)."""

    predicted: NDArray[np.float64]
    """b'_t = p(d_t = 1) from all before, own alerts included."""
    reveals: NDArray[np.bool_]
    """Whether a^H_t reveals d_t."""
    belief: NDArray[np.float64]
    """b_t = p(d_t = 1) when a^H_t and v_t have been seen."""

    @property
    def entropy(self) -> NDArray[np.float64]:
        """h(b'_t) [bits]."""
        return entropy(self.predicted)

    @property
    def information(self) -> NDArray[np.float64]:
        """Information about d_t in a^H_t and v_t [bits]: h(b'_t) in a revealing step, else 0."""
        return np.where(self.reveals, self.entropy, 0.0)

    def log_loss(self, distracted: NDArray[np.int64]) -> NDArray[np.float64]:
        """-log2 of the belief in the true d_t when a^H_t and v_t have been seen [bits].

        Its expectation is the entropy that is left, :attr:`entropy` - :attr:`information`.
        """
        return surprise(np.where(distracted == 1, self.belief, 1.0 - self.belief))


def read_signal(
    belief: NDArray[np.float64],
    helped: NDArray[np.floating] | NDArray[np.integer],
    traits: Driver | Traits,
    last: NDArray[np.int64],
    intended: NDArray[np.int64],
    applied: NDArray[np.int64],
) -> Signal:
    """Update the exact belief about d with a^H_t and v_t. Arrays have shape (N,).

    Args:
        belief: b_{t-1}; 0 before the first step.
        helped: share of η that helps in step t: i_t with the paper's alerts, else see
            :meth:`Alerts.help`.
        traits: of the N drivers, or of the driver of all.
        last: v_{t-1}, -1 before the first.
        intended: a^H_t.
        applied: v_t.
    """
    predicted, _ = predict(belief, 1.0 - belief, helped, traits)
    shown = reveals(intended, last)
    return Signal(predicted, shown, np.where(shown, applied == last, predicted))
