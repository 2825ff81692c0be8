r"""Who is at the wheel, step by step through a trip and from trip to trip.

With p the belief before a step and g_k the step's evidence for candidate k,

.. math::
    p'_k \propto \big( (1 - h) p_k + h\, p^0_k \big) \exp g_k

where p^0 is the prior, and h the probability that somebody else has taken the wheel since the last
step. So a belief never becomes so certain that a change of driver could not be seen. With exact
evidence and h = 0 it is the exact posterior. With h > 0 it is close to it: what is told about a new
driver's d, i and c is what it would be if they had driven all along, for a window or so.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.observations import vehicle_ai_layout
from hmi_marl.exact.bayes_filter import posterior
from hmi_marl.exact.evidence import Evidence
from hmi_marl.exact.trait_posterior import TraitBelief

CHANGE_RATE = 1 / 2000
"""By default a change of driver is expected once in 2000 steps, 400 s at 5 Hz."""


class TraitEstimator:
    """Keeps a belief about each team's driver from what the vehicle AI observes.

    Args:
        evidence: exact or learned.
        config: of the teams.
        prior: how frequent the candidates are, up to a factor, shape (K,); evenly by default.
        change_rate: h, the probability per step that another driver takes over unannounced; 0 if
            that cannot happen.

    Raises:
        ValueError: numbers that are no prior, or a rate outside [0, 1].
    """

    def __init__(
        self,
        evidence: Evidence,
        config: TeamConfig,
        prior: ArrayLike | None = None,
        change_rate: float = CHANGE_RATE,
    ) -> None:
        if not 0.0 <= change_rate <= 1.0:
            raise ValueError(f"change_rate lies in [0, 1], but got {change_rate}")
        self.evidence = evidence
        self.change_rate = float(change_rate)
        self.prior = posterior(np.zeros((1, len(evidence.drivers))), prior)[0]
        """Belief about a driver of whom nothing was seen, shape (K,)."""
        self._layout = vehicle_ai_layout(config)
        self._horizon = config.horizon
        self.reset(1)

    @property
    def belief(self) -> TraitBelief:
        """What is believed now."""
        return TraitBelief(self.evidence.drivers, self._probabilities)

    def reset(self, count: int, which: NDArray[np.bool_] | None = None) -> None:
        """Unknown drivers get in and begin a trip.

        Args:
            count: N.
            which: the teams in which they do, shape (N,); all by default, when N may change.
        """
        if which is None:
            self._probabilities = np.tile(self.prior, (count, 1))
            self._seen = np.full(count, -1)  # the step observed last
            self.evidence.reset(count)
            return
        self._probabilities = np.where(which[:, None], self.prior, self._probabilities)
        self.next_trip(which)

    def next_trip(self, which: NDArray[np.bool_] | None = None) -> None:
        """The same drivers begin another trip: what is believed of them stays.

        Args:
            which: the teams in which they do, shape (N,); all by default.
        """
        fresh = np.ones(len(self._seen), np.bool_) if which is None else which
        self._seen = np.where(fresh, -1, self._seen)
        self.evidence.begin(fresh)

    def observe(self, observations: NDArray[np.float32]) -> TraitBelief:
        """Take in what the vehicle AI sees in its turn, shape (N, D); returns the belief.

        A turn that was observed already changes nothing, so that teams whose trip is over may go
        on being shown.

        Raises:
            RuntimeError: observations of another number of teams than was told to :meth:`reset`.
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
    """Bayes' rule in every row; where no candidate is possible, the belief stays as it was.

    That is so where the driver is none of the candidates, but one between them.
    """
    with np.errstate(divide="ignore"):
        joint = np.log(before) + gains
    most = joint.max(axis=1, keepdims=True)
    odds = np.exp(joint - np.where(np.isfinite(most), most, 0.0))
    total = odds.sum(axis=1, keepdims=True)
    return np.where(total > 0, odds / np.where(total > 0, total, 1.0), before)
