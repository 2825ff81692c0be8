r"""The likelihood of β, α and η where d is seen, and its maximum with some of them given.

The counts of :class:`~hmi_marl.people.measure.steps.ChainCounts` are four binomials. Both of the
paper's equations say of a state of d that the probability of d = 1 in the next step is p outside
windows and max(0, p - η) within them: p = β from d = 0, and p = 1 - α from d = 1. So with n steps
outside of which k are followed by d = 1, and n', k' within,

.. math::
    \log L(p, \eta) = k \log p + (n - k) \log(1 - p)
    + k' \log \max(0, p - \eta) + (n' - k') \log(1 - \max(0, p - \eta))

for either state, and the log likelihood is the sum of the two. It is concave in (β, α, η): the
third term is -∞ where max() is 0 if k' > 0, and the fourth is the smaller of 0 and a concave
function. So every profile is concave, every interval from it is connected, and a search by sections
finds the maximum, also at the edges where one of the equations saturates.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hmi_marl.people.measure.steps import ChainCounts

_Array = NDArray[np.float64]
_SECTIONS = 30
"""Golden sections of [0, 1], to 5e-7; the value found is then exact to about its square."""
_GOLDEN = (5**0.5 - 1) / 2


@dataclass(frozen=True, eq=False)
class State:
    """Counts of the steps from one value of d, arrays of one shape."""

    ones: _Array
    """k: followed by d = 1, outside windows."""
    steps: _Array
    """n."""
    helped_ones: _Array
    """k'."""
    helped_steps: _Array
    """n'."""

    def log_likelihood(self, p: ArrayLike, eta: ArrayLike) -> _Array:
        """Log likelihood of p and η, broadcast against the counts."""
        outside = np.asarray(p, np.float64)
        within = np.maximum(0.0, outside - np.asarray(eta, np.float64))
        return (
            _times_log(self.ones, outside)
            + _times_log(self.steps - self.ones, 1.0 - outside)
            + _times_log(self.helped_ones, within)
            + _times_log(self.helped_steps - self.helped_ones, 1.0 - within)
        )

    def best(self, eta: ArrayLike) -> tuple[_Array, _Array]:
        """Return the p that maximises the log likelihood with η given, and the maximum.

        Where p > η, the slope is a sum of four poles, at 0, η, 1 and 1 + η, with weights that are
        not negative. So it has three real roots, one between each two poles, and the maximum is at
        the middle one. Where p <= η, which is possible if k' = 0, it is at k / n, or at η.
        """
        given = np.asarray(eta, np.float64)
        above = np.clip(self._middle_root(given), given, 1.0)
        share = self.ones / np.maximum(self.steps, 1e-300)
        below = np.where(self.helped_ones > 0, above, np.minimum(share, given))
        at_above = self.log_likelihood(above, given)
        at_below = self.log_likelihood(below, given)
        return np.where(at_above >= at_below, above, below), np.maximum(at_above, at_below)

    def _middle_root(self, eta: _Array) -> _Array:
        """Middle root of the slope's numerator, a cubic polynomial in p, by Viète's formula."""
        a, b = self.ones, self.helped_ones
        c, d = self.steps - a, self.helped_steps - b
        total = np.maximum(a + b + c + d, 1e-300)
        square = -(a * (2 + 2 * eta) + b * (2 + eta) + c * (1 + 2 * eta) + d * (1 + eta)) / total
        linear = a * (1 + 3 * eta + eta**2) + b * (1 + eta) + c * eta * (1 + eta) + d * eta
        linear, constant = linear / total, -a * eta * (1 + eta) / total
        # With p = t - square / 3 it is t³ - 3 m² t + q, whose middle root follows from an angle.
        m = np.sqrt(np.maximum(square**2 / 9 - linear / 3, 1e-300))
        q = 2 * square**3 / 27 - square * linear / 3 + constant
        angle = np.arccos(np.clip(-q / np.maximum(2 * m**3, 1e-300), -1.0, 1.0)) / 3
        return 2 * m * np.cos(angle - 2 * np.pi / 3) - square / 3


@dataclass(frozen=True, eq=False)
class Likelihood:
    """Profiles of the log likelihood for some persons, whose counts have shape B."""

    attentive: State
    """From d = 0, where p = β."""
    away: State
    """From d = 1, where p = 1 - α."""

    @classmethod
    def of(cls, counts: ChainCounts) -> Likelihood:
        """Make it from counts."""
        return cls(
            State(
                counts.openings,
                counts.attentive,
                counts.helped_openings,
                counts.helped_attentive,
            ),
            State(
                counts.away - counts.closings,
                counts.away,
                counts.helped_away - counts.helped_closings,
                counts.helped_away,
            ),
        )

    def profile(self, trait: str, value: ArrayLike) -> _Array:
        """Largest log likelihood with one trait given.

        Args:
            trait: beta, alpha or eta.
            value: of that trait, broadcast against the counts.
        """
        given = np.asarray(value, np.float64)
        attentive, away = self.attentive, self.away
        if trait == "eta":
            return attentive.best(given)[1] + away.best(given)[1]

        def total(eta: _Array) -> _Array:
            if trait == "beta":
                return attentive.log_likelihood(given, eta) + away.best(eta)[1]
            return attentive.best(eta)[1] + away.log_likelihood(1.0 - given, eta)

        return _highest(total, np.broadcast_shapes(given.shape, attentive.steps.shape))[1]

    def maximum(self) -> tuple[_Array, _Array]:
        """Return an η of the highest log likelihood, and that; shapes B."""
        shape = self.attentive.steps.shape
        return _highest(lambda eta: self.profile("eta", eta), shape)

    def saturated(self) -> _Array:
        """Log likelihood with a probability of its own for each of the four counts, shape B."""
        total = np.zeros(self.attentive.steps.shape)
        for state in (self.attentive, self.away):
            for ones, steps in (
                (state.ones, state.steps),
                (state.helped_ones, state.helped_steps),
            ):
                share = ones / np.maximum(steps, 1.0)
                total = total + _times_log(ones, share) + _times_log(steps - ones, 1.0 - share)
        return total


def _highest(function: Callable[[_Array], _Array], shape: tuple[int, ...]) -> tuple[_Array, _Array]:
    """Place and value of the highest point in [0, 1] of concave functions, by golden sections.

    Where a function is -∞ at both places, it is lower further right.
    """
    low, high = np.zeros(shape), np.ones(shape)
    left, right = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
    at_left, at_right = function(left), function(right)
    for _ in range(_SECTIONS):
        goes_left = at_left >= at_right
        low, high = np.where(goes_left, low, left), np.where(goes_left, right, high)
        new = np.where(goes_left, high - _GOLDEN * (high - low), low + _GOLDEN * (high - low))
        at_new = function(new)
        left, right = np.where(goes_left, new, right), np.where(goes_left, left, new)
        at_left, at_right = (
            np.where(goes_left, at_new, at_right),
            np.where(goes_left, at_left, at_new),
        )
    places = np.stack([np.zeros(shape), (low + high) / 2, np.ones(shape)])
    values = function(places)
    which = values.argmax(axis=0)[None]
    place, value = (np.take_along_axis(each, which, 0)[0] for each in (places, values))
    return place, value


def _times_log(count: _Array, probability: _Array) -> _Array:
    """``count`` times the log of a probability: 0 for no steps, -∞ for some that cannot happen."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(count > 0, count * np.log(probability), 0.0)
