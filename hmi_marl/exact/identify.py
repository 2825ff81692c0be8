r"""The exact Bayes classifier of the driver of recorded windows, from observable data alone.

Observed are the seed of a window (one episode), the applied actions, and the alerts. Playing the
window again gives what each candidate would have perceived, since its traffic follows from the seed
and the applied actions (:func:`perceived`); the true policy gives what they would have intended
(:func:`replay_intents`); and :class:`BayesFilter` gives the evidence, summed over all values of d.
With

.. math::
    p(k | \text{windows}) \propto p(k) \prod_{\text{windows}} p_k(v_0, v_1, ... | \text{seed},
    a^A_0, a^A_1, ...)

no classifier with the same data is right more often on average, if p(k) is how often each candidate
drives: this is the ceiling of every learned classifier. It requires alerts that do not depend on
what is hidden, such as random ones; see :mod:`hmi_marl.exact.bayes_filter`.
:class:`TraitBelief` holds such probabilities and what follows from them.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Protocol, TypeVar, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hmi_marl.envs.alerts import need_plain
from hmi_marl.envs.config import DRIVER, TeamConfig
from hmi_marl.envs.drivers import Driver, Traits
from hmi_marl.envs.observations import driver_layout, traits_part
from hmi_marl.envs.teaming import Teaming
from hmi_marl.exact.bayes_filter import BayesFilter, check_candidates, posterior

_ROWS = 2**14
"""Windows times candidates played side by side at most, which bounds the memory."""
_Label = TypeVar("_Label", bound=Hashable)


@runtime_checkable
class StochasticPolicy(Protocol):
    """A driver policy that gives the probability of each of its actions."""

    def reset(self, seeds: NDArray[np.uint64], which: NDArray[np.bool_] | None = None) -> None:
        """See :meth:`Policy.reset`."""

    def probabilities(self, observations: NDArray[np.float32]) -> NDArray[np.float64]:
        """π(a^H | observation), shape (N, 5); once per step and episode."""
        ...


@dataclass(frozen=True, eq=False)
class Identification:
    """Evidence of E windows about which of K candidates drove them."""

    drivers: tuple[Driver, ...]
    """The candidates."""
    log_evidence: NDArray[np.float64]
    """log p_k(v_0, v_1, ... | seed, alerts), shape (E, K); -inf where k is impossible."""

    def posterior(self, prior: ArrayLike | None = None) -> NDArray[np.float64]:
        """p(k | window), shape (E, K); see :func:`bayes_filter.posterior` for the prior.

        Raises:
            ValueError: numbers that are no prior, or a window impossible for every candidate.
        """
        return posterior(self.log_evidence, prior)

    def pooled(self, groups: ArrayLike) -> Identification:
        """Evidence of several windows of one driver together: the sum of their log evidence.

        Args:
            groups: P pools of n windows each, indices of shape (P, n).

        Returns:
            The same for P pools in place of E windows.

        Raises:
            ValueError, IndexError: no such windows.
        """
        places = np.asarray(groups)
        if places.ndim != 2 or not np.issubdtype(places.dtype, np.integer):
            raise ValueError(
                f"groups are places of windows, integers of shape (P, n), but got {places.dtype} "
                f"of shape {places.shape}"
            )
        return replace(self, log_evidence=self.log_evidence[places].sum(axis=1))


def marginal(
    probabilities: NDArray[np.float64], labels: Sequence[_Label]
) -> dict[_Label, NDArray[np.float64]]:
    """The probability of each label: the sum over the candidates that have it.

    >>> sums = marginal(np.array([[0.1, 0.2, 0.3, 0.4]]), ["low", "high", "low", "high"])
    >>> {label: p.round(3).tolist() for label, p in sums.items()}
    {'low': [0.4], 'high': [0.6]}

    Args:
        probabilities: of the candidates, shape (E, K).
        labels: of the candidates, K of them.

    Returns:
        For each label, in the order in which they come first, shape (E,).

    Raises:
        ValueError: not as many labels as candidates.
    """
    if len(labels) != probabilities.shape[-1]:
        raise ValueError(f"{probabilities.shape[-1]} candidates, but {len(labels)} labels for them")
    return {
        label: probabilities[..., [other == label for other in labels]].sum(axis=-1)
        for label in dict.fromkeys(labels)
    }


def identify(
    config: TeamConfig,
    policy: StochasticPolicy,
    drivers: Sequence[str | Driver],
    seeds: ArrayLike,
    actions: ArrayLike,
    alerts: ArrayLike,
    length: ArrayLike,
) -> Identification:
    """The exact evidence for each of K candidates in each of E windows, T steps long at most.

    Args:
        config: settings of the recorded teams, ``end_at_crash`` included; its driver is not read.
        policy: the true driver policy, made for such teams. It drew its actions, or took the
            likeliest if it has a ``greedy`` that is true. It is reset.
        drivers: the candidates.
        seeds: of the windows, shape (E,).
        actions: v_t as applied, 0 to 4, shape (E, T).
        alerts: a^A_t, 0 or 1, shape (E, T).
        length: steps of each window, shape (E,); later columns are not read.

    Raises:
        TypeError: a policy without probabilities, or seeds that are no integers.
        ValueError: no candidates, arrays that do not fit together, numbers out of their range, or
            windows that go on after their end when they are played again.
    """
    check_stochastic(policy)
    need_plain(config.alerts, "identify()")
    candidates = check_candidates(drivers)
    seeds, actions, alerts, length = check_windows(config, seeds, actions, alerts, length)
    evidence = [np.zeros((0, len(candidates)))]
    for part in parts_of(len(seeds), len(candidates)):
        data = seeds[part], actions[part], alerts[part], length[part]
        bayes = BayesFilter(candidates, config.alert_window, len(seeds[part]))
        for t, chances in enumerate(replay_intents(config, policy, candidates, *data)):
            active = t < length[part]
            bayes.update(chances, actions[part, t], alerts[part, t], active=active)
        evidence.append(bayes.log_evidence)
    return Identification(candidates, np.concatenate(evidence))


def parts_of(windows: int, candidates: int) -> Iterator[slice]:
    """Cut windows into parts that are played again side by side with all candidates."""
    at_once = max(1, _ROWS // candidates)
    for start in range(0, windows, at_once):
        yield slice(start, start + at_once)


def replay_intents(
    config: TeamConfig,
    policy: StochasticPolicy,
    drivers: Sequence[Driver],
    seeds: NDArray[np.uint64],
    actions: NDArray[np.int64],
    alerts: NDArray[np.int64],
    length: NDArray[np.int64],
) -> Iterator[NDArray[np.float64]]:
    """Probability of each intent for each candidate, by playing recorded windows again.

    Args:
        config, policy, drivers, seeds, actions, alerts, length: as of :func:`identify`.

    Yields:
        π_k(a^H_t | o^k_t) for t = 0, 1, ..., shape (K, E, 5).
    """
    shape = len(drivers), len(seeds), -1
    policy.reset(np.tile(seeds, len(drivers)))
    for seen in perceived(config, drivers, seeds, actions, alerts, length):
        yield intents(policy, seen.reshape(-1, seen.shape[-1])).reshape(shape)


def intents(policy: StochasticPolicy, seen: NDArray[np.float32]) -> NDArray[np.float64]:
    """Probability of each intent, (N, 5), of a policy that draws, or takes the likeliest if greedy.

    Args:
        policy: reset for N teams.
        seen: the driver's observations, shape (N, columns).
    """
    chances = policy.probabilities(seen)
    if getattr(policy, "greedy", False):
        likeliest = chances.argmax(axis=1)[:, None]
        chances = (np.arange(chances.shape[1]) == likeliest).astype(np.float64)
    return chances


def perceived(
    config: TeamConfig,
    drivers: Sequence[Driver],
    seeds: NDArray[np.uint64],
    actions: NDArray[np.int64],
    alerts: NDArray[np.int64],
    length: NDArray[np.int64],
) -> Iterator[NDArray[np.float32]]:
    """Observations of each candidate, by playing recorded windows again.

    Args:
        config, drivers, seeds, actions, alerts, length: as of :func:`identify`.

    Yields:
        The driver's observations o^k_t for t = 0, 1, ..., shape (K, E, columns).

    Raises:
        ValueError: a window goes on after its end.
    """
    inflations, which = np.unique([driver.inflation for driver in drivers], return_inverse=True)
    layout, traits = driver_layout(config), traits_part(Traits.of(drivers))
    each = np.repeat(inflations[:, None], len(seeds), axis=1)
    for by_inflation in replay(config, each, seeds, actions, alerts, length):
        seen = by_inflation[which]
        if "traits" in layout:
            seen[..., layout["traits"]] = traits[:, None]
        yield seen


def replay(
    config: TeamConfig,
    inflations: NDArray[np.float64],
    seeds: NDArray[np.uint64],
    actions: NDArray[np.int64],
    alerts: NDArray[np.int64],
    length: NDArray[np.int64],
) -> Iterator[NDArray[np.float32]]:
    """Observations with each of M inflations, by playing each recorded window again once.

    The driver in a replay is never distracted, so that the recorded actions are applied again.

    Args:
        config, seeds, actions, alerts, length: as of :func:`identify`.
        inflations: of each window, shape (M, E).

    Yields:
        The driver's observations for t = 0, 1, ..., shape (M, E, columns). Traits in them, if any,
        are not those of a candidate.

    Raises:
        ValueError: a window goes on after its end.
    """
    attentive = Driver("attentive", beta=0.0, alpha=1.0, eta=0.0, inflation=1.0)
    teams = Teaming(replace(config, driver=attentive), len(seeds), "batched")
    teams.reset(seeds)
    within = np.arange(actions.shape[1]) < length[:, None]
    driven, alerted = np.where(within, actions, 0), np.where(within, alerts, 0)
    everywhere = np.ones(len(seeds), np.bool_)
    for t in range(int(length.max(initial=0))):
        if (within[:, t] & teams.over).any():
            raise ValueError(
                f"a window goes on after step {t - 1}, in which it ends when played again: config "
                "is not that of the recording (see end_at_crash)"
            )
        seen = []
        for inflation in inflations:
            teams.world.perceive(inflation, everywhere)
            seen.append(teams.observe(DRIVER))
        yield np.array(seen)
        teams.turn(driven[:, t], alerted[:, t])


def check_stochastic(policy: object) -> StochasticPolicy:
    """Return ``policy`` if it gives probabilities, or raise TypeError."""
    if isinstance(policy, type) or not isinstance(policy, StochasticPolicy):
        raise TypeError(
            "the true driver policy must give its probabilities: pass an object with reset() and "
            f"probabilities(), such as a LearnedPolicy, not {policy!r}"
        )
    return policy


_Data = tuple[NDArray[np.uint64], NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]


def check_windows(
    config: TeamConfig, seeds: ArrayLike, actions: ArrayLike, alerts: ArrayLike, length: ArrayLike
) -> _Data:
    """Return the windows as arrays that fit together; actions are checked when they are played."""
    shape = np.shape(actions)
    if len(shape) != 2 or shape[1] > config.horizon:
        raise ValueError(
            f"actions have shape (E, T) with at most {config.horizon} steps, not {shape}"
        )
    for name, given, expected in (
        ("seeds", seeds, shape[:1]),
        ("alerts", alerts, shape),
        ("length", length, shape[:1]),
    ):
        if np.shape(given) != expected:
            raise ValueError(f"{name} has shape {expected}, not {np.shape(given)}")
    steps = np.asarray(length)
    wrong = (steps < 0) | (steps > shape[1])
    if wrong.any():
        raise ValueError(f"length lies in 0 to {shape[1]}, but got {steps[wrong][0]}")
    return np.asarray(seeds), np.asarray(actions), np.asarray(alerts), steps


@dataclass(frozen=True, eq=False)
class TraitBelief:
    """Probabilities of K candidates in each of N teams."""

    drivers: tuple[Driver, ...]
    """The K candidates: the known types, or a sample of a population."""
    probabilities: NDArray[np.float64]
    """Probability of each candidate, shape (N, K); the rows sum to 1."""

    @property
    def mean(self) -> NDArray[np.float64]:
        """Expected traits, shape (N, 4), columns as in ``TRAIT_NAMES``."""
        return self.probabilities @ Traits.of(self.drivers).as_array()

    @property
    def spread(self) -> NDArray[np.float64]:
        """Standard deviation of each trait, shape (N, 4)."""
        apart = Traits.of(self.drivers).as_array() - self.mean[:, None]  # (N, K, 4)
        return np.sqrt(np.einsum("nk,nkt->nt", self.probabilities, apart**2))

    @property
    def most_likely(self) -> NDArray[np.int64]:
        """Place of the likeliest candidate, shape (N,); the first of equals."""
        return self.probabilities.argmax(axis=1)

    def named(self) -> dict[str, NDArray[np.float64]]:
        """Probability of each name among the candidates, shape (N,)."""
        return marginal(self.probabilities, [driver.name for driver in self.drivers])

    def expected(self, values: NDArray[np.floating]) -> NDArray[np.float64]:
        """Expectation of a quantity of each candidate: shape (K, ...) to (N, ...)."""
        return np.tensordot(self.probabilities, values, axes=1)
