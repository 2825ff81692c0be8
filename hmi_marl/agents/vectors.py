"""Many teams at once for rsl_rl, with the partner given by name or as a Policy."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from hmi_marl.agents.catalogue import make_driver_policy, make_hmi
from hmi_marl.envs.config import DRIVER, VEHICLE_AI, TeamConfig
from hmi_marl.envs.seats import Policy
from hmi_marl.envs.teaming import Teaming
from hmi_marl.envs.worlds import World, make_world
from hmi_marl.extras import needing

if TYPE_CHECKING:
    import torch

    from hmi_marl.envs.vector import Seat, TeamVecEnv

_PARTNERS = {DRIVER: (make_hmi, "never"), VEHICLE_AI: (make_driver_policy, "rule")}
"""By the seat that learns: who sits in the other one, and who does if nobody is named."""


def make_vec(
    num_teams: int,
    seat: Seat = "driver",
    partner: str | Policy | None = None,
    world: str | World = "batched",
    seed: int = 0,
    device: str | torch.device = "cpu",
    threads: int | None = None,
    **settings: Any,
) -> TeamVecEnv:
    """N teams as an rsl_rl ``VecEnv``; see :mod:`hmi_marl.envs.vector`.

    Args:
        num_teams: N.
        seat: who acts: "driver", "vehicle_ai" or "team" (both at once, columns a^H and a^A).
        partner: in the other seat, a name that :mod:`hmi_marl.agents.catalogue` knows or a Policy.
            None: "never" beside the driver, "rule" beside the vehicle AI, nobody beside the team.
        world: which world the teams drive in.
        seed: team k plays the series of episodes of ``seed + k``.
        device: where tensors are handed out.
        threads: that the batched world shares its teams among; all cores by default. A busy
            neighbour can make one thread faster than two.
        settings: of the teams, the fields of :class:`hmi_marl.envs.config.TeamConfig`.

    Raises:
        ValueError, TypeError: something out of its range, saying what to use instead.
        ModuleNotFoundError: torch or rsl_rl is not installed.

    >>> env = make_vec(2, seat="driver", world="highway", driver="bart")
    >>> env.num_actions, env.action_sizes, env.get_observations()["driver"].shape
    (1, (5,), torch.Size([2, 52]))
    """
    with needing("make_vec"):
        from hmi_marl.envs.vector import TeamVecEnv

    config = TeamConfig(**settings)
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
    env = TeamVecEnv(Teaming(config, num_teams, driven), seat, partner, seed, device)
    env.cfg["partner"] = name if name is not None else env.cfg["partner"]
    env.cfg["world"] = world if isinstance(world, str) else env.cfg["world"]
    return env
