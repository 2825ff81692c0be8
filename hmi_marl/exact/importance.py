r"""Adaptive importance sampling in the unit cube, for posteriors of few dimensions.

The prior is uniform in the cube (0, 1)^D; other priors are densities with respect to it. Points are
fitted in :math:`y = \log u - \log(1 - u)`, which is unbounded. The first round draws from the
prior, each later one from a mixture of Student's t distributions around the weighted points so far
(West, 1993). While few points count, their weights are tempered for the fit, and rounds are small:
they search. All points of all rounds are weighted by the mixture of all proposals (the balance
heuristic of Veach & Guibas, 1995; Cornuet et al., 2012),

.. math::
    w(y) = L(u)\, p(y) / \sum_r \frac{n_r}{n} q_r(y)

with n_r of n points drawn from q_r, so that the prior, q_0, keeps every weight below n L / n_0: no
region is lost because a fit missed it. The mean weight is the evidence. Of a fit that has a centre
at y itself, q_r(y) leaves out that centre and those of the point's group: a density is always high
at its own centres, which would make the evidence too small, by 13 % with the numbers of points that
are the default, and the posterior too narrow.

Points come in groups that share their first coordinate, where evaluating L for a new value of it
is expensive.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from hmi_marl.checks import Checked, Count, Whole
from hmi_marl.envs.streams import Stream, check_seed, mix

_FREEDOM = 6
"""Degrees of freedom of the proposals."""
_FITTED = 25.0
"""Least effective number of groups that a proposal is fitted to."""
_ROUGHNESS = 0.01
"""Least standard deviation of a fit, as a share of that of the prior, so that none is singular."""
_EDGE = 2.0**-53
_PRIOR_DEVIATION = math.pi / math.sqrt(3)
"""Standard deviation of y in the prior, a logistic distribution."""


@dataclass(frozen=True)
class Sampling(Checked):
    """Numbers of points and rounds.

    Raises:
        ValueError, TypeError: a number out of its range.
    """

    groups: Annotated[int, Whole(8, 100_000)] = 128
    """Groups of points in each round. In a round that searches a group is one point."""
    shared: Annotated[int, Whole(1, 1000)] = 2
    """Points in each group, which share their first coordinate (inflation)."""
    rounds: Annotated[int, Whole(1, 1000)] = 2
    """Rounds at least, besides those that search."""
    most_rounds: Annotated[int, Whole(1, 1000)] = 15
    """Rounds at most, those that search included, while the effective sample size is too small."""
    effective: Count = 100
    """Effective sample size that is enough."""

    def _named(self, field: str) -> str:
        return f"Sampling: {field}"


class ImportanceSample:
    """Weighted points in the unit cube, round by round: :meth:`propose`, then :meth:`weigh`.

    Args:
        dimensions: D.
        sampling: numbers of points.
        seed: of all draws.
    """

    def __init__(self, dimensions: int, sampling: Sampling, seed: int) -> None:
        self._dimensions, self._sampling, self._seed = dimensions, sampling, check_seed(seed)
        self._points = np.zeros((0, dimensions))
        """y of all points so far, shape (n, D)."""
        self._group = np.zeros(0, np.int64)
        """Group of each, shape (n,)."""
        self._log_target = np.zeros(0)
        self._log_proposal = np.zeros(0)
        """log of the sum of all n_r q_r, shape (n,)."""
        self._fits: list[tuple[float, _Mixture]] = []
        """log n_r and q_r of the rounds after the first."""
        self._log_first = 0.0
        """log n_0."""
        self._full_rounds = 0
        self.rounds = 0
        """Rounds so far, those that search included."""

    def propose(self) -> NDArray[np.float64]:
        """Draw the points of the next round, u of shape (groups, points in each, D)."""
        rng = np.random.default_rng(int(mix(self._seed, Stream.CANDIDATES, self.rounds)))
        groups, shared = self._sampling.groups, self._sampling.shared
        if self.rounds == 0:
            shared = 1
            drawn = _logit(_stratified(rng, groups, self._dimensions))[:, None]
            self._log_first = math.log(groups)
        else:
            weights = self._weights(1.0)
            if self._effective(weights) < _FITTED:
                shared = 1
                weights = self._tempered()
            else:
                self._full_rounds += 1
            fit = self._fit(weights, groups, rng)
            drawn = fit.draw(rng, shared)
            self._fits.append((math.log(groups * shared), fit))
        self._drawn = drawn
        return _expit(drawn)

    def weigh(self, log_likelihood: NDArray[np.float64]) -> None:
        """Add the points that were drawn last, with log L of shape (groups, points in each)."""
        groups, shared, _ = self._drawn.shape
        new = self._drawn.reshape(-1, self._dimensions)
        of_new = self._log_first + _log_prior(new)
        for log_count, fit in self._fits:
            of_new = np.logaddexp(of_new, log_count + fit.log_density(new))
        if self._fits:
            log_count, fit = self._fits[-1]
            of_old = log_count + fit.log_density(self._points, self._group)
            self._log_proposal = np.logaddexp(self._log_proposal, of_old)
        first = self._group[-1] + 1 if len(self._group) else 0
        self._log_proposal = np.concatenate([self._log_proposal, of_new])
        self._points = np.concatenate([self._points, new])
        self._group = np.concatenate([self._group, np.repeat(np.arange(groups), shared) + first])
        target = _log_prior(new) + log_likelihood.ravel()
        self._log_target = np.concatenate([self._log_target, target])
        self.rounds += 1

    @property
    def points(self) -> NDArray[np.float64]:
        """All points so far, u of shape (n, D)."""
        return _expit(self._points)

    @property
    def log_weights(self) -> NDArray[np.float64]:
        """Logarithms of w, whose mean weight is the evidence; shape (n,)."""
        return self._log_target - self._log_proposal + math.log(len(self._points))

    @property
    def effective_size(self) -> float:
        """Kish's effective sample size, in which points that share a coordinate count as one."""
        return self._effective(self._weights(1.0))

    @property
    def is_enough(self) -> bool:
        """Whether no further round is needed."""
        enough = self.effective_size >= self._sampling.effective
        return self._full_rounds >= self._sampling.rounds and enough

    def _weights(self, power: float) -> NDArray[np.float64]:
        """Weights to a power, normalised. Some log weight is finite."""
        log_weights = self.log_weights
        possible = np.isfinite(log_weights)
        finite = np.where(possible, log_weights, log_weights[possible].min())
        weights = possible * np.exp(power * (finite - finite.max()))
        return weights / weights.sum()

    def _effective(self, weights: NDArray[np.float64]) -> float:
        by_group = np.bincount(self._group, weights)
        return float(by_group.sum() ** 2 / (by_group**2).sum())

    def _tempered(self) -> NDArray[np.float64]:
        """Weights to the largest power that leaves enough groups to fit to."""
        low, high = 0.0, 1.0
        for _ in range(30):
            middle = (low + high) / 2
            if self._effective(self._weights(middle)) >= _FITTED:
                low = middle
            else:
                high = middle
        return self._weights(low)

    def _fit(self, weights: NDArray[np.float64], groups: int, rng: np.random.Generator) -> _Mixture:
        """Fit a mixture to weighted points, as smooth as their effective number needs."""
        dimensions = self._dimensions
        middle = weights @ self._points
        apart = self._points - middle
        least = (_ROUGHNESS * _PRIOR_DEVIATION) ** 2 * np.eye(dimensions)
        spread = (weights[:, None] * apart).T @ apart
        spread += least * (np.diag(spread) < np.diag(least))
        width = (4 / ((dimensions + 2) * self._effective(weights))) ** (1 / (dimensions + 4))
        width = min(width, 0.9)
        ends = np.cumsum(weights)
        at = (np.arange(groups) + rng.random()) / groups * ends[-1]
        chosen = np.minimum(np.searchsorted(ends, at, "right"), len(ends) - 1)
        # Drawn together, so that the whole mixture spreads no wider than the points.
        centres = middle + math.sqrt(1 - width**2) * apart[chosen]
        return _Mixture(centres, width * np.linalg.cholesky(spread), self._group[chosen])


@dataclass(frozen=True, eq=False)
class _Mixture:
    """Equal mixture of Student's t distributions that differ in their centres alone."""

    centres: NDArray[np.float64]
    """Shape (K, D)."""
    scale: NDArray[np.float64]
    """Lower triangle, shape (D, D), whose product with its transpose is the scale matrix."""
    groups: NDArray[np.int64]
    """Group of the point that each centre was fitted to, shape (K,)."""

    def draw(self, rng: np.random.Generator, same: int) -> NDArray[np.float64]:
        """Draw a group around each centre, which shares its first coordinate: (K, same, D)."""
        count, dimensions = self.centres.shape
        z = rng.standard_normal((count, same, dimensions))
        z[:, :, 0] = z[:, :1, 0]
        stretch = np.sqrt(_FREEDOM / rng.chisquare(_FREEDOM, count))
        return self.centres[:, None] + stretch[:, None, None] * (z @ self.scale.T)

    def log_density(
        self, points: NDArray[np.float64], groups: NDArray[np.int64] | None = None
    ) -> NDArray[np.float64]:
        """Log density at n points, shape (n,).

        Args:
            points: shape (n, D).
            groups: groups of points that the mixture was fitted to, shape (n,); None of new ones.
                At these it is the density of the other groups' centres alone: a point lies where
                its own group's are highest, so that with them it would count for too little.
        """
        count, dimensions = self.centres.shape
        to_unit = np.linalg.inv(self.scale).T
        at, centres = points @ to_unit, self.centres @ to_unit
        distance = np.zeros((*points.shape[:-1], count))
        for k in range(dimensions):
            distance += (at[..., k, None] - centres[:, k]) ** 2
        half = (_FREEDOM + dimensions) / 2
        constant = (
            math.lgamma(half)
            - math.lgamma(_FREEDOM / 2)
            - dimensions / 2 * math.log(_FREEDOM * math.pi)
            - float(np.log(np.diag(self.scale)).sum())
            - math.log(count)
        )
        # The tails are so heavy that no term overflows or is lost: no logarithm of sums is needed.
        terms = (1 + distance / _FREEDOM) ** -half
        if groups is not None:
            others = self.groups != groups[:, None]
            counted = others.sum(axis=-1, keepdims=True)
            others |= counted == 0  # a mixture of one group alone has no others
            terms = terms * others * (count / others.sum(axis=-1, keepdims=True))
        total: NDArray[np.float64] = np.log(terms.sum(axis=-1))
        return constant + total


def _stratified(rng: np.random.Generator, count: int, dimensions: int) -> NDArray[np.float64]:
    """Draw evenly from the unit cube, each coordinate with one value in each of equal strata."""
    strata = np.stack([rng.permutation(count) for _ in range(dimensions)], axis=1)
    return (strata + rng.random((count, dimensions))) / count


def _logit(u: NDArray[np.float64]) -> NDArray[np.float64]:
    inside = np.clip(u, _EDGE, 1 - _EDGE)
    return np.log(inside) - np.log1p(-inside)


def _expit(y: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.clip(0.5 + 0.5 * np.tanh(0.5 * y), 0.0, 1 - _EDGE)


def _log_prior(y: NDArray[np.float64]) -> NDArray[np.float64]:
    """Log density of y for u uniform in the cube."""
    size = np.abs(y)
    return -(size + 2 * np.log1p(np.exp(-size))).sum(axis=-1)
