"""HMIs that infer their driver's traits while driving.

Each is a policy that holds a :class:`TraitEstimator` and acts on its belief:

- :class:`ChoosingHMI` acts as the HMI of the likeliest type;
- :class:`ConditionedHMI` is one learned policy π(a^A | a^H, s, z), which reads the z that is
  expected under the belief, and how uncertain it is;
- :class:`ExpectedValueHMI` alerts where that is worth more on average over the belief, which
  weighs the gain or loss for each candidate.

:meth:`~AdaptiveHMI.reset` begins an episode of an unknown driver, ``next_trip`` one of the same
driver as before. :func:`adaptive_by_name` makes them by name: ``adapt``, ``adapt:choosing``,
``adapt:conditioned:bayes`` and so on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hmi_marl.agents.adaptive.advantages import Advantages
from hmi_marl.agents.adaptive.evidence_model import LearnedEvidence, load_evidence
from hmi_marl.agents.adaptive.trait_estimator import CHANGE_RATE, TraitEstimator
from hmi_marl.agents.hmis import BeliefAlert
from hmi_marl.agents.learned.policy import CONTEXT_OF, LearnedPolicy, load_policy
from hmi_marl.agents.learned.trait_model import load_traits
from hmi_marl.checks import Real
from hmi_marl.envs.config import VEHICLE_AI, TeamConfig
from hmi_marl.envs.drivers import DRIVERS, PAPER_DRIVERS, Driver, Traits
from hmi_marl.envs.seats import Policy, moves_sequentially
from hmi_marl.exact.evidence import ChainEvidence, Evidence
from hmi_marl.exact.hidden_attention import DEFAULT_REVEALING
from hmi_marl.exact.identify import TraitBelief
from hmi_marl.registry import unknown

DOUBT = Real(0.0, 1e9)
"""Range of κ."""
CAUTION = 0.5
"""κ of :class:`ExpectedValueHMI`: at maximum entropy it follows AvgHMI unless the expected gain
from deviating exceeds this many standard deviations of the gain."""


class AdaptiveHMI:
    """Base class of adaptive HMIs: an estimator of the driver's traits observes every turn."""

    def __init__(self, estimator: TraitEstimator) -> None:
        self.estimator = estimator

    def reset(self, seeds: NDArray[np.uint64], which: NDArray[np.bool_] | None = None) -> None:
        """See :meth:`Policy.reset`; the drivers are unknown."""
        self.estimator.reset(len(seeds), which)
        self._begin(seeds, which)

    def next_trip(self, seeds: NDArray[np.uint64], which: NDArray[np.bool_] | None = None) -> None:
        """Begin episodes of the same drivers as before and keep the belief about them."""
        self.estimator.next_trip(which)
        self._begin(seeds, which)

    def act(self, observations: NDArray[np.float32]) -> NDArray[np.int64]:
        """See :meth:`Policy.act`."""
        return self._act(observations, self.estimator.observe(observations))

    def _begin(self, seeds: NDArray[np.uint64], which: NDArray[np.bool_] | None) -> None:
        raise NotImplementedError

    def _act(self, observations: NDArray[np.float32], belief: TraitBelief) -> NDArray[np.int64]:
        raise NotImplementedError


class ChoosingHMI(AdaptiveHMI):
    """Act as the HMI of the likeliest candidate; ``hmis``, one for each candidate, all observe.

    Raises:
        ValueError: another number of HMIs than candidates, the same object twice, or an HMI
            trained with simultaneous moves.
    """

    def __init__(self, estimator: TraitEstimator, hmis: Sequence[Policy]) -> None:
        super().__init__(estimator)
        drivers = estimator.evidence.drivers
        if len(hmis) != len(drivers):
            raise ValueError(f"{len(drivers)} candidates need an HMI each, but got {len(hmis)}")
        if len({id(hmi) for hmi in hmis}) < len(hmis):
            raise ValueError(
                "every candidate needs a separate HMI object, since HMIs have a memory"
            )
        if not all(moves_sequentially(hmi) for hmi in hmis):
            raise ValueError(
                "the HMIs to choose among must see a^H_t: use HMIs trained with sequential moves"
            )
        self.hmis = tuple(hmis)

    def _begin(self, seeds: NDArray[np.uint64], which: NDArray[np.bool_] | None) -> None:
        for hmi in self.hmis:
            hmi.reset(seeds, which)

    def _act(self, observations: NDArray[np.float32], belief: TraitBelief) -> NDArray[np.int64]:
        alerts = np.stack([hmi.act(observations) for hmi in self.hmis])
        return alerts[belief.most_likely, np.arange(len(observations))]


class ConditionedHMI(AdaptiveHMI):
    """One learned HMI π(a^A | a^H, s, z), with z as it is known while driving.

    Under the belief z has a mean and a standard deviation; the policy reads both
    (:func:`context_of`).

    Args:
        estimator: estimates who drives.
        policy: a policy that is conditioned on 2 Z numbers.
        latents: z of each candidate, shape (K, Z).

    Raises:
        ValueError: latents of another shape, or a policy that takes no such z.
    """

    def __init__(
        self, estimator: TraitEstimator, policy: LearnedPolicy, latents: NDArray[np.floating]
    ) -> None:
        super().__init__(estimator)
        context = policy.card.context
        wanted = len(estimator.evidence.drivers), context // 2
        if not context or context % 2 or latents.shape != wanted:
            raise ValueError(
                f"{wanted[0]} candidates and a policy that is conditioned on {context} numbers, "
                f"mean and standard deviation of z, need latents of shape {wanted}, but got "
                f"{latents.shape}"
            )
        self.policy, self.latents = policy, latents

    def _begin(self, seeds: NDArray[np.uint64], which: NDArray[np.bool_] | None) -> None:
        self.policy.reset(seeds, which)

    def _act(self, observations: NDArray[np.float32], belief: TraitBelief) -> NDArray[np.int64]:
        self.policy.context = context_of(belief, self.latents)
        return self.policy.act(observations)


def context_of(belief: TraitBelief, latents: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return mean and standard deviation of z under a belief, side by side, shape (N, 2 Z).

    Args:
        belief: about N drivers, with K candidates.
        latents: z of each candidate, shape (K, Z).
    """
    mean = belief.expected(latents)
    variance = belief.expected(np.square(latents)) - mean**2
    return np.concatenate([mean, np.sqrt(np.maximum(variance, 0.0))], axis=1)


class ExpectedValueHMI(AdaptiveHMI):
    r"""Act like AvgHMI unless the belief is clear enough for the opposite.

    For every candidate k the rule that is optimal on b_k = p_k(d = 1) gives the advantage of
    alerting now over not alerting, A_k(t, b_k, i, c); see :func:`solve_belief`. With g_k = ± A_k,
    the gain from deviating from AvgHMI's choice if k drives, it deviates where

    .. math:: E[g] > \kappa\, H\, \mathrm{sd}[g]

    over the belief p(k), where H is its entropy as a share of the maximum. With κ = 0 this has the
    highest expected value (and would be optimal if the driver were revealed in the next step). With
    κ > 0 an uncertain belief follows AvgHMI, so that no driver loses at the start what others would
    have gained; H falls as the belief becomes certain. Once one candidate is certain it acts as
    :class:`BeliefAlert` for that driver, for any κ.

    Args:
        revealing: assumed share of steps in which a^H differs from the last applied action.
        caution: κ.
        default: driver model of AvgHMI.

    Raises:
        ValueError, TypeError: caution out of its range.
    """

    def __init__(
        self,
        estimator: TraitEstimator,
        config: TeamConfig,
        revealing: float = DEFAULT_REVEALING,
        caution: float = CAUTION,
        default: str | Driver = "average",
    ) -> None:
        super().__init__(estimator)
        self.caution = DOUBT("caution", caution)
        self._default = BeliefAlert(default, config, revealing)
        self._advantages = Advantages(estimator.evidence.drivers, config, revealing)

    def _begin(self, seeds: NDArray[np.uint64], which: NDArray[np.bool_] | None) -> None:
        self._default.reset(seeds, which)
        self._advantages.reset(len(seeds), which)

    def _act(self, observations: NDArray[np.float32], belief: TraitBelief) -> NDArray[np.int64]:
        usual = self._default.act(observations)
        gain = np.where(usual[:, None] == 1, -1.0, 1.0) * self._advantages.observe(observations)
        p = self._advantages.by_chain(belief.probabilities)
        mean = (p * gain).sum(axis=1)
        spread = np.sqrt((p * (gain - mean[:, None]) ** 2).sum(axis=1))
        return np.where(mean > self.caution * _doubt(p) * spread, 1 - usual, usual)


def _doubt(probabilities: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the entropy of each row of (N, K) as a share of log K, in [0, 1]; 0 if K is 1."""
    logs = np.log(probabilities, out=np.zeros_like(probabilities), where=probabilities > 0)
    most = np.log(probabilities.shape[1])
    entropy: NDArray[np.float64] = -(probabilities * logs).sum(axis=1)
    return entropy / most if most > 0 else np.zeros(len(probabilities))


EXPECTED, CHOOSING, CONDITIONED = KINDS = ("expected", "choosing", "conditioned")
BAYES = "bayes"
TYPES = tuple(DRIVERS[name] for name in PAPER_DRIVERS)


@dataclass(frozen=True)
class Trained:
    """Learned models for unknown drivers: training runs, or agents that come with the package."""

    evidence: str = "trained:evidence"
    """Evidence model, which reads the encoder's features and a^H."""
    conditioned: str = "trained:conditioned"
    """HMI conditioned on z."""
    hidden: str = "trained:hidden-{}"
    """HMIs that do not see attention; {} stands for the driver model."""
    traits: str = "trained:traits-self"
    """Trait model, whose encoder reads the trip under way."""

    def hidden_hmi(self, model: str, config: TeamConfig) -> Policy:
        """Load the HMI for a driver model."""
        return load_policy(self.hidden.format(model), VEHICLE_AI, config)


def make_adaptive(
    kind: str,
    config: TeamConfig,
    exact: bool = False,
    candidates: Sequence[Driver] = TYPES,
    trained: Trained | None = None,
    revealing: float = DEFAULT_REVEALING,
    caution: float = CAUTION,
    change_rate: float = CHANGE_RATE,
) -> AdaptiveHMI:
    """Make an HMI that infers its driver's traits while driving.

    Args:
        kind: "expected", "choosing" (among the four types alone) or "conditioned".
        exact: use the exact evidence of the attention chain instead of a learned model.
        candidates: the possible drivers.
        trained: places of the learned models; by default those that come with the package.
        revealing: assumed share of steps in which a^H differs from the last applied action.
        caution: κ of :class:`ExpectedValueHMI`, for "expected".
        change_rate: h of the :class:`TraitEstimator`.

    Raises:
        FileNotFoundError, ValueError: an unknown kind, or a learned model that cannot be loaded.
    """
    trained = trained or Trained()

    def estimator(drivers: Sequence[Driver]) -> TraitEstimator:
        evidence: Evidence
        if exact:
            evidence = ChainEvidence(drivers, config)
        else:
            models = load_evidence(trained.evidence), load_traits(trained.traits)
            evidence = LearnedEvidence(*models, drivers, config)
        return TraitEstimator(evidence, config, change_rate=change_rate)

    if kind == EXPECTED:
        return ExpectedValueHMI(estimator(candidates), config, revealing, caution)
    if kind == CHOOSING:
        hmis = [trained.hidden_hmi(driver.name, config) for driver in TYPES]
        return ChoosingHMI(estimator(TYPES), hmis)
    if kind == CONDITIONED:
        policy = load_policy(trained.conditioned, VEHICLE_AI, config)
        model = load_evidence(trained.evidence)
        if policy.card.training.get(CONTEXT_OF, model.card.encoder) != model.card.encoder:
            raise ValueError(
                f"{trained.conditioned} was trained with the z of another encoder than "
                f"{trained.evidence} reads; name an evidence model that reads the same one"
            )
        return ConditionedHMI(estimator(candidates), policy, model.expected(Traits.of(candidates)))
    raise ValueError(unknown("kind of adaptive HMI", kind, KINDS))


def adaptive_by_name(argument: str, config: TeamConfig) -> AdaptiveHMI:
    """Make the HMI ``adapt:ARGUMENT``, where ARGUMENT is KIND, KIND:bayes, bayes or empty.

    Raises:
        FileNotFoundError, ValueError: see :func:`make_adaptive`.
    """
    words = [word for word in argument.split(":") if word]
    exact = BAYES in words
    kinds = [word for word in words if word != BAYES]
    if len(kinds) > 1:
        raise ValueError(f"adapt[:KIND][:bayes] names one kind, not {argument!r}")
    return make_adaptive(kinds[0] if kinds else EXPECTED, config, exact)
