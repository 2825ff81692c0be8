"""Who sits in the seats: HMIs and drivers that need no training, and the exact optimum."""

from hmi_marl.agents.catalogue import (
    DRIVER_POLICY_NAMES,
    HMI_NAMES,
    make_driver_policy,
    make_hmi,
)
from hmi_marl.agents.driving import RandomDriver, RuleBasedDriver
from hmi_marl.agents.hmis import AlertWhenDistracted, BeliefAlert, OptimalAlert, RandomAlert
from hmi_marl.envs.seats import Policy

__all__ = [
    "DRIVER_POLICY_NAMES",
    "HMI_NAMES",
    "AlertWhenDistracted",
    "BeliefAlert",
    "OptimalAlert",
    "Policy",
    "RandomAlert",
    "RandomDriver",
    "RuleBasedDriver",
    "make_driver_policy",
    "make_hmi",
]
