"""What takes part in a bench: each a function that runs for a while and returns its steps/s."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hmi_marl.agents.partners import make_vec
from hmi_marl.envs.config import DRIVER, VEHICLE_AI, TeamConfig
from hmi_marl.envs.scene import Scene, draw_start
from hmi_marl.envs.teaming import Teaming

if TYPE_CHECKING:
    from hmi_marl.envs.groups import Seat
    from hmi_marl.envs.vector import TeamVecEnv
    from hmi_marl.envs.worlds.batched import BatchedWorld

MIX = (1, 1, 1, 3, 4)
"""Actions to draw from: mostly keep_speed, some speed_up and slow_down."""
Run = Callable[[float], float]
"""Runs for about so many seconds and returns its steps per second."""


def repeat(step: Callable[[], int], seconds: float) -> float:
    """Return the steps per second of ``step``, which returns the number of steps it took."""
    start, taken = perf_counter(), 0
    while (spent := perf_counter() - start) < seconds:
        taken += step()
    return taken / spent


def highway_env(scene: Scene) -> Run:
    """Run highway-env's own step with its own lidar."""
    from hmi_marl.envs.worlds.highway import MergeScene

    env = MergeScene(scene)
    env.configure({"observation": {"type": "LidarObservation"}})
    env.define_spaces()
    rng = np.random.default_rng(0)
    state = {"seed": 0, "left": 0}

    def step() -> int:
        if state["left"] == 0 or env.vehicle.crashed:
            env.restart(draw_start(scene, state["seed"]))
            env.define_spaces()
            state["seed"] += 1
            state["left"] = round(20 * scene.policy_frequency)
        env.step(int(rng.choice(MIX)))
        state["left"] -= 1
        return 1

    return lambda seconds: repeat(step, seconds)


def async_highway_env(scene: Scene, stack: ExitStack) -> Run:
    """Run highway-env's registered environment in a process for each core."""
    import gymnasium

    from hmi_marl.envs.worlds.highway import highway_config

    settings = highway_config(scene) | {
        "vehicles_count": scene.vehicles,
        "observation": {"type": "LidarObservation"},
    }
    make = partial(gymnasium.make, "highway_env:merge-generic-v1", config=settings)
    env = gymnasium.vector.AsyncVectorEnv([make] * (os.cpu_count() or 1), context="spawn")
    stack.callback(env.close)
    env.reset(seed=0)
    rng = np.random.default_rng(0)

    def step() -> int:
        env.step(rng.choice(MIX, env.num_envs))
        return env.num_envs

    return lambda seconds: repeat(step, seconds)


def envpool(teams: int) -> Run:
    """Run EnvPool's merge, whose step is another one: five vehicles and no lidar."""
    import envpool

    env = envpool.make("Merge-v0", env_type="gymnasium", num_envs=teams, num_threads=1)
    env.reset()
    rng = np.random.default_rng(0)

    def step() -> int:
        env.step(rng.choice(MIX, teams))
        return teams

    return lambda seconds: repeat(step, seconds)


def world_alone(world: BatchedWorld) -> Run:
    """Run physics, one lidar and resets."""
    count, horizon = world.num_worlds, round(20 * world.scene.policy_frequency)
    every, inflation = np.ones(count, np.bool_), np.ones(count)
    rng = np.random.default_rng(0)
    actions = rng.choice(MIX, (64, count))
    steps, seeds, turn = np.zeros(count, np.int64), np.arange(count, dtype=np.uint64), 0
    world.reset(seeds, inflation, every)

    def step() -> int:
        nonlocal steps, seeds, turn
        world.step(actions[turn % len(actions)], every)
        world.lidar(inflated=False)
        turn, steps = turn + 1, steps + 1
        over = world.ego().crashed | (steps >= horizon)
        if over.any():
            seeds = np.where(over, seeds + np.uint64(count), seeds)
            steps = np.where(over, 0, steps)
            world.reset(seeds, inflation, over)
        return count

    return lambda seconds: repeat(step, seconds)


def whole_team_step(config: TeamConfig, count: int, threads: int) -> tuple[Run, int]:
    """Run the whole team step, sequentially: chain, rewards, both observations, and resets.

    Also returns the memory that a team takes [bytes].
    """
    from hmi_marl.envs.worlds.batched import BatchedWorld

    teams = Teaming(config, count, BatchedWorld(config.scene, count, threads))
    rng = np.random.default_rng(0)
    actions, alerts = rng.choice(MIX, (64, count)), rng.integers(0, 2, (64, count))
    seeds, turn = np.arange(count, dtype=np.uint64), 0
    teams.reset(seeds)

    def step() -> int:
        nonlocal seeds, turn
        intended, alert = actions[turn % len(actions)], alerts[turn % len(alerts)]
        teams.turn(lambda seen: intended, lambda seen: alert)
        turn += 1
        over = teams.over
        if over.any():
            seeds = np.where(over, seeds + np.uint64(count), seeds)
            teams.reset(seeds, over)
        return count

    return partial(repeat, step), teams.bytes_per_team


@dataclass(frozen=True)
class Drive:
    """What the cars of a vector environment did, step by step, to be driven again."""

    begins: tuple[NDArray[np.uint64], NDArray[np.float64]]
    """Seeds and inflations of the first episodes, shape (N,) each."""
    steps: list[tuple[NDArray[np.int64], NDArray[np.bool_], Any, Any]]
    """Of each step v, which episodes ended in it, and seeds and inflations after it."""


def vector_environment(
    config: TeamConfig, count: int, threads: int, seat: Seat, groups: tuple[str, ...], steps: int
) -> tuple[Run, Drive]:
    """Run a vector environment with given actions; also return what it drives.

    Args:
        config: settings of the teams.
        count: N.
        threads: of the batched world.
        seat: that acts; a driver's HMI never alerts.
        groups: observations that are computed.
        steps: after so many the environment is reset and takes the same steps again.
    """
    import torch

    rng = np.random.default_rng(0)
    env = make_vec(count, seat, threads=threads, **vars(config))
    env.groups = groups
    choices = {DRIVER: MIX, VEHICLE_AI: range(config.alerts.choices)}
    actions = [
        torch.from_numpy(np.stack([rng.choice(choices[a], count) for a in env.agents], axis=1))
        for _ in range(steps)
    ]
    driven = _record(env, actions)
    turn = 0

    def step() -> int:
        nonlocal turn
        if turn == 0:
            env.reset(0)
        env.step(actions[turn])
        turn = (turn + 1) % steps
        return count

    return partial(repeat, step), driven


def _record(env: TeamVecEnv, actions: list[Any]) -> Drive:
    env.reset(0)
    teams = env.teaming
    begins, steps = (teams.seeds, teams.traits.inflation), []
    for action in actions:
        _, _, dones, _ = env.step(action)
        applied = np.maximum(teams.applied, 1)  # a team that has just begun keeps its speed
        steps.append((applied, dones.numpy() == 1, teams.seeds, teams.traits.inflation))
    return Drive(begins, steps)


def world_with_lidars(
    scene: Scene, count: int, threads: int, drive: Drive, inflated: tuple[bool, ...]
) -> Run:
    """Run the batched world through a drive, with the lidars that are read, and resets."""
    from hmi_marl.envs.worlds.batched import BatchedWorld

    world, every = BatchedWorld(scene, count, threads), np.ones(count, np.bool_)
    turn = 0

    def step() -> int:
        nonlocal turn
        if turn == 0:
            world.reset(*drive.begins, every)
        applied, ended, seeds, inflation = drive.steps[turn]
        world.step(applied, every)
        for each in inflated:
            world.lidar(each)
        world.ego()
        if ended.any():
            world.reset(seeds, inflation, ended)
        turn = (turn + 1) % len(drive.steps)
        return count

    return partial(repeat, step)
