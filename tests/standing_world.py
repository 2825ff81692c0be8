"""A world in which nothing moves, so that thousands of teams cost nothing."""

import numpy as np

from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.scene import Scene
from hmi_marl.envs.streams import uniform
from hmi_marl.envs.teaming import Teaming
from hmi_marl.envs.worlds.base import Ego, Snapshot


class StandingWorld:
    """N cars that never move, and crash where ``crash_next`` is set. Implements World."""

    def __init__(self, scene: Scene, num_worlds: int) -> None:
        self.scene, self.num_worlds = scene, num_worlds
        self.crashed = np.zeros(num_worlds, np.bool_)
        self.crash_next = np.zeros(num_worlds, np.bool_)
        self.speed = np.full(num_worlds, 15.0)
        self.actions: list[np.ndarray] = []
        self.moved: list[np.ndarray] = []

    def reset(self, seeds, inflation, which):
        self.crashed = self.crashed & ~which
        self.speed = np.where(which, 15.0, self.speed)

    def step(self, actions, which):
        self.actions.append(actions.copy())
        self.moved.append(which.copy())
        self.crashed = self.crashed | (which & self.crash_next)

    def halt(self, which):
        self.speed = np.where(which, 0.0, self.speed)

    def perceive(self, inflation, which):
        pass  # there is nothing to see

    def ego(self):
        zeros = np.zeros(self.num_worlds)
        return Ego(
            x=zeros,
            y=zeros,
            heading=zeros,
            speed=self.speed.copy(),
            target_speed=zeros + 30.0,
            lane=np.full(self.num_worlds, self.scene.lanes - 1),
            lateral=zeros,
            crashed=self.crashed.copy(),
            gap=zeros + 30.0,
            merging_slowness=zeros + 0.25,
        )

    def lidar(self, inflated):
        shape = (self.num_worlds, self.scene.lidar_cells, 2)
        return np.full(shape, self.scene.lidar_range, np.float32)

    def snapshot(self, world):
        return Snapshot(
            0.0, np.zeros((1, 2)), np.zeros(1), np.zeros(1), np.zeros(1, bool), np.zeros((0, 2))
        )


class CrashingWorld(StandingWorld):
    """Every car that moves crashes with probability 0.1, by its own seed and step."""

    def __init__(self, scene, num_worlds):
        super().__init__(scene, num_worlds)
        self.seeds, self.steps = np.zeros((2, num_worlds), np.uint64)

    def reset(self, seeds, inflation, which):
        super().reset(seeds, inflation, which)
        self.seeds = np.where(which, seeds, self.seeds)
        self.steps = np.where(which, 0, self.steps).astype(np.uint64)

    def step(self, actions, which):
        self.crash_next = uniform(self.seeds, 99, self.steps) < 0.1
        self.steps += which.astype(np.uint64)
        super().step(actions, which)


def standing_teams(num_teams: int, **settings) -> Teaming:
    """Teams in cars that never move."""
    config = TeamConfig(**settings)
    return Teaming(config, num_teams, StandingWorld(config.scene, num_teams))
