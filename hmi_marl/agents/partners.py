"""Environments of one seat in which a partner, given by name or as a Policy, takes the other seat.

A Policy remembers what it saw: give each environment its own.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hmi_marl.agents.catalogue import make_driver_policy, make_hmi
from hmi_marl.agents.memory import Memoryless
from hmi_marl.checks import COUNT
from hmi_marl.envs.config import DRIVER, VEHICLE_AI, TeamConfig, takes_team_settings
from hmi_marl.envs.seats import Policy
from hmi_marl.envs.single import MergeDriver, MergeHMI, as_scalar
from hmi_marl.envs.teaming import Teaming
from hmi_marl.envs.worlds import World, make_world
from hmi_marl.extras import needing

if TYPE_CHECKING:
    import torch

    from hmi_marl.envs.groups import Seat
    from hmi_marl.envs.vector import TeamVecEnv

_PARTNERS = {DRIVER: (make_hmi, "never"), VEHICLE_AI: (make_driver_policy, "rule")}
"""By the seat that learns: how the partner is made, and which one by default."""
Partner = str | Policy | Callable[[NDArray[np.float32]], Any]


class FunctionPolicy(Memoryless):
    """Policy of a plain function from one observation, shape (D,), to an action."""

    def __init__(self, function: Callable[[NDArray[np.float32]], Any]) -> None:
        self._function = function

    def act(self, observations: NDArray[np.float32]) -> NDArray[Any]:
        """See :meth:`hmi_marl.envs.seats.Policy.act`; the environment checks the action."""
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
    """Make "hmi_marl/MergeDriver-v0", the driver's seat with an HMI as the partner."""
    config = TeamConfig(**settings)
    return MergeDriver(_as_policy(partner, make_hmi, config), config, world, render_mode)


@takes_team_settings
def merge_hmi(
    partner: Partner = "rule",
    world: str | World = "highway",
    render_mode: str | None = None,
    **settings: Any,
) -> MergeHMI:
    """Make "hmi_marl/MergeHMI-v0", the vehicle AI's seat with a driver as the partner."""
    config = TeamConfig(**settings)
    return MergeHMI(_as_policy(partner, make_driver_policy, config), config, world, render_mode)


# Gymnasium looks for it on the class to add its wrappers for other render modes.
merge_driver.metadata = MergeDriver.metadata  # type: ignore[attr-defined]
merge_hmi.metadata = MergeHMI.metadata  # type: ignore[attr-defined]


def make_vec(
    num_teams: int,
    seat: Seat = "driver",
    partner: str | Policy | None = None,
    world: str | World = "batched",
    seed: int = 0,
    device: str | torch.device = "cpu",
    threads: int | None = None,
    sequential: bool = True,
    **settings: Any,
) -> TeamVecEnv:
    """Make N teams as an rsl_rl ``VecEnv``; see :mod:`hmi_marl.envs.vector`.

    Args:
        num_teams: N.
        seat: the acting seat: "driver", "vehicle_ai" or "team" (both, in columns a^H and a^A).
        partner: policy of the other seat, by its name in :mod:`hmi_marl.agents.catalogue` or as a
            Policy; by default "never" for the driver, "rule" for the vehicle AI, none for the team.
        seed: team k plays the series of episodes of ``team_seed(seed, k)``
            (:mod:`hmi_marl.envs.streams`).
        device: device of the returned tensors.
        threads: threads of the batched world; all cores by default. On a busy machine one thread
            can be faster than two.
        sequential: False for seat "vehicle_ai" if the partner is to drive at the same time, so that
            the vehicle AI sees a^H_{t-1}.
        settings: fields of :class:`hmi_marl.envs.config.TeamConfig`.

    Raises:
        ValueError, TypeError: a value out of its range; the message says what to use instead.
        ModuleNotFoundError: torch or rsl_rl is not installed.

    >>> env = make_vec(2, seat="driver", world="highway", driver="bart")
    >>> env.num_actions, env.action_sizes, env.get_observations()["driver"].shape
    (1, (5,), torch.Size([2, 52]))
    """
    with needing("make_vec"):
        from hmi_marl.envs.vector import TeamVecEnv

    config, num_teams = TeamConfig(**settings), COUNT("num_teams", num_teams)
    name = None
    if seat in _PARTNERS:
        by_name, default = _PARTNERS[seat]
        partner = default if partner is None else partner
        if isinstance(partner, str):
            name, partner = partner, by_name(partner, config)
    elif isinstance(partner, str):
        raise ValueError(f"seat={seat!r} has no partner, but got {partner!r}")
    driven = (
        make_world(world, config.scene, num_teams, threads) if isinstance(world, str) else world
    )
    teaming = Teaming(config, num_teams, driven)
    env = TeamVecEnv(teaming, seat, partner, seed, device, sequential=sequential)
    env.cfg["partner"] = name if name is not None else env.cfg["partner"]
    env.cfg["world"] = world if isinstance(world, str) else env.cfg["world"]
    return env
