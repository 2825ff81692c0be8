"""Who sits in the seats: HMIs and drivers, learned or not, and the exact optimum."""

from hmi_marl.agents.catalogue import (
    DRIVER_POLICY_NAMES,
    HMI_NAMES,
    make_driver_policy,
    make_hmi,
)
from hmi_marl.agents.driving import RandomDriver, RuleBasedDriver
from hmi_marl.agents.hmis import AlertWhenDistracted, BeliefAlert, OptimalAlert, RandomAlert
from hmi_marl.agents.learned import LearnedPolicy, PolicyCard
from hmi_marl.agents.policy_files import load_policy, save_policy
from hmi_marl.envs.seats import Policy

__all__ = [
    "DRIVER_POLICY_NAMES",
    "HMI_NAMES",
    "AlertWhenDistracted",
    "BeliefAlert",
    "LearnedPolicy",
    "OptimalAlert",
    "Policy",
    "PolicyCard",
    "RandomAlert",
    "RandomDriver",
    "RuleBasedDriver",
    "load_policy",
    "make_driver_policy",
    "make_hmi",
    "save_policy",
]
