r"""The exact posterior over a driver's traits (β, α, η, inflation), from windows of driving.

.. math::
    p(\text{traits} | \text{windows}) \propto p(\text{traits})
    \prod_{\text{windows}} p(\text{window} | \text{traits})

The likelihood sums over all hidden d by forward filtering (:mod:`~hmi_marl.exact.bayes_filter`). It
is computed for many candidate drivers at once, without approximation: each candidate perceives the
replayed window with its own inflation. The integral over the traits is by adaptive importance
sampling (:mod:`~hmi_marl.exact.importance`), whose error falls with the effective sample size. The
mean of this posterior has the least mean squared error of all estimates from the same data, over
drivers drawn from the prior.

Two things may be known or not, which makes four cases (the formulas are in
:mod:`~hmi_marl.exact.trait_likelihood`):

- a^H is *seen* by an HMI with sequential moves, and *hidden* in recordings of the car alone.
- The driver policy is *known* if π(a^H | o) can be computed. It then shows inflation, by the
  perceived lidar, and all traits that the policy reads. If it is *unknown*, nothing is assumed
  about which actions a driver chooses, and when: only the chain (d, i, c) counts, and inflation
  stays at its prior. With a^H seen that is the evidence of
  :class:`~hmi_marl.exact.evidence.ChainEvidence`. With a^H hidden it has to be assumed how often
  a^H_t differs from v_{t-1}: with one probability s in each step after the first, independently of
  all else. s is unknown too, has a uniform prior in [0, 1], is the same in all windows of a
  person, and is integrated out. A driver who does not act so gets a posterior that is too sure.

The likelihood is no smooth function of inflation: objects jump from one ray of the lidar to the
next, so that a few thousandths of inflation can change it several times, and no fixed ladder of
inflations is fine enough. Every point is computed at an inflation of its own, or of its group.

It is assumed that alerts do not depend on what is hidden, as those at random.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hmi_marl.checks import SHARE
from hmi_marl.envs.alerts import need_plain
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import TRAIT_NAMES, TraitDistributions
from hmi_marl.exact.identify import StochasticPolicy, check_stochastic
from hmi_marl.exact.importance import ImportanceSample, Sampling
from hmi_marl.exact.trait_likelihood import TraitLikelihood, Windows

LogPrior = Callable[[NDArray[np.float64]], NDArray[np.float64]]
"""Log density of traits, (G, 4) to (G,), with respect to the population's distributions."""
_INFLATION = TRAIT_NAMES.index("inflation")


@dataclass(frozen=True, eq=False)
class TraitPosterior:
    """Weighted points that represent the posterior over the traits of one person.

    Arrays by trait have columns as in ``TRAIT_NAMES``.
    """

    points: NDArray[np.float64]
    """Traits, shape (G, 4)."""
    weights: NDArray[np.float64]
    """Probability of each point, shape (G,); they sum to 1."""
    log_evidence: float
    """log p(windows), the likelihood averaged over the prior."""
    effective_size: float
    """Number of independent draws that the points are worth (Kish). Points that share their
    inflation count as one, so that it is rather too small."""
    rounds: int
    """Rounds of sampling."""
    is_enough: bool
    """Whether the effective size is as large as was asked for. If not, further rounds did not help:
    raise ``most_rounds`` or ``groups`` of :class:`Sampling`, and do not trust the tails."""
    revealing: NDArray[np.float64] | None = None
    """Share of revealing steps, s, of each point, shape (G,), where it is an unknown too."""

    def mean(self) -> NDArray[np.float64]:
        """Expected traits, shape (4,)."""
        return self.weights @ self.points

    def covariance(self) -> NDArray[np.float64]:
        """Covariance of the traits, shape (4, 4)."""
        apart = self.points - self.mean()
        return (self.weights[:, None] * apart).T @ apart

    def quantile(self, share: ArrayLike) -> NDArray[np.float64]:
        """Value of each trait that the true one is below with this probability.

        Args:
            share: in [0, 1], of any shape.

        Returns:
            The shape of ``share``, then 4.

        Raises:
            ValueError: a share outside [0, 1].
        """
        wanted = np.asarray(share, np.float64)
        if not ((wanted >= 0) & (wanted <= 1)).all():
            raise ValueError(f"a quantile's share lies in [0, 1], but got {share!r}")
        columns = []
        for values in self.points.T:
            order = np.argsort(values, kind="stable")
            weights = self.weights[order]
            columns.append(np.interp(wanted, np.cumsum(weights) - weights / 2, values[order]))
        return np.stack(columns, axis=-1)

    def interval(self, level: float) -> NDArray[np.float64]:
        """Equal-tailed interval of each trait with this probability: lower and upper ends, (2, 4).

        Raises:
            ValueError, TypeError: a level outside [0, 1].
        """
        tail = (1 - SHARE("level", level)) / 2
        return self.quantile([tail, 1 - tail])

    def rank(self, traits: ArrayLike) -> NDArray[np.float64]:
        """Probability that each trait is below a given value, shape (4,), half of what is equal.

        Over persons from the prior with their true traits it is uniform in [0, 1].
        """
        given = np.asarray(traits, np.float64)
        below = (self.points < given) + 0.5 * (self.points == given)
        return self.weights @ below


def trait_posterior(
    config: TeamConfig,
    policy: StochasticPolicy | None,
    seeds: ArrayLike | None,
    actions: ArrayLike,
    alerts: ArrayLike,
    length: ArrayLike,
    *,
    intended: ArrayLike | None = None,
    person: ArrayLike | None = None,
    prior: TraitDistributions | None = None,
    log_prior: LogPrior | None = None,
    sampling: Sampling | None = None,
    seed: int = 0,
    progress: Callable[[int], Any] = id,
) -> tuple[TraitPosterior, ...]:
    """Compute the posterior over the traits of each of P persons; see the module for the model.

    A person's result depends on that person's windows and on ``seed``, not on the other persons.

    Args:
        config: settings of the recorded teams, ``end_at_crash`` included; its driver is not read.
        policy: the driver policy, as of :func:`identify`; None if it is unknown.
        seeds: of E windows, shape (E,). Read only if the policy is known; else it may be None.
        actions: v_t as applied, 0 to 4, shape (E, T).
        alerts: a^A_t, 0 or 1, shape (E, T).
        length: steps of each window, shape (E,); later columns are not read.
        intended: a^H_t, 0 to 4, shape (E, T); None if it is hidden.
        person: whose window each is, 0 to P - 1, shape (E,); by default all are of one person.
        prior: independent distributions of the traits; the whole population's by default. A trait
            that is known is a Choice of one value.
        log_prior: any further factor of the prior, such as a correlation of two traits: its log
            density with respect to ``prior``, normalised if ``log_evidence`` is to be.
        sampling: numbers of points and rounds.
        seed: of the points.
        progress: called with the number of persons that have been finished since the last call.

    Returns:
        P posteriors.

    Raises:
        TypeError: a policy without probabilities, or seeds that are no integers.
        ValueError: arrays that do not fit together, numbers out of their range, windows that go on
            after their end when they are played again, a known policy without seeds, or windows
            that are impossible for every candidate.
    """
    need_plain(config.alerts, "trait_posterior()")
    if policy is not None:
        check_stochastic(policy)
        if seeds is None:
            raise ValueError("a known policy needs the seeds of the windows, to play them again")
    windows = Windows.checked(config, seeds, actions, alerts, length, intended, person)
    likelihood = TraitLikelihood(config, policy, windows)
    unknowns = _Unknowns(prior or TraitDistributions(), policy is None and intended is None)
    plan = sampling or Sampling()
    if not (policy is not None and unknowns.free[:1] == (_INFLATION,)):  # no lidar to be shared
        plan = Sampling(plan.groups * plan.shared, 1, plan.rounds, plan.most_rounds, plan.effective)
    samples = [ImportanceSample(unknowns.dimensions, plan, seed) for _ in windows.of_person]
    left = list(range(len(samples)))
    while left:
        drawn = {person: samples[person].propose() for person in left}
        for shape in sorted({u.shape for u in drawn.values()}):  # rounds that search are smaller
            alike = [person for person in left if drawn[person].shape == shape]
            traits, revealing = unknowns.of(np.stack([drawn[person] for person in alike]))
            found = likelihood(np.array(alike), traits, revealing)
            if log_prior is not None:
                more = np.asarray(log_prior(traits.reshape(-1, len(TRAIT_NAMES))), np.float64)
                found = found + more.reshape(found.shape)
            for person, values in zip(alike, found, strict=True):
                _check_possible(person, samples[person], values)
                samples[person].weigh(values)
        unfinished = [p for p in left if not samples[p].is_enough]
        unfinished = [p for p in unfinished if samples[p].rounds < plan.most_rounds]
        progress(len(left) - len(unfinished))
        left = unfinished
    return tuple(unknowns.posterior(sample) for sample in samples)


def _check_possible(person: int, sample: ImportanceSample, values: NDArray[np.float64]) -> None:
    """Raise if no candidate of the first round is possible."""
    if np.isnan(values).any() or (values == np.inf).any():
        raise ValueError("log_prior returns log densities, which are finite numbers or -inf")
    if sample.rounds == 0 and (values == -np.inf).all():
        raise ValueError(
            f"the windows of person {person} are impossible for all {values.size} candidates of "
            "the first round: they are not of this policy, or raise groups of Sampling"
        )


class _Unknowns:
    """Unknowns of a person, as coordinates of the unit cube.

    The first is inflation, if it is free, since points that share it share the replayed lidar.
    """

    def __init__(self, prior: TraitDistributions, with_revealing: bool) -> None:
        self._distributions = [getattr(prior, name) for name in TRAIT_NAMES]
        order = (_INFLATION, *range(_INFLATION))
        supports = [each.support for each in self._distributions]
        self.free = tuple(k for k in order if supports[k][0] < supports[k][1])
        """Indices of the traits that are not known."""
        self._with_revealing = with_revealing

    @property
    def dimensions(self) -> int:
        """Number of coordinates, at least 1."""
        return max(1, len(self.free) + self._with_revealing)

    def of(self, u: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
        """Traits, shape (..., 4), and s, shape (...), of points of the cube, shape (..., D)."""
        traits = np.empty((*u.shape[:-1], len(TRAIT_NAMES)))
        for k, distribution in enumerate(self._distributions):
            if k in self.free:
                traits[..., k] = distribution.quantile(u[..., self.free.index(k)])
            else:
                traits[..., k] = distribution.support[0]
        return traits, u[..., len(self.free)] if self._with_revealing else None

    def posterior(self, sample: ImportanceSample) -> TraitPosterior:
        """Gather the points of a sample."""
        traits, revealing = self.of(sample.points)
        log_weights = sample.log_weights
        highest = log_weights.max()
        weights = np.exp(log_weights - highest)
        return TraitPosterior(
            traits,
            weights / weights.sum(),
            float(highest + math.log(weights.mean())),
            sample.effective_size,
            sample.rounds,
            sample.is_enough,
            revealing,
        )
