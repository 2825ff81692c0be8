"""Worlds: where the cars drive. ``highway`` is highway-env itself, the reference."""

from __future__ import annotations

from hmi_marl.envs.scene import Scene
from hmi_marl.envs.worlds.base import VEHICLE_ACTIONS, Ego, Snapshot, World

WORLDS = ("highway",)

__all__ = ["VEHICLE_ACTIONS", "WORLDS", "Ego", "Snapshot", "World", "make_world"]


def make_world(world: str, scene: Scene, num_worlds: int) -> World:
    """Build ``num_worlds`` scenes in the world of this name.

    Raises:
        ValueError: unknown world.
    """
    if world == "highway":
        from hmi_marl.envs.worlds.highway import HighwayWorld  # highway-env is slow to import

        return HighwayWorld(scene, num_worlds)
    raise ValueError(f"unknown world {world!r}; known worlds: {', '.join(WORLDS)}")
