r"""The exact Bayes filter of the driver and of d, step by step.

Observed are the applied actions v_t and the alerts a^A_t. i and c follow from the alerts, so that
only d is hidden. If candidate k drives, with policy π_k on what k perceives, o^k_t, a window
(one episode) is a hidden Markov chain from d_{-1} = 0 in which

.. math::
    p_k(v_t | d_t = 1) = 1(v_t = v_{t-1}), \quad p_k(v_t | d_t = 0) = \pi_k(v_t | o^k_t)

but for v_0 = a^H_0, which comes from π_k whatever d_0. With b = p_k(d_{t-1} = 1 | v_{<t}), the
prediction b' and the evidence of one step are

.. math::
    b' = b\, p_k(d_t = 1 | d_{t-1} = 1, i_t) + (1 - b)\, p_k(d_t = 1 | d_{t-1} = 0, i_t) \\
    p_k(v_t | v_{<t}) = b' p_k(v_t | d_t = 1) + (1 - b') p_k(v_t | d_t = 0)

and the log evidence of k is the sum of its logarithms, over all windows of one driver.

It is assumed that alerts do not depend on what is hidden: a^A_t depends on v_{<t}, s_t and chance.
That holds for random alerts, and not for an HMI that saw d_{t-1} or a^H_t: its alerts are evidence
too, which is not counted here.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hmi_marl.checks import COUNT
from hmi_marl.envs.attention import check_window, distraction_probability, next_acceptance
from hmi_marl.envs.drivers import Driver, Traits, get_driver
from hmi_marl.envs.elementwise import choose
from hmi_marl.envs.team_checks import check_mask
from hmi_marl.envs.team_step import NO_ACTION
from hmi_marl.envs.worlds import VEHICLE_ACTIONS

_ROUNDING = 1e-6


class BayesFilter:
    """Evidence for each of K candidates as the driver of each of N teams.

    Args:
        drivers: the K candidates.
        window: the alert window, in steps.
        count: N.

    Raises:
        ValueError, TypeError: no candidates, fewer than one team, or an invalid driver or window.
    """

    def __init__(self, drivers: Sequence[str | Driver], window: int, count: int) -> None:
        count = COUNT("count", count)
        self.drivers = check_candidates(drivers)
        self.window = check_window(window)
        self.log_evidence = np.zeros((count, len(self.drivers)))
        """log p_k of all v seen so far, in this window and before; shape (N, K), -inf where k
        is impossible."""
        self.distracted = np.zeros((count, len(self.drivers)))
        """p_k(d_t = 1 | v up to now), if k drives; shape (N, K)."""
        self._attentive = np.ones((count, len(self.drivers)))  # 1 - distracted, to its last digits
        self._traits = Traits.of(self.drivers)
        self.accepted, self.counter = np.zeros((2, count), np.int64)
        """i_t and c_t, which follow from the alerts; shape (N,) each."""
        self._applied = np.full(count, NO_ACTION)

    def begin(self, which: NDArray[np.bool_] | None = None) -> None:
        """Begin a new window of the same drivers: d, i, c and v begin anew, the evidence stays.

        ``which`` marks the teams that begin one, bool, shape (N,); all by default.

        Raises:
            ValueError: a mask of another shape or type.
        """
        fresh = check_mask(which, len(self._applied))
        self.accepted = np.where(fresh, 0, self.accepted)
        self.counter = np.where(fresh, 0, self.counter)
        self._applied = np.where(fresh, NO_ACTION, self._applied)
        self.distracted = np.where(fresh[:, None], 0.0, self.distracted)
        self._attentive = np.where(fresh[:, None], 1.0, self._attentive)

    def forget(self, which: NDArray[np.bool_]) -> None:
        """Begin a window of other drivers where ``which``, bool, shape (N,), is set.

        Raises:
            ValueError: a mask of another shape or type.
        """
        self.begin(which)
        self.log_evidence = np.where(which[:, None], 0.0, self.log_evidence)

    def update(
        self,
        intent_probabilities: NDArray[np.float64],
        applied: ArrayLike,
        alerts: ArrayLike,
        active: NDArray[np.bool_] | None = None,
    ) -> NDArray[np.float64]:
        """Update with one step.

        If the step is impossible for a candidate, d follows from the step alone: 1 where v was
        kept, else 0. So the filter of a wrong driver still follows d.

        Args:
            intent_probabilities: π_k(a^H_t | o^k_t), shape (K, N, 5).
            applied: v_t, integers 0 to 4, shape (N,).
            alerts: a^A_t, integers 0 or 1, shape (N,).
            active: the teams that took a step, bool, shape (N,); all by default. The others are
                not read and stay as they are.

        Returns:
            log p_k(v_t | v_{<t}), the step's part of ``log_evidence``; shape (N, K), 0 for teams
            that took none.

        Raises:
            ValueError: arrays that do not fit, or numbers out of their range. Nothing has changed
                then.
        """
        acts = check_mask(active, len(self._applied))
        shape = (*self.log_evidence.T.shape, len(VEHICLE_ACTIONS))
        if np.shape(intent_probabilities) != shape:
            raise ValueError(
                f"intent_probabilities have shape (K, N, 5) = {shape}, not "
                f"{np.shape(intent_probabilities)}"
            )
        applied = check_whole("applied actions", applied, len(VEHICLE_ACTIONS), acts)
        alerts = check_whole("alerts", alerts, 2, acts)
        chosen = intent_probabilities[:, np.arange(len(acts)), applied].T  # π_k(v_t), (N, K)
        if not ((chosen[acts] >= 0) & (chosen[acts] <= 1 + _ROUNDING)).all():
            raise ValueError("the probability of an intent lies in [0, 1]")
        accepted, counter = next_acceptance(self.accepted, self.counter, alerts, self.window)
        predicted, attentive = predict(
            self.distracted, self._attentive, accepted[:, None], self._traits
        )
        is_first = (self._applied == NO_ACTION)[:, None]
        is_kept = (self._applied == applied)[:, None].astype(np.float64)
        with_distracted, with_attentive = weigh(predicted, attentive, is_first, is_kept, chosen)
        evidence = with_distracted + with_attentive
        possible = evidence > 0
        gain = np.log(evidence, out=np.full(evidence.shape, -np.inf), where=possible)
        safe = np.where(possible, evidence, 1.0)
        belief = np.where(possible, with_distracted / safe, is_kept)
        doubt = np.where(possible, with_attentive / safe, 1.0 - is_kept)
        self.log_evidence = np.where(acts[:, None], self.log_evidence + gain, self.log_evidence)
        self.distracted = np.where(acts[:, None], belief, self.distracted)
        self._attentive = np.where(acts[:, None], doubt, self._attentive)
        self.accepted = np.where(acts, accepted, self.accepted)
        self.counter = np.where(acts, counter, self.counter)
        self._applied = np.where(acts, applied, self._applied)
        return np.where(acts[:, None], gain, 0.0)

    def posterior(self, prior: ArrayLike | None = None) -> NDArray[np.float64]:
        """p(k | all v seen so far), shape (N, K); see :func:`posterior`."""
        return posterior(self.log_evidence, prior)


def predict(
    distracted: NDArray[np.float64],
    attentive: NDArray[np.float64],
    helped: ArrayLike,
    traits: Driver | Traits,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """p(d_t = 1) and p(d_t = 0) before v_t is seen, from p(d_{t-1}). Shapes broadcast.

    Args:
        distracted, attentive: p(d_{t-1} = 1) and p(d_{t-1} = 0), which sum to 1. Each is given, so
            that both stay exact to their last digits.
        helped: share of η that helps: i_t with the paper's alerts, else see :meth:`Alerts.help`.
        traits: of the drivers; with :class:`Traits` of shape (K,), on the last axis.
    """
    return follow_chain(distracted, attentive, helped, traits.beta, traits.alpha, traits.eta)


def follow_chain(
    distracted: Any, attentive: Any, helped: Any, beta: Any, alpha: Any, eta: Any
) -> tuple[Any, Any]:
    """Compute the same from single traits; also compiled, for one number after the other."""
    becomes = distraction_probability(0, helped, beta, alpha, eta)
    stays = distraction_probability(1, helped, beta, alpha, eta)
    now_distracted = distracted * stays + attentive * becomes
    return now_distracted, distracted * (1.0 - stays) + attentive * (1.0 - becomes)


def weigh(
    predicted: Any, attentive: Any, is_first: Any, is_kept: Any, chosen: Any
) -> tuple[Any, Any]:
    """p(v_t, d_t = 1) and p(v_t, d_t = 0); also compiled, for one number after the other.

    Args:
        predicted, attentive: p(d_t = 1) and p(d_t = 0) before v_t is seen.
        is_first: whether t = 0, where v_0 = a^H_0 whatever d_0.
        is_kept: 1 if v_t = v_{t-1}, else 0.
        chosen: π(v_t).
    """
    return predicted * choose(is_first, chosen, is_kept), attentive * chosen


def posterior(
    log_evidence: NDArray[np.float64], prior: ArrayLike | None = None
) -> NDArray[np.float64]:
    """p(k | data) of K candidates, by Bayes' rule: prior times evidence, normalised.

    Args:
        log_evidence: log p(data | k), shape (N, K), -inf where k is impossible.
        prior: frequencies of the candidates, up to a factor, shape (K,) or (N, K); equal by
            default.

    Returns:
        Shape (N, K); the rows sum to 1.

    Raises:
        ValueError: numbers that are no prior, or a row in which every candidate of the prior is
            impossible: then the data or the policy are other ones than assumed.
    """
    shape = log_evidence.shape
    weights = np.ones(shape[1]) if prior is None else np.asarray(prior, np.float64)
    if weights.shape not in (shape[1:], shape):
        raise ValueError(f"a prior has shape {shape[1:]} or {shape}, not {weights.shape}")
    if not ((weights >= 0) & (weights < np.inf)).all() or (weights.sum(axis=-1) == 0).any():
        raise ValueError("a prior is of finite numbers >= 0, not all of them 0")
    log_prior = np.log(weights, out=np.full(weights.shape, -np.inf), where=weights > 0)
    joint = log_evidence + log_prior
    most = joint.max(axis=1, keepdims=True)
    if (most == -np.inf).any():
        raise ValueError(
            f"what was observed in row {np.argmin(most)} is impossible for every candidate: the "
            "data are not of these drivers, or their policy is another one"
        )
    odds = np.exp(joint - most)
    return odds / odds.sum(axis=1, keepdims=True)


def check_candidates(drivers: Sequence[str | Driver]) -> tuple[Driver, ...]:
    """Return the candidates, or raise if there are none or one is no driver."""
    if isinstance(drivers, (str, Driver)):
        raise TypeError(f"candidates are a list of drivers, not {drivers!r}")
    if not len(drivers):
        raise ValueError("there is at least one candidate, but got no drivers")
    return tuple(get_driver(driver) for driver in drivers)


def check_whole(
    name: str, values: ArrayLike, count: int, read: NDArray[np.bool_]
) -> NDArray[np.int64]:
    """Return integers from 0 to count - 1 where they are read, and 0 elsewhere; or raise."""
    given = np.asarray(values)
    if given.shape != read.shape or not np.issubdtype(given.dtype, np.integer):
        raise ValueError(
            f"{name} are integers of shape {read.shape}, but got {given.dtype} of shape "
            f"{given.shape}"
        )
    wrong = read & ((given < 0) | (given >= count))
    if wrong.any():
        raise ValueError(f"{name} lie in 0 to {count - 1}, but got {given[wrong][0]}")
    return np.where(read, given, 0).astype(np.int64)
