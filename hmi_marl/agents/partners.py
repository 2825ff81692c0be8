"""The Gymnasium seats with a partner given by name, as a Policy, or as a plain function.

A Policy remembers what it saw: give each environment one of its own.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hmi_marl.agents.catalogue import make_driver_policy, make_hmi
from hmi_marl.agents.memory import Memoryless
from hmi_marl.envs.config import TeamConfig, takes_team_settings
from hmi_marl.envs.seats import Policy
from hmi_marl.envs.single import as_scalar
from hmi_marl.envs.views import MergeDriver, MergeHMI
from hmi_marl.envs.worlds import World

Partner = str | Policy | Callable[[NDArray[np.float32]], Any]


class FunctionPolicy(Memoryless):
    """A plain function from one observation, shape (D,), to an action, in a seat."""

    def __init__(self, function: Callable[[NDArray[np.float32]], Any]) -> None:
        self._function = function

    def act(self, observations: NDArray[np.float32]) -> NDArray[Any]:
        """See :meth:`hmi_marl.envs.seats.Policy.act`; the seat checks what the function gave."""
        return np.array([as_scalar(self._function(one)) for one in observations]).reshape(-1)


def _as_policy(
    partner: Partner, by_name: Callable[[str, TeamConfig], Policy], config: TeamConfig
) -> Policy:
    if isinstance(partner, str):
        return by_name(partner, config)
    if not isinstance(partner, type):
        if isinstance(partner, Policy):
            return partner
        if callable(partner):
            return FunctionPolicy(partner)
    raise TypeError(f"partner= takes a name, a Policy object or a function, not {partner!r}")


@takes_team_settings
def merge_driver(
    partner: Partner = "never",
    world: str | World = "highway",
    render_mode: str | None = None,
    **settings: Any,
) -> MergeDriver:
    """The driver's seat with an HMI given: "hmi_marl/MergeDriver-v0"."""
    config = TeamConfig(**settings)
    return MergeDriver(_as_policy(partner, make_hmi, config), config, world, render_mode)


@takes_team_settings
def merge_hmi(
    partner: Partner = "rule",
    world: str | World = "highway",
    render_mode: str | None = None,
    **settings: Any,
) -> MergeHMI:
    """The vehicle AI's seat with a driver given: "hmi_marl/MergeHMI-v0"."""
    config = TeamConfig(**settings)
    return MergeHMI(_as_policy(partner, make_driver_policy, config), config, world, render_mode)


# As Gymnasium finds it on a class, so that it can add its own wrappers for other render modes.
merge_driver.metadata = MergeDriver.metadata  # type: ignore[attr-defined]
merge_hmi.metadata = MergeHMI.metadata  # type: ignore[attr-defined]
