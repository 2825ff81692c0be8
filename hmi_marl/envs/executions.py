"""Choice of the way to take steps."""

from __future__ import annotations

from hmi_marl.envs.execution import Execution, InNumPy
from hmi_marl.envs.team_arrays import Rules
from hmi_marl.envs.worlds import World

FEW = 16
"""Teams below which a world that is not compiled is not worth compiling loops for."""


def execution_for(world: World, num_teams: int, rules: Rules) -> Execution:
    """Return the way to take steps that suits a world and a number of teams."""
    if num_teams < FEW and not is_batched(world):
        return InNumPy(world, rules)
    from hmi_marl.envs.loops import InLoops, InOneLoop  # numba is slow to import

    if is_batched(world):
        return InOneLoop(world, rules)  # type: ignore[arg-type]
    return InLoops(world, rules)


def is_batched(world: World) -> bool:
    """Whether this is the batched world itself: the methods of a subclass are to be called."""
    module, name = type(world).__module__, type(world).__name__
    return (module, name) == ("hmi_marl.envs.worlds.batched.world", "BatchedWorld")
