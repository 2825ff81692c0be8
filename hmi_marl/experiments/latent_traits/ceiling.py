"""The exact Bayes ceiling of every accuracy on pools of windows.

A model sees no more of a pool of windows than their seeds, applied actions and alerts imply. The
Bayes classifier that knows the driver policy and every candidate's traits
(:mod:`hmi_marl.exact.identify`) makes the most of these, so no accuracy on the same pools can be
higher except by chance.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hmi_marl.agents.learned.policy import LearnedPolicy, find_policy, load_policy
from hmi_marl.demonstrations.dataset import Demonstrations, Observed
from hmi_marl.demonstrations.env import team_of
from hmi_marl.envs.config import DRIVER, TeamConfig
from hmi_marl.envs.drivers import TRAIT_NAMES, Driver
from hmi_marl.exact.identify import Identification, marginal
from hmi_marl.exact.oracle import identify
from hmi_marl.files import sha256_of
from hmi_marl.reporting.statistics import Estimate, accuracy

LIKES_HELP = 0.5
"""Least η of a driver who likes help."""
_NO_CEILING = "there is no exact ceiling"
_AT_RANDOM = "random:"


class NoCeilingError(ValueError):
    """The demonstrations have no exact ceiling, with any driver policy."""


@dataclass(frozen=True)
class Ceilings:
    """Accuracies of the Bayes classifier on pools of windows."""

    identity: Estimate
    """Accuracy of the driver's name."""
    preference: Estimate
    """Accuracy of whether the driver likes help."""


def likes_help(demonstrations: Demonstrations) -> NDArray[np.int64] | None:
    """Return 1 for windows of drivers who like help, else 0, (E,); None without the truth."""
    if demonstrations.truth is None:
        return None
    return (demonstrations.truth.traits[:, TRAIT_NAMES.index("eta")] >= LIKES_HELP).astype(np.int64)


def driver_policy_of(observed: Observed, given: str | None, config: TeamConfig) -> LearnedPolicy:
    """Load the driver policy of the demonstrations, sampling or greedy as it was.

    ``given`` is the run's folder or the policy's ``.json``; None: where it was when they were made.

    Raises:
        FileNotFoundError: it is not there.
        NoCeilingError: they were not made with a learned policy.
        ValueError: they were made with another policy than the one there.
    """
    about = observed.about.get("driver_policy")
    recorded: Mapping[str, Any] = about if isinstance(about, Mapping) else {}
    if "sha256" not in recorded:
        by = f"by {recorded['name']!r}" if "name" in recorded else "by an unknown driver policy"
        raise NoCeilingError(
            f"{_NO_CEILING}: it takes a learned driver policy, whose action probabilities are "
            f"known, but the demonstrations are {by}"
        )
    place = str(recorded["name"]) if given is None else given
    try:
        digest = sha256_of(find_policy(Path(place), DRIVER).with_suffix(".safetensors"))
    except FileNotFoundError as error:
        raise FileNotFoundError(
            f"{_NO_CEILING}: {error}; give the folder of the driver policy that the demonstrations "
            "were made with"
        ) from None
    if digest != recorded["sha256"]:
        raise ValueError(
            f"{_NO_CEILING}: {place} holds another driver policy than the one that the "
            f"demonstrations were made with, whose weights have the sha256 {recorded['sha256']}"
        )
    return load_policy(place, DRIVER, config, greedy=bool(recorded.get("greedy", False)))


def check_at_random(observed: Observed) -> None:
    """Raise NoCeilingError unless alerts came at random, so that their timing is no evidence."""
    hmi = observed.about.get("hmi")
    if not str(hmi).startswith(_AT_RANDOM):
        raise NoCeilingError(
            f"{_NO_CEILING}: it takes alerts at random, but they came from {hmi!r}"
        )


def evidence(
    observed: Observed, policy_source: str | None, drivers: Sequence[str | Driver]
) -> Identification:
    """Compute the exact log evidence of E windows for K candidates, shape (E, K).

    The policy's source is ``given`` of :func:`driver_policy_of`.

    Raises:
        FileNotFoundError: the driver policy is not there.
        NoCeilingError: no learned policy drove, or the episodes cannot be played again, or alerts
            were not at random, so that their timing is evidence too.
        ValueError: another policy drove.
    """
    if observed.seeds is None:
        raise NoCeilingError(f"{_NO_CEILING}: recorded drives without seeds cannot be replayed")
    check_at_random(observed)
    config = team_of(observed)
    policy = driver_policy_of(observed, policy_source, config)
    windows = observed.seeds, observed.actions, observed.alerts, observed.length
    return identify(config, policy, drivers, *windows)


def exact_evidence(unseen: Demonstrations, driver_policy: str | None) -> Identification:
    """Compute the exact evidence of these windows, with the drivers in them as candidates.

    Raises:
        NoCeilingError: the drivers' traits are not known; or see :func:`evidence`.
        FileNotFoundError, ValueError: see :func:`evidence`.
    """
    observed, truth = unseen.observed, unseen.truth
    if truth is None:
        raise NoCeilingError(f"{_NO_CEILING}: the drivers' traits are not known")
    first = [int((observed.driver == who).argmax()) for who in range(len(observed.names))]
    drivers = [
        Driver(name, **dict(zip(TRAIT_NAMES, truth.traits[at].tolist(), strict=True)))
        for name, at in zip(observed.names, first, strict=True)
    ]
    return evidence(observed, driver_policy, drivers)


def ceiling(
    identification: Identification,
    pools: ArrayLike,
    true: ArrayLike,
    labels: Sequence[Hashable],
    prior: ArrayLike | None = None,
) -> Estimate:
    """Return the accuracy of the Bayes classifier: the likeliest label of each pool.

    The interval counts as many trials as there would be pools if no two shared a window, rounding
    outwards.

    Args:
        identification: evidence of E windows for K candidates.
        pools: P pools of n windows each, indices of shape (P, n).
        true: driver of each pool, indices of ``identification.drivers``, shape (P,).
        labels: labels of the K candidates. Their names for identity; equal labels share their
            probability.
        prior: how frequent the candidates are, shape (K,); all equally by default.

    Raises:
        ValueError, IndexError: arrays that do not fit, or pools that no candidate can have driven.
    """
    pooled, who = identification.pooled(pools), np.asarray(true)
    count, candidates = pooled.log_evidence.shape
    if who.shape != (count,) or not np.issubdtype(who.dtype, np.integer):
        raise ValueError(
            f"true drivers are integers of shape ({count},), but got {who.dtype} of shape "
            f"{who.shape}"
        )
    if count == 0:
        raise ValueError("an accuracy takes at least one pool")
    if who.min() < 0 or who.max() >= candidates:
        raise ValueError(f"true drivers lie in 0 to {candidates - 1}")
    sums = marginal(pooled.posterior(prior), labels)
    kinds = list(sums)
    own = np.array([kinds.index(label) for label in labels])[who]
    places = np.asarray(pools)
    trials = max(1, min(count, len(np.unique(places)) // places.shape[1]))
    return accuracy(np.stack(list(sums.values())).argmax(axis=0) == own, trials)


def ceilings(identification: Identification, pools: ArrayLike, true: ArrayLike) -> Ceilings:
    """Return the ceilings of identity and preference; arguments as of :func:`ceiling`."""
    drivers = identification.drivers
    return Ceilings(
        identity=ceiling(identification, pools, true, [driver.name for driver in drivers]),
        preference=ceiling(
            identification, pools, true, [driver.eta >= LIKES_HELP for driver in drivers]
        ),
    )
