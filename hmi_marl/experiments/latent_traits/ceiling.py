"""How often anybody could be right about who drove: the exact ceiling beside every accuracy.

Whoever learns from demonstrations sees no more of a pool of windows than their seeds, applied
actions and alerts imply. The Bayes classifier that knows the driver policy and every candidate's
traits (:mod:`hmi_marl.exact.identify`) makes the most of these, so that no accuracy on the same
pools can be higher but by luck.
"""

from __future__ import annotations

import hashlib
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hmi_marl.agents.learned.policy import LearnedPolicy, find_policy, load_policy
from hmi_marl.demonstrations.dataset import Observed
from hmi_marl.demonstrations.env import team_of
from hmi_marl.envs.config import DRIVER, TeamConfig
from hmi_marl.envs.drivers import Driver
from hmi_marl.exact.identify import Identification, marginal
from hmi_marl.exact.oracle import identify
from hmi_marl.reporting.statistics import Estimate, accuracy

LIKES_HELP = 0.5
"""η from which on a driver counts as one who likes help."""
_NO_CEILING = "the exact ceiling cannot be had"
_AT_RANDOM = "random:"


class NoCeilingError(ValueError):
    """Demonstrations that have no exact ceiling, whatever driver policy is given."""


@dataclass(frozen=True)
class Ceilings:
    """Accuracies of the Bayes classifier on pools of windows."""

    identity: Estimate
    """Of who drove."""
    preference: Estimate
    """Of whether they like help."""

    def as_json(self) -> dict[str, Any]:
        """Both, each with its interval."""
        return {"identity": self.identity.as_json(), "preference": self.preference.as_json()}


def driver_policy_of(observed: Observed, given: str | None, config: TeamConfig) -> LearnedPolicy:
    """The driver policy that demonstrations were made with, as it acted then: drawing or greedy.

    Args:
        observed: the demonstrations.
        given: the run's folder or the policy's ``.json``; None: where it was when they were made.
        config: of the teams that gave them.

    Raises:
        FileNotFoundError: it is not there.
        NoCeilingError: they were not made with a learned policy.
        ValueError: they were made with another one than is there.
    """
    about = observed.about.get("driver_policy")
    told: Mapping[str, Any] = about if isinstance(about, Mapping) else {}
    if "sha256" not in told:
        who = f"steered by {told['name']!r}" if "name" in told else "not told who steered"
        raise NoCeilingError(
            f"{_NO_CEILING}: it takes a driver that tells its probabilities, a learned policy, but "
            f"the demonstrations are {who}"
        )
    place = str(told["name"]) if given is None else given
    try:
        weights = find_policy(Path(place), DRIVER).with_suffix(".safetensors").read_bytes()
    except FileNotFoundError as error:
        raise FileNotFoundError(
            f"{_NO_CEILING}: {error}; give the folder of the driver policy that the demonstrations "
            "were made with"
        ) from None
    if hashlib.sha256(weights).hexdigest() != told["sha256"]:
        raise ValueError(
            f"{_NO_CEILING}: {place} holds another driver policy than the one that the "
            f"demonstrations were made with, whose weights have the sha256 {told['sha256']}"
        )
    return load_policy(place, DRIVER, config, greedy=bool(told.get("greedy", False)))


def evidence(
    observed: Observed, policy_source: str | None, drivers: Sequence[str | Driver]
) -> Identification:
    """The exact evidence of each window for each of the candidates.

    Args:
        observed: E demonstrations.
        policy_source: as ``given`` of :func:`driver_policy_of`.
        drivers: K candidates.

    Returns:
        log evidence of shape (E, K).

    Raises:
        FileNotFoundError: the driver policy is not there.
        NoCeilingError: no learned policy drove, or the episodes cannot be played again, or alerts
            were not at random, so that when they came is evidence too.
        ValueError: it was another policy.
    """
    if observed.seeds is None:
        raise NoCeilingError(f"{_NO_CEILING}: recorded drives have no seeds, to be played again by")
    hmi = observed.about.get("hmi")
    if not str(hmi).startswith(_AT_RANDOM):
        raise NoCeilingError(
            f"{_NO_CEILING}: it takes alerts at random, but they came from {hmi!r}"
        )
    config = team_of(observed)
    policy = driver_policy_of(observed, policy_source, config)
    windows = observed.seeds, observed.actions, observed.alerts, observed.length
    return identify(config, policy, drivers, *windows)


def ceiling(
    identification: Identification,
    pools: ArrayLike,
    true: ArrayLike,
    labels: Sequence[Hashable],
    prior: ArrayLike | None = None,
) -> Estimate:
    """Accuracy of the Bayes classifier: for each pool, the label of the largest probability.

    The interval counts as many trials as there would be pools if no two shared a window, rounding
    outwards.

    Args:
        identification: what E windows tell of K candidates.
        pools: P pools of n windows each, places of shape (P, n).
        true: who drove each pool, indices of ``identification.drivers``, shape (P,).
        labels: of the candidates, K of them. Their names for identity; equal labels share their
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
    """The ceilings for identity and for preference; arguments as of :func:`ceiling`."""
    drivers = identification.drivers
    return Ceilings(
        identity=ceiling(identification, pools, true, [driver.name for driver in drivers]),
        preference=ceiling(
            identification, pools, true, [driver.eta >= LIKES_HELP for driver in drivers]
        ),
    )
