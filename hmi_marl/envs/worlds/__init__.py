"""Worlds: roads, traffic and lidar.

``highway`` is highway-env itself, the reference; ``batched`` the same, compiled, for thousands of
teams. A custom world is an object with the methods of :class:`World`.
"""

from __future__ import annotations

from hmi_marl.checks import COUNT, WORKERS
from hmi_marl.envs.scene import Scene
from hmi_marl.envs.worlds.base import VEHICLE_ACTIONS, Ego, Snapshot, World
from hmi_marl.registry import unknown

WORLDS = ("highway", "batched")

__all__ = [
    "VEHICLE_ACTIONS",
    "WORLDS",
    "Ego",
    "Snapshot",
    "World",
    "check_world",
    "fitting_world",
    "make_world",
]


def check_world(world: str) -> str:
    """Return ``world`` if it is a known world's name, or raise ValueError naming the nearest."""
    if world not in WORLDS:
        raise ValueError(unknown("world", world, WORLDS, "hmi_marl.envs.worlds"))
    return world


def make_world(world: str, scene: Scene, num_worlds: int, threads: int | None = None) -> World:
    """Build ``num_worlds`` scenes in the world of this name.

    Args:
        world: "highway" or "batched".
        scene: fitted to the episode's duration.
        num_worlds: N.
        threads: that the batched world shares its worlds among; all cores by default.

    Raises:
        ValueError, TypeError: unknown world, a number out of its range, or more threads than there
            are.
    """
    num_worlds = COUNT("num_worlds", num_worlds)
    threads = None if threads is None else WORKERS("threads", threads)
    if check_world(world) == "highway":
        from hmi_marl.envs.worlds.highway import HighwayWorld  # highway-env is slow to import

        return HighwayWorld(scene, num_worlds)
    from hmi_marl.envs.worlds.batched import BatchedWorld  # numba is slow to import

    return BatchedWorld(scene, num_worlds, threads)


def fitting_world(world: str | World, scene: Scene, num_teams: int) -> World:
    """Return a world for N teams, made by its name or given, or raise if it does not fit them."""
    if isinstance(world, str):
        return make_world(world, scene, num_teams)
    if not (hasattr(world, "scene") and hasattr(world, "num_worlds")):
        raise TypeError(f"world= takes a world's name or a World, not {world!r}")
    if world.num_worlds != num_teams:
        raise ValueError(f"num_teams = {num_teams}, but the world has {world.num_worlds} scenes")
    if world.scene != scene:
        raise ValueError(f"the world's scene is not the team's; make it with config.scene, {scene}")
    return world
