"""Measure the speed of highway-env, the batched world and the teams on it in one run.

Every contestant drives the same kind of scene by the same mix of actions, and begins a new episode
after a crash or 20 s; resets are counted in. Each is measured for a while in turn, several rounds
over, after a warm-up, and the median round counts. numba is imported only then.

A vector environment is compared with the world that carries it: the world alone takes the same
actions in the same episodes, traces the lidars that the environment reads, and does nothing else.
The two alternate within each turn, so that both meet the same machine.
"""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from hmi_marl.checks import Checked, Count, Real, Threads, Whole
from hmi_marl.envs.config import DRIVER, VEHICLE_AI, TeamConfig
from hmi_marl.envs.drivers import PAPER_DRIVERS
from hmi_marl.envs.scene import Scene
from hmi_marl.experiments.speed import contestants
from hmi_marl.experiments.speed.contestants import Run

if TYPE_CHECKING:
    from hmi_marl.envs.groups import Seat

HIGHWAY_ENV = "highway-env, one process"
WORLD = "batched world alone"
WHOLE_STEP = "whole team step"
VECTOR, CARRIER = "vector environment", "its world with the lidars read"
SCALING_TEAMS = 1024
DEFAULT_TRAFFIC = 512
"""Teams of the vector environment with the default traffic."""
DRIVE = 150
"""Steps of a drive that is repeated."""
PARTS = 10
"""Times that a vector environment and its world alternate in a turn."""


Vehicles = Annotated[int, Whole(1, 50)]


@dataclass(frozen=True)
class BenchConfig(Checked):
    """Settings of a bench."""

    teams: tuple[Count, ...] = (1, 16, 64, 1024, 4096, 16384)
    """Sizes of the batches."""
    threads: tuple[Threads, ...] = ()
    """Thread counts; one and all cores by default."""
    vehicles: Vehicles = 20
    """Vehicles in every scene, besides the driver's car and the one on the ramp."""
    scaling: tuple[Vehicles, ...] = (5, 10, 20, 40)
    """Numbers of vehicles that show how the cost grows."""
    vector_teams: tuple[Count, ...] = (1024, 4096)
    """Sizes of the vector environments, on all threads; one of 512 teams with the default traffic
    is measured with every number of threads. Needs the train extra; none leaves them out."""
    seconds: Annotated[float, Real(1e-3, 3600.0, "s")] = 1.0
    """Duration of each measurement [s]."""
    rounds: Count = 3
    """Turns of each contestant."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.teams:
            raise ValueError("teams names at least one size of a batch")


@dataclass(frozen=True)
class Measured:
    """Speed of one contestant."""

    name: str
    teams: int
    threads: int
    vehicles: str
    """Other vehicles, a number or a range."""
    steps_per_s: float
    ratio: float
    """Ratio to highway-env in one process in the same run, with the bench's number of vehicles."""
    bytes_per_team: int | None
    of_world: float | None
    """A vector environment's ratio to the world that carries it, turn by turn."""


@dataclass(frozen=True)
class _Contestant:
    name: str
    teams: int
    threads: int
    vehicles: str
    run: Run
    bytes_per_team: int | None = None


def bench(config: BenchConfig, progress: Callable[[int], Any] = id) -> list[Measured]:
    """Measure all contestants in turns; ``progress`` is called after each of :func:`measurements`.

    Raises:
        ValueError: a number in ``config`` that is not positive, or more threads than there are.
    """
    with ExitStack() as stack:
        every = list(_contestants(config, stack))
        speeds = np.zeros((config.rounds, len(every)))
        for contestant in every:
            contestant.run(0.1)
        for turn in range(config.rounds):
            for together in _in_turn(every):
                parts = PARTS if len(together) > 1 else 1
                each = [
                    [every[k].run(config.seconds / parts) for k in together] for _ in range(parts)
                ]
                speeds[turn, together] = np.mean(each, axis=0)
                progress(len(together))
    ratios = np.median(speeds / speeds[:, :1], axis=0)
    medians = np.median(speeds, axis=0)
    rows = []
    for k, one in enumerate(every):
        carried = _is_carried(one)
        of_world = float(np.median(speeds[:, k] / speeds[:, k + 1])) if carried else None
        speed, ratio = float(medians[k]), float(ratios[k])
        place = one.teams, one.threads, one.vehicles
        rows.append(Measured(one.name, *place, speed, ratio, one.bytes_per_team, of_world))
    return rows


def _is_carried(one: _Contestant) -> bool:
    """Whether this is a vector environment: the contestant after it is its world."""
    return one.name.startswith(VECTOR)


def _in_turn(every: list[_Contestant]) -> Iterator[list[int]]:
    """Numbers of contestants that are measured together: a vector environment and its world."""
    worlds = {k + 1 for k, one in enumerate(every) if _is_carried(one)}
    for k, one in enumerate(every):
        if k not in worlds:
            yield [k, k + 1] if _is_carried(one) else [k]


def measurements(config: BenchConfig) -> int:
    """Count the measurements that a bench takes."""
    threads = len(_thread_counts(config))
    envpool = int(importlib.util.find_spec("envpool") is not None)
    vectors = len(list(_vectors(config)))
    each = 2 + envpool + 2 * threads * len(config.teams) + 2 * len(config.scaling) + 2 * vectors
    return config.rounds * each


def _thread_counts(config: BenchConfig) -> tuple[int, ...]:
    return config.threads or tuple(sorted({1, os.cpu_count() or 1}))


def _team(vehicles: int | tuple[int, int]) -> TeamConfig:
    return TeamConfig(driver=PAPER_DRIVERS, scene=Scene(vehicles=vehicles))


def _contestants(config: BenchConfig, stack: ExitStack) -> Iterator[_Contestant]:
    from hmi_marl.envs.worlds.batched import BatchedWorld

    team = _team(config.vehicles)
    scene, vehicles = team.scene, f"{config.vehicles}"
    yield _Contestant(HIGHWAY_ENV, 1, 1, vehicles, contestants.highway_env(scene))
    cores = os.cpu_count() or 1
    processes = contestants.async_highway_env(scene, stack)
    yield _Contestant("highway-env, AsyncVectorEnv", cores, cores, vehicles, processes)
    if importlib.util.find_spec("envpool") is not None:
        run = contestants.envpool(64)
        yield _Contestant("EnvPool Merge-v0 (5 vehicles, no lidar)", 64, 1, "5", run)
    for teams in config.teams:
        for count in _thread_counts(config):
            world = BatchedWorld(scene, teams, count)
            size = world.bytes_per_world
            yield _Contestant(WORLD, teams, count, vehicles, contestants.world_alone(world), size)
            run, size = contestants.whole_team_step(team, teams, count)
            yield _Contestant(WHOLE_STEP, teams, count, vehicles, run, size)
    threads = _thread_counts(config)[-1]
    for number in config.scaling:
        team = _team(number)
        world = BatchedWorld(team.scene, SCALING_TEAMS, threads)
        place, size = (SCALING_TEAMS, threads, f"{number}"), world.bytes_per_world
        yield _Contestant(f"{WORLD}, growth", *place, contestants.world_alone(world), size)
        run, size = contestants.whole_team_step(team, SCALING_TEAMS, threads)
        yield _Contestant(f"{WHOLE_STEP}, growth", *place, run, size)
    for name, team, teams, count, seat, groups, lidars in _vectors(config):
        run, drive = contestants.vector_environment(team, teams, count, seat, groups, DRIVE)
        low, high = team.scene.vehicle_range
        place = teams, count, f"{high}" if low == high else f"{low}-{high}"
        yield _Contestant(f"{VECTOR}, {name}", *place, run)
        world_run = contestants.world_with_lidars(team.scene, teams, count, drive, lidars)
        yield _Contestant(f"{CARRIER}, {name}", *place, world_run)


def _vectors(
    config: BenchConfig,
) -> Iterator[tuple[str, TeamConfig, int, int, Seat, tuple[str, ...], tuple[bool, ...]]]:
    """Name, team, number of teams, threads, seat, groups and lidars of each vector environment."""
    if not config.vector_teams or importlib.util.find_spec("tensordict") is None:
        return
    counts = _thread_counts(config)
    sizes = [(_team((1, 20)), DEFAULT_TRAFFIC, count) for count in counts]
    sizes += [(_team(config.vehicles), teams, counts[-1]) for teams in config.vector_teams]
    both = (DRIVER, VEHICLE_AI, "traits", "critic")
    for team, teams, count in sizes:
        yield "both seats, all groups", team, teams, count, "team", both, (False, True)
        yield "driver's seat, its own group", team, teams, count, "driver", (DRIVER,), (True,)
