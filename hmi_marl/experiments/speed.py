"""Speed of highway-env, the batched world and the whole team step, measured in one run.

Every contestant drives the same scene with as many vehicles, by the same mix of actions, and begins
a new episode after a crash or 20 s; resets are counted in. Each is measured for a while in turn,
several rounds over, after a warm-up, and the median round counts. numba is imported only then.
"""

from __future__ import annotations

import importlib.util
import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from hmi_marl.envs.config import DRIVER, VEHICLE_AI, TeamConfig
from hmi_marl.envs.scene import Scene, draw_start
from hmi_marl.envs.teaming import Teaming
from hmi_marl.reporting.blocks import Table
from hmi_marl.reporting.report import Report

if TYPE_CHECKING:
    from hmi_marl.envs.worlds.batched import BatchedWorld

MIX = (1, 1, 1, 3, 4)
"""Actions to draw from: mostly keep_speed, some speed_up and slow_down."""
SCALING_TEAMS = 1024

Run = Callable[[float], float]
"""Runs for about so many seconds and returns its steps per second."""


@dataclass(frozen=True)
class BenchConfig:
    """Settings of a bench."""

    teams: tuple[int, ...] = (1, 64, 1024, 4096)
    """Sizes of the batches."""
    threads: tuple[int, ...] = ()
    """Thread counts; one and all cores by default."""
    vehicles: int = 20
    """Vehicles in every scene, besides the driver's car and the one on the ramp."""
    scaling: tuple[int, ...] = (5, 10, 20, 40)
    """Numbers of vehicles that show how the cost grows."""
    seconds: float = 1.0
    """Duration of each measurement [s]."""
    rounds: int = 3
    """Turns of each contestant."""

    def check(self) -> None:
        """Raise ValueError where a number is not positive."""
        numbers = (*self.teams, *self.threads, self.vehicles, *self.scaling, self.seconds)
        if min(*numbers, self.rounds) <= 0 or not self.teams:
            raise ValueError("everything that a bench counts is positive")


@dataclass(frozen=True)
class Measured:
    """Speed of one contestant."""

    name: str
    teams: int
    threads: int
    vehicles: int
    steps_per_s: float
    ratio: float
    """Ratio to highway-env in one process in the same run, with the bench's number of vehicles."""
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
    """Measure all contestants in turns; ``progress`` is called after each of :func:`measurements`.

    Raises:
        ValueError: a number in ``config`` that is not positive, or more threads than there are.
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
    medians = np.median(speeds, axis=0)
    return [
        Measured(
            c.name, c.teams, c.threads, c.vehicles, float(speed), float(ratio), c.bytes_per_team
        )
        for c, speed, ratio in zip(contestants, medians, ratios, strict=True)
    ]


def measurements(config: BenchConfig) -> int:
    """Count the measurements that a bench takes."""
    threads = len(_thread_counts(config))
    envpool = int(importlib.util.find_spec("envpool") is not None)
    each = 2 + envpool + 2 * threads * len(config.teams) + len(config.scaling)
    return config.rounds * each


def _thread_counts(config: BenchConfig) -> tuple[int, ...]:
    return config.threads or tuple(sorted({1, os.cpu_count() or 1}))


def _scene(vehicles: int) -> Scene:
    return Scene(vehicles=vehicles).fitted(20.0)


def _contestants(config: BenchConfig, stack: ExitStack) -> Iterator[_Contestant]:
    from hmi_marl.envs.worlds.batched import BatchedWorld

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
    """Measure the steps per second of ``step``, which returns the number of steps it took."""
    start, taken = time.perf_counter(), 0
    while (spent := time.perf_counter() - start) < seconds:
        taken += step()
    return taken / spent


def _highway_env(scene: Scene) -> Run:
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

    return lambda seconds: _repeat(step, seconds)


def _async_highway_env(scene: Scene, stack: ExitStack) -> Run:
    """Run highway-env's registered environment in a process for each core."""
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

    return lambda seconds: _repeat(step, seconds)


def _team(scene: Scene, count: int, threads: int) -> Run:
    """Run the whole team step, sequentially: chain, rewards, both observations, and resets."""
    from hmi_marl.envs.worlds.batched import BatchedWorld

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


def make_report(config: BenchConfig, rows: Sequence[Measured], command_line: str) -> Report:
    """Make the report of a bench."""
    columns: dict[str, Callable[[Measured], str]] = {
        "": lambda row: row.name,
        "teams": lambda row: f"{row.teams}",
        "threads": lambda row: f"{row.threads}",
        "vehicles": lambda row: f"{row.vehicles}",
        "steps/s": lambda row: f"{row.steps_per_s:,.0f}",
        "ratio": lambda row: f"{row.ratio:,.1f}",
        "kB/team": lambda row: (
            "-" if row.bytes_per_team is None else f"{row.bytes_per_team / 1000:.1f}"
        ),
    }
    numbers = {"rows": [asdict(row) for row in rows]}
    table = Table.of("Speed, and its ratio to highway-env's own step", rows, columns)
    return Report("bench", "Speed of the worlds", [table], numbers, command_line, asdict(config))
