"""HMIs and driver policies: rules, exact optima and learned ones."""

from hmi_marl.agents.adaptive.evidence_model import LearnedEvidence, load_evidence
from hmi_marl.agents.adaptive.hmis import (
    AdaptiveHMI,
    ChoosingHMI,
    ConditionedHMI,
    ExpectedValueHMI,
    make_adaptive,
)
from hmi_marl.agents.adaptive.trait_estimator import TraitEstimator
from hmi_marl.agents.catalogue import DRIVER_POLICIES, HMIS, make_driver_policy, make_hmi
from hmi_marl.agents.driving import RandomDriver, RuleBasedDriver
from hmi_marl.agents.hmis import AlertWhenDistracted, BeliefAlert, OptimalAlert, RandomAlert
from hmi_marl.agents.learned.policy import LearnedPolicy, PolicyCard, load_policy, save_policy
from hmi_marl.agents.learned.trait_model import load_traits
from hmi_marl.agents.mixture import Mixture
from hmi_marl.envs.seats import Policy
from hmi_marl.exact.evidence import ChainEvidence
from hmi_marl.exact.identify import TraitBelief

__all__ = [
    "DRIVER_POLICIES",
    "HMIS",
    "AdaptiveHMI",
    "AlertWhenDistracted",
    "BeliefAlert",
    "ChainEvidence",
    "ChoosingHMI",
    "ConditionedHMI",
    "ExpectedValueHMI",
    "LearnedEvidence",
    "LearnedPolicy",
    "Mixture",
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
    "load_traits",
    "make_adaptive",
    "make_driver_policy",
    "make_hmi",
    "save_policy",
]
