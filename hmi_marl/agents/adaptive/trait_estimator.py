r"""Estimate the driver's traits step by step, within a trip and from trip to trip.

With p the belief before a step and g_k the step's evidence for candidate k,

.. math::
    p'_k \propto \big( (1 - h) p_k + h\, p^0_k \big) \exp g_k

where p^0 is the prior, and h the probability that another driver has taken over since the last
step. So a belief never becomes so certain that a change of driver goes unnoticed. With exact
evidence and h = 0 it is the exact posterior. With h > 0 it is an approximation: for about a window
after a change the evidence assumes d, i and c as if the new driver had driven from the start.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hmi_marl.checks import SHARE
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.observations import vehicle_ai_layout
from hmi_marl.exact.bayes_filter import posterior
from hmi_marl.exact.evidence import Evidence
from hmi_marl.exact.identify import TraitBelief

CHANGE_RATE = 1 / 2000
"""Default rate of driver changes per step: one in 2000 steps, 400 s at 5 Hz."""


class TraitEstimator:
    """Keep a belief about each team's driver from the vehicle AI's observations.

    Args:
        evidence: exact or learned.
        config: configuration of the teams.
        prior: relative frequencies of the candidates, shape (K,); equal by default.
        change_rate: h, the probability per step that another driver takes over unannounced.

    Raises:
        ValueError: an invalid prior, or a rate outside [0, 1].
    """

    def __init__(
        self,
        evidence: Evidence,
        config: TeamConfig,
        prior: ArrayLike | None = None,
        change_rate: float = CHANGE_RATE,
    ) -> None:
        self.evidence = evidence
        self.change_rate = SHARE("change_rate", change_rate)
        self.prior = posterior(np.zeros((1, len(evidence.drivers))), prior)[0]
        """Belief before the first observation, shape (K,)."""
        self._layout = vehicle_ai_layout(config)
        self._horizon = config.horizon
        self.reset(1)

    @property
    def belief(self) -> TraitBelief:
        """Current belief."""
        return TraitBelief(self.evidence.drivers, self._probabilities.copy())

    def reset(self, count: int, which: NDArray[np.bool_] | None = None) -> None:
        """Begin a trip of unknown drivers.

        Args:
            count: N, which may change if ``which`` is None.
            which: the teams concerned, shape (N,); all by default.
        """
        if which is None:
            self._probabilities = np.tile(self.prior, (count, 1))
            self._seen = np.full(count, -1)  # the step observed last
        else:
            self._probabilities = np.where(which[:, None], self.prior, self._probabilities)
            self._seen = np.where(which, -1, self._seen)
        self.evidence.reset(count, which)

    def next_trip(self, which: NDArray[np.bool_] | None = None) -> None:
        """Begin another trip of the same drivers and keep the belief about them.

        Args:
            which: the teams concerned, shape (N,); all by default.
        """
        fresh = np.ones(len(self._seen), np.bool_) if which is None else which
        self._seen = np.where(fresh, -1, self._seen)
        self.evidence.begin(fresh)

    def observe(self, observations: NDArray[np.float32]) -> TraitBelief:
        """Update the belief with the vehicle AI's observations, shape (N, D), and return it.

        A turn that was observed already changes nothing, so observations may go on after the end
        of a team's trip.

        Raises:
            RuntimeError: observations of another number of teams than passed to :meth:`reset`.
            ValueError: observations of another width, or numbers that are not finite.
        """
        if len(observations) != len(self._seen):
            raise RuntimeError(
                f"this estimator follows {len(self._seen)} teams, but got observations of "
                f"{len(observations)}: call reset(count) when other teams begin"
            )
        if observations.shape[1:] != (self._layout.size,) or not np.isfinite(observations).all():
            raise ValueError(
                f"the vehicle AI's observations are finite numbers of shape (N, "
                f"{self._layout.size}), but got shape {observations.shape}"
            )
        step = np.rint(self._layout.scalar(observations, "time") * self._horizon).astype(np.int64)
        new = step > self._seen
        gains = self.evidence.observe(observations, new)
        self._seen = np.where(new, step, self._seen)
        rate = np.where(new, self.change_rate, 0.0)[:, None]
        before = (1.0 - rate) * self._probabilities + rate * self.prior
        self._probabilities = _updated(before, gains)
        return self.belief


def _updated(before: NDArray[np.float64], gains: NDArray[np.float64]) -> NDArray[np.float64]:
    """Apply Bayes' rule in every row; where no candidate is possible, keep the belief.

    No candidate may be possible if the driver is none of them.
    """
    with np.errstate(divide="ignore"):
        joint = np.log(before) + gains
    most = joint.max(axis=1, keepdims=True)
    odds = np.exp(joint - np.where(np.isfinite(most), most, 0.0))
    total = odds.sum(axis=1, keepdims=True)
    return np.where(total > 0, odds / np.where(total > 0, total, 1.0), before)
