"""Choice of the way to take steps."""

from __future__ import annotations

from hmi_marl.envs.execution import Execution, InNumPy
from hmi_marl.envs.team_arrays import Rules
from hmi_marl.envs.worlds import World

FEW = 16
"""Teams below which a world that is not compiled is not worth compiling loops for."""


def execution_for(world: World, num_teams: int, rules: Rules) -> Execution:
    """Return the way to take steps that suits a world and a number of teams."""
    batched = hasattr(world, "take_step")
    if num_teams < FEW and not batched:
        return InNumPy(world, rules)
    from hmi_marl.envs.loops import InLoops, InOneLoop  # numba is slow to import

    return InOneLoop(world, rules) if batched else InLoops(world, rules)  # type: ignore[arg-type]
