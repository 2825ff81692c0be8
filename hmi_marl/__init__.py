"""A distractible driver and the HMI that may alert them, as two agents in one car.

>>> from hmi_marl import merge_v0
>>> env = merge_v0.env(driver="homer")
>>> env.possible_agents
['driver', 'vehicle_ai']

Importing this package registers ``hmi_marl/merge-v0`` with PettingZoo (AEC and parallel) and
``hmi_marl/MergeDriver-v0`` and ``hmi_marl/MergeHMI-v0`` with Gymnasium. Its names are imported when
they are first used.
"""

from hmi_marl import interrupts

interrupts.end_at_once()  # in the command alone; what is imported below takes a while

import importlib  # noqa: E402
from typing import TYPE_CHECKING, Any  # noqa: E402

import pettingzoo  # noqa: E402
from gymnasium.envs import registration  # noqa: E402

if TYPE_CHECKING:
    from hmi_marl.agents.catalogue import make_driver_policy, make_hmi
    from hmi_marl.agents.learned.policy import load_policy
    from hmi_marl.agents.partners import make_vec
    from hmi_marl.agents.rollout import play
    from hmi_marl.demonstrations.recording import collect
    from hmi_marl.envs import merge_v0
    from hmi_marl.envs.alerts import Fatigue
    from hmi_marl.envs.config import TeamConfig
    from hmi_marl.envs.drivers import (
        DRIVERS,
        Choice,
        Driver,
        DriverList,
        TraitDistributions,
        Uniform,
    )
    from hmi_marl.envs.rewards import RewardWeights
    from hmi_marl.envs.scene import Scene
    from hmi_marl.envs.seats import Policy
    from hmi_marl.exact import oracle
    from hmi_marl.training.ppo.run import train
    from hmi_marl.training.protocols.alternating import Alternating
    from hmi_marl.training.protocols.fine_tune import FineTune
    from hmi_marl.training.protocols.joint import Joint, Simultaneous
    from hmi_marl.training.protocols.two_stage import TwoStage

__version__ = "0.2.0"

__all__ = [
    "DRIVERS",
    "Alternating",
    "Choice",
    "Driver",
    "DriverList",
    "Fatigue",
    "FineTune",
    "Joint",
    "Policy",
    "RewardWeights",
    "Scene",
    "Simultaneous",
    "TeamConfig",
    "TraitDistributions",
    "TwoStage",
    "Uniform",
    "__version__",
    "collect",
    "load_policy",
    "make_driver_policy",
    "make_hmi",
    "make_vec",
    "merge_v0",
    "oracle",
    "play",
    "train",
]

_HOMES = {
    "DRIVERS": "envs.drivers",
    "Alternating": "training.protocols.alternating",
    "Choice": "envs.drivers",
    "Driver": "envs.drivers",
    "DriverList": "envs.drivers",
    "Fatigue": "envs.alerts",
    "FineTune": "training.protocols.fine_tune",
    "Joint": "training.protocols.joint",
    "Policy": "envs.seats",
    "RewardWeights": "envs.rewards",
    "Scene": "envs.scene",
    "Simultaneous": "training.protocols.joint",
    "TeamConfig": "envs.config",
    "TraitDistributions": "envs.drivers",
    "TwoStage": "training.protocols.two_stage",
    "Uniform": "envs.drivers",
    "collect": "demonstrations.recording",
    "load_policy": "agents.learned.policy",
    "make_driver_policy": "agents.catalogue",
    "make_hmi": "agents.catalogue",
    "make_vec": "agents.partners",
    "merge_v0": "envs.merge_v0",
    "oracle": "exact.oracle",
    "play": "agents.rollout",
    "train": "training.ppo.run",
}
"""Module below this package that defines each public name, or that the name is."""


def register_envs() -> None:
    """Register the environments with Gymnasium and PettingZoo, if they are not registered yet.

    Also the entry point of the group ``gymnasium.envs``, for programs that load such plugins.
    """
    merge = "hmi_marl/merge-v0"
    # register() came with PettingZoo 1.27; AgileRL wants an older one.
    if hasattr(pettingzoo, "register") and merge not in pettingzoo.aec_registry:
        pettingzoo.register("aec", merge, "hmi_marl.envs.merge_v0:env")
        pettingzoo.register("parallel", merge, "hmi_marl.envs.merge_v0:parallel_env")
    for seat, make in (("MergeDriver", "merge_driver"), ("MergeHMI", "merge_hmi")):
        if f"hmi_marl/{seat}-v0" not in registration.registry:
            registration.register(f"hmi_marl/{seat}-v0", f"hmi_marl.agents.partners:{make}")


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module = importlib.import_module(f"{__name__}.{_HOMES[name]}")
    value = module if _HOMES[name].endswith(f".{name}") else getattr(module, name)
    globals()[name] = value  # found without this function from now on
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


register_envs()
