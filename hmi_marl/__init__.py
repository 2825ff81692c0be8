"""hmi-marl: a distractible driver and the HMI that may alert them, as two agents in one car.

>>> from hmi_marl import merge_v0
>>> env = merge_v0.env(driver="homer")
>>> env.possible_agents
['driver', 'vehicle_ai']

Importing this package registers ``hmi_marl/merge-v0`` with PettingZoo (AEC and parallel) and
``hmi_marl/MergeDriver-v0`` and ``hmi_marl/MergeHMI-v0`` with Gymnasium. Its names are imported when
they are first used.
"""

import importlib
from typing import TYPE_CHECKING, Any

import pettingzoo
from gymnasium.envs import registration

if TYPE_CHECKING:
    from hmi_marl.agents.vectors import make_vec
    from hmi_marl.envs import merge_v0
    from hmi_marl.envs.alerts import Fatigue
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

__version__ = "0.1.0"

__all__ = [
    "DRIVERS",
    "Choice",
    "Driver",
    "DriverList",
    "Fatigue",
    "RewardWeights",
    "Scene",
    "TraitDistributions",
    "Uniform",
    "__version__",
    "make_vec",
    "merge_v0",
]

_HOMES = {
    "DRIVERS": "envs.drivers",
    "Choice": "envs.drivers",
    "Driver": "envs.drivers",
    "DriverList": "envs.drivers",
    "Fatigue": "envs.alerts",
    "RewardWeights": "envs.rewards",
    "Scene": "envs.scene",
    "TraitDistributions": "envs.drivers",
    "Uniform": "envs.drivers",
    "make_vec": "agents.vectors",
    "merge_v0": "envs.merge_v0",
}
"""Where each public name is defined, a module below this package."""


def register_envs() -> None:
    """Register the environments with Gymnasium and PettingZoo; again does nothing.

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
    value = module if name == "merge_v0" else getattr(module, name)
    globals()[name] = value  # found without this function from now on
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


register_envs()
