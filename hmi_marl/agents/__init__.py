"""Who sits in the seats: HMIs and drivers, learned or not, and the exact optimum."""

from hmi_marl.agents.adaptive.catalogue import make_adaptive
from hmi_marl.agents.adaptive.evidence_files import load_evidence
from hmi_marl.agents.adaptive.evidence_model import LearnedEvidence
from hmi_marl.agents.adaptive.hmis import (
    AdaptiveHMI,
    ChoosingHMI,
    ConditionedHMI,
    ExpectedValueHMI,
)
from hmi_marl.agents.adaptive.trait_estimator import TraitEstimator
from hmi_marl.agents.catalogue import (
    DRIVER_POLICY_NAMES,
    HMI_NAMES,
    make_driver_policy,
    make_hmi,
)
from hmi_marl.agents.driving import RandomDriver, RuleBasedDriver
from hmi_marl.agents.hmis import AlertWhenDistracted, BeliefAlert, OptimalAlert, RandomAlert
from hmi_marl.agents.learned.policy import LearnedPolicy, PolicyCard
from hmi_marl.agents.learned.policy_files import load_policy, save_policy
from hmi_marl.envs.seats import Policy
from hmi_marl.exact.evidence import ChainEvidence
from hmi_marl.exact.trait_posterior import TraitBelief

__all__ = [
    "DRIVER_POLICY_NAMES",
    "HMI_NAMES",
    "AdaptiveHMI",
    "AlertWhenDistracted",
    "BeliefAlert",
    "ChainEvidence",
    "ChoosingHMI",
    "ConditionedHMI",
    "ExpectedValueHMI",
    "LearnedEvidence",
    "LearnedPolicy",
    "OptimalAlert",
    "Policy",
    "PolicyCard",
    "RandomAlert",
    "RandomDriver",
    "RuleBasedDriver",
    "TraitBelief",
    "TraitEstimator",
    "load_evidence",
    "load_policy",
    "make_adaptive",
    "make_driver_policy",
    "make_hmi",
    "save_policy",
]
