"""Adaptive HMIs by name: ``adapt``, ``adapt:choosing``, ``adapt:conditioned:bayes`` and so on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from hmi_marl.agents.adaptive.evidence_model import LearnedEvidence, load_evidence
from hmi_marl.agents.adaptive.hmis import (
    CAUTION,
    AdaptiveHMI,
    ChoosingHMI,
    ConditionedHMI,
    ExpectedValueHMI,
)
from hmi_marl.agents.adaptive.trait_estimator import CHANGE_RATE, TraitEstimator
from hmi_marl.agents.learned.policy import CONTEXT_OF, load_policy
from hmi_marl.envs.config import VEHICLE_AI, TeamConfig
from hmi_marl.envs.drivers import DRIVERS, PAPER_DRIVERS, Driver, Traits
from hmi_marl.envs.seats import Policy
from hmi_marl.exact.evidence import ChainEvidence, Evidence
from hmi_marl.exact.hidden_attention import DEFAULT_REVEALING
from hmi_marl.names import unknown

EXPECTED, CHOOSING, CONDITIONED = KINDS = ("expected", "choosing", "conditioned")
BAYES = "bayes"
TYPES = tuple(DRIVERS[name] for name in PAPER_DRIVERS)


@dataclass(frozen=True)
class Trained:
    """Learned models for unknown drivers: training runs, or agents that come with the package."""

    evidence: str = "trained:evidence"
    """Evidence model, an encoder of driving."""
    conditioned: str = "trained:conditioned"
    """HMI conditioned on z."""
    hidden: str = "trained:hidden-{}"
    """HMIs that do not see attention; {} stands for the driver model."""

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
        config: configuration of the teams.
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
            evidence = LearnedEvidence(load_evidence(trained.evidence), drivers, config)
        return TraitEstimator(evidence, config, change_rate=change_rate)

    if kind == EXPECTED:
        return ExpectedValueHMI(estimator(candidates), config, revealing, caution)
    if kind == CHOOSING:
        hmis = [trained.hidden_hmi(driver.name, config) for driver in TYPES]
        return ChoosingHMI(estimator(TYPES), hmis)
    if kind == CONDITIONED:
        policy = load_policy(trained.conditioned, VEHICLE_AI, config)
        model = load_evidence(trained.evidence)
        learned_from = policy.card.training.get(CONTEXT_OF, model.digest)
        if learned_from != model.digest:
            raise ValueError(
                f"{trained.conditioned} was trained with the latent space of another evidence "
                f"model than {trained.evidence}; name the one that it was trained with"
            )
        places = model.places(Traits.of(candidates))
        return ConditionedHMI(estimator(candidates), policy, places)
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
