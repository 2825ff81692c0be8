"""How fast is it, side by side in one run: highway-env, the batched world, the whole team step.

Every contestant drives the same scene with as many vehicles, by the same mix of actions, and begins
a new episode after a crash or 20 s; resets are counted in. Each is measured for a while in turn,
several rounds over, after a warm-up, and the median round counts.
"""

from __future__ import annotations

import importlib.util
import os
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from hmi_marl.envs.config import DRIVER, VEHICLE_AI, TeamConfig
from hmi_marl.envs.scene import Scene, draw_start
from hmi_marl.envs.teaming import Teaming
from hmi_marl.envs.worlds.batched import BatchedWorld
from hmi_marl.experiments.speed_config import BenchConfig

MIX = (1, 1, 1, 3, 4)
"""Actions drawn from: mostly keep_speed, some speed_up and slow_down."""
SCALING_TEAMS = 1024

Run = Callable[[float], float]
"""Runs for about so many seconds and tells how many steps a second it made."""


@dataclass(frozen=True)
class Measured:
    """One contestant's speed."""

    name: str
    teams: int
    threads: int
    vehicles: int
    steps_per_s: float
    ratio: float
    """To highway-env in one process in the same run, with as many vehicles as the bench has."""
    bytes_per_team: int | None


@dataclass(frozen=True)
class _Contestant:
    name: str
    teams: int
    threads: int
    vehicles: int
    run: Run
    bytes_per_team: int | None = None


def bench(config: BenchConfig, progress: Callable[[int], Any] = id) -> list[Measured]:
    """Measure everybody in turns.

    Raises:
        ValueError: a number in ``config`` that is not positive, or more threads than there are.

    Args:
        config: what to measure.
        progress: called with 1 after each of :func:`measurements`.
    """
    config.check()
    with ExitStack() as stack:
        contestants = list(_contestants(config, stack))
        speeds = np.zeros((config.rounds, len(contestants)))
        for contestant in contestants:
            contestant.run(0.1)
        for turn in range(config.rounds):
            for k, contestant in enumerate(contestants):
                speeds[turn, k] = contestant.run(config.seconds)
                progress(1)
    ratios = np.median(speeds / speeds[:, :1], axis=0)
    return [
        Measured(
            name=contestant.name,
            teams=contestant.teams,
            threads=contestant.threads,
            vehicles=contestant.vehicles,
            steps_per_s=float(speed),
            ratio=float(ratio),
            bytes_per_team=contestant.bytes_per_team,
        )
        for contestant, speed, ratio in zip(
            contestants, np.median(speeds, axis=0), ratios, strict=True
        )
    ]


def measurements(config: BenchConfig) -> int:
    """How many measurements a bench of this configuration takes."""
    threads = len(_thread_counts(config))
    envpool = int(importlib.util.find_spec("envpool") is not None)
    each = 2 + envpool + 2 * threads * len(config.teams) + len(config.scaling)
    return config.rounds * each


def _thread_counts(config: BenchConfig) -> tuple[int, ...]:
    return config.threads or tuple(sorted({1, os.cpu_count() or 1}))


def _scene(vehicles: int) -> Scene:
    return Scene(vehicles=vehicles).fitted(20.0)


def _contestants(config: BenchConfig, stack: ExitStack) -> Iterator[_Contestant]:
    vehicles, scene = config.vehicles, _scene(config.vehicles)
    threads = _thread_counts(config)
    yield _Contestant("highway-env, one process", 1, 1, vehicles, _highway_env(scene))
    cores = os.cpu_count() or 1
    yield _Contestant(
        "highway-env, AsyncVectorEnv", cores, cores, vehicles, _async_highway_env(scene, stack)
    )
    if importlib.util.find_spec("envpool") is not None:
        yield _Contestant("EnvPool Merge-v0 (5 vehicles, no lidar)", 64, 1, 5, _envpool(64))
    for teams in config.teams:
        for count in threads:
            world = BatchedWorld(scene, teams, count)
            yield _Contestant(
                "batched world alone", teams, count, vehicles, _world(world), world.bytes_per_world
            )
            yield _Contestant("whole team step", teams, count, vehicles, _team(scene, teams, count))
    for number in config.scaling:
        world = BatchedWorld(_scene(number), SCALING_TEAMS, threads[-1])
        yield _Contestant(
            "growth with vehicles",
            SCALING_TEAMS,
            threads[-1],
            number,
            _world(world),
            world.bytes_per_world,
        )


def _repeat(step: Callable[[], int], seconds: float) -> float:
    """Steps a second, where ``step`` tells how many steps it took."""
    start, taken = time.perf_counter(), 0
    while (spent := time.perf_counter() - start) < seconds:
        taken += step()
    return taken / spent


def _highway_env(scene: Scene) -> Run:
    """highway-env's own step with its own lidar."""
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

    return lambda seconds: _repeat(step, seconds)


def _async_highway_env(scene: Scene, stack: ExitStack) -> Run:
    """highway-env's registered environment in a process for each core."""
    from functools import partial

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

    return lambda seconds: _repeat(step, seconds)


def _envpool(teams: int) -> Run:
    import envpool

    env = envpool.make("Merge-v0", env_type="gymnasium", num_envs=teams, num_threads=1)
    env.reset()
    rng = np.random.default_rng(0)

    def step() -> int:
        env.step(rng.choice(MIX, teams))
        return teams

    return lambda seconds: _repeat(step, seconds)


def _world(world: BatchedWorld) -> Run:
    """Physics, one lidar and resets."""
    count, horizon = world.num_worlds, round(20 * world.scene.policy_frequency)
    everybody, inflation = np.ones(count, np.bool_), np.ones(count)
    rng = np.random.default_rng(0)
    actions = rng.choice(MIX, (64, count))
    steps, seeds, turn = np.zeros(count, np.int64), np.arange(count, dtype=np.uint64), 0
    world.reset(seeds, inflation, everybody)

    def step() -> int:
        nonlocal steps, seeds, turn
        world.step(actions[turn % len(actions)], everybody)
        world.lidar(inflated=False)
        turn, steps = turn + 1, steps + 1
        over = world.ego().crashed | (steps >= horizon)
        if over.any():
            seeds = np.where(over, seeds + np.uint64(count), seeds)
            steps = np.where(over, 0, steps)
            world.reset(seeds, inflation, over)
        return count

    return lambda seconds: _repeat(step, seconds)


def _team(scene: Scene, count: int, threads: int) -> Run:
    """Chain, rewards, both seats' observations, taking turns, and resets."""
    config = TeamConfig(driver=["lisa", "marge", "bart", "homer"], scene=scene)
    teams = Teaming(config, count, BatchedWorld(config.scene, count, threads))
    rng = np.random.default_rng(0)
    actions, alerts = rng.choice(MIX, (64, count)), rng.integers(0, 2, (64, count))
    seeds, turn = np.arange(count, dtype=np.uint64), 0
    teams.reset(seeds)

    def step() -> int:
        nonlocal seeds, turn
        teams.observe(DRIVER)
        teams.intend(actions[turn % len(actions)])
        teams.observe(VEHICLE_AI)
        teams.step(alerts[turn % len(alerts)])
        turn += 1
        if teams.over.any():
            seeds = np.where(teams.over, seeds + np.uint64(count), seeds)
            teams.reset(seeds, teams.over.copy())
        return count

    return lambda seconds: _repeat(step, seconds)


def as_text(rows: list[Measured]) -> str:
    """A table for people."""
    lines = [
        f"{'':<40}{'teams':>7}{'threads':>9}{'vehicles':>10}{'steps/s':>12}{'ratio':>9}{'kB/team':>9}"
    ]
    for row in rows:
        size = "-" if row.bytes_per_team is None else f"{row.bytes_per_team / 1000:.1f}"
        lines.append(
            f"{row.name:<40}{row.teams:>7}{row.threads:>9}{row.vehicles:>10}"
            f"{row.steps_per_s:>12,.0f}{row.ratio:>9,.1f}{size:>9}"
        )
    return "\n".join(lines)


def as_json(config: BenchConfig, rows: list[Measured]) -> dict[str, Any]:
    """JSON content."""
    return {"config": asdict(config), "rows": [asdict(row) for row in rows]}
