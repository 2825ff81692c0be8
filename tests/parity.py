"""Compare the batched world with highway-env, vehicle by vehicle and ray by ray.

highway-env computes with NumPy and BLAS; their last bit depends on the processor, and a car that
has nearly stopped turns one bit into centimetres. So the batched world may be as far from
highway-env as highway-env is from itself when its state is moved by one bit, or 1e-9, whichever is
more; and it may show no discrete difference that highway-env does not show towards itself.
"""

from dataclasses import dataclass, fields

import numpy as np

from hmi_marl.agents import RandomDriver, RuleBasedDriver
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import Driver
from hmi_marl.envs.scene import Scene
from hmi_marl.envs.teaming import Teaming
from hmi_marl.envs.worlds.base import Ego
from hmi_marl.envs.worlds.batched.memory import CRASHED, LANE, TARGET_LANE
from hmi_marl.envs.worlds.highway import HighwayWorld

LEAST = {"lidar": 1e-6, "perceived_lidar": 1e-6}
"""Distances that are always allowed; 1e-9 for what is not named. Lidars are in 32 bits."""
DISCRETE = ("lane", "target_lane", "crashed", "ego.lane", "ego.crashed")
COPIES = 6
"""Runs of highway-env with its state moved by one bit."""


@dataclass(frozen=True)
class Drive:
    """One episode: the actions, and after every step what each quantity was."""

    actions: list[int]
    states: list[dict[str, np.ndarray]]


def read(world, k: int, ego: Ego, lidars) -> dict[str, np.ndarray]:
    """Everything that is compared of world number k."""
    snapshot = world.snapshot(k)
    state = {name: getattr(snapshot, name) for name in ("position", "heading", "speed")}
    count = len(snapshot.position)
    if isinstance(world, HighwayWorld):
        merge = world.merges[k]
        number = {index: j for j, index in enumerate(merge.road.network.lanes_dict())}
        vehicles = merge.road.vehicles
        state["lane"] = np.array([number[v.lane_index] for v in vehicles])
        state["target_lane"] = np.array([number[tuple(v.target_lane_index)] for v in vehicles])
        state["crashed"] = np.array([int(v.crashed) for v in vehicles])
    else:
        for name, field in (("lane", LANE), ("target_lane", TARGET_LANE), ("crashed", CRASHED)):
            state[name] = world._integers[k, field, :count].astype(int)
    for field in fields(ego):
        state[f"ego.{field.name}"] = np.array([float(getattr(ego, field.name)[k])])
    for name, lidar in zip(("lidar", "perceived_lidar"), lidars, strict=True):
        state[name] = lidar[k].copy()
    return state


def read_all(world, which) -> dict[int, dict[str, np.ndarray]]:
    """:func:`read` of the marked worlds."""
    if not which.any():
        return {}
    ego, lidars = world.ego(), [world.lidar(inflated) for inflated in (False, True)]
    return {int(k): read(world, k, ego, lidars) for k in np.flatnonzero(which)}


def distances(ours, theirs) -> dict[str, float]:
    """The largest difference in each quantity of each vehicle, by name and number.

    Infinite where there are more or fewer of a thing, and where one is no number.
    """
    found = {}
    for name, values in theirs.items():
        if ours[name].shape != values.shape:
            found[name] = np.inf
            continue
        same = ours[name] == values  # infinities too
        apart = np.abs(np.where(same, 0.0, ours[name]) - np.where(same, 0.0, values))
        apart = np.where(np.isnan(apart), np.inf, apart).reshape(len(values), -1).max(axis=1)
        for number, distance in enumerate(apart):
            found[f"{name} {number}"] = float(distance)
    return found


def move_by_one_bit(merge, rng) -> None:
    """Move place, heading and speed of every vehicle to a neighbouring double."""
    for vehicle in merge.road.vehicles:
        towards = rng.choice([-np.inf, np.inf], 4)
        vehicle.position = np.nextafter(vehicle.position, towards[:2])
        vehicle.heading = float(np.nextafter(vehicle.heading, towards[2]))
        vehicle.speed = float(np.nextafter(vehicle.speed, towards[3]))


def distances_to_itself(scene: Scene, seed: int, inflation: float, drive: Drive):
    """Measure highway-env's distance to ``drive`` when its state is moved by one bit.

    Half of the copies are moved once, before the first step, the others before every step, as
    rounding does. Returns, for each step, the largest distance so far in each quantity.
    """
    worst: dict[str, float] = {}
    envelope = [dict(worst) for _ in drive.states]
    for copy in range(COPIES):
        rng = np.random.default_rng([copy, seed])
        world, here = HighwayWorld(scene, 1), np.ones(1, np.bool_)
        world.reset(np.array([seed], np.uint64), np.array([inflation]), here)
        worst = {}
        for step, state in enumerate(drive.states):
            if step:
                if step == 1 or copy % 2:
                    move_by_one_bit(world.merges[0], rng)
                world.step(np.array([drive.actions[step - 1]]), here)
            for name, distance in distances(read_all(world, here)[0], state).items():
                worst[name] = max(worst.get(name, 0.0), distance)
                envelope[step][name] = max(envelope[step].get(name, 0.0), worst[name])
    return envelope


def allowed(name: str) -> float:
    """Distance that is allowed without asking for highway-env's distance to itself."""
    quantity = name.partition(" ")[0]
    return 0.0 if quantity in DISCRETE else LEAST.get(quantity, 1e-9)


def compare(ours: list[dict[str, float]], itself: list[dict[str, float]], where: str) -> None:
    """Fail if a distance is larger than allowed and than highway-env's to itself so far."""
    for step, found in enumerate(ours):
        for name, distance in found.items():
            limit = max(allowed(name), itself[step].get(name, 0.0))
            assert distance <= limit, f"{where}, step {step}: {name} {distance:g} > {limit:g}"


def drive_both(scene: Scene, seeds, duration, inflation, driver):
    """Drive both worlds by the same actions to the end of every episode.

    Returns highway-env's drives and, for each, our distance to it after every step.
    """
    attentive = Driver("attentive", beta=0.0, alpha=1.0, eta=0.0, inflation=inflation)
    config = TeamConfig(driver=attentive, scene=scene, duration=duration)
    teams = [Teaming(config, len(seeds), world) for world in ("highway", "batched")]
    policy = RandomDriver() if driver == "random" else RuleBasedDriver(config)
    for seat in (*teams, policy):
        seat.reset(seeds)
    drives = [Drive([], []) for _ in seeds]
    apart: list[list[dict[str, float]]] = [[] for _ in seeds]
    alive = np.ones(len(seeds), np.bool_)
    while alive.any():
        theirs, ours = (read_all(team.world, alive) for team in teams)
        for k, state in theirs.items():
            drives[k].states.append(state)
            apart[k].append(distances(ours[k], state))
        going = alive & ~teams[0].over
        actions = policy.act(teams[0].observe("driver"))
        for k in np.flatnonzero(going):
            drives[k].actions.append(int(actions[k]))
        for team in teams:  # one that has ended in the other world only is seen to be apart
            np.copyto(team.over, True, where=~going)
        if going.any():
            for team in teams:
                team.intend(actions)
                team.step(np.zeros(len(seeds), np.int64))
        alive = going
    return drives, apart, config.scene


def assert_parity(scene: Scene, seeds, duration=20.0, inflation=3.0, driver="random"):
    """Drive both worlds up to and including the end; returns (steps driven, episodes moved).

    The second number counts episodes in which highway-env had to be compared with itself.
    """
    seeds = np.asarray(seeds, np.uint64)
    drives, apart, fitted = drive_both(scene, seeds, duration, inflation, driver)
    doubtful = 0
    for seed, drive, found in zip(seeds, drives, apart, strict=True):
        if any(distance > allowed(name) for step in found for name, distance in step.items()):
            doubtful += 1
            itself = distances_to_itself(fitted, int(seed), inflation, drive)
            compare(found, itself, f"{scene}, seed {seed}")
    return sum(len(drive.actions) for drive in drives), doubtful


def random_scene(rng) -> Scene:
    """Any scene that the configuration allows, up to a size that highway-env can drive."""
    low = int(rng.integers(0, 20))
    policy_frequency = int(rng.integers(2, 7))
    step = float(rng.uniform(2.0, 6.0))
    return Scene(
        lanes=int(rng.integers(1, 6)),
        vehicles=(low, low + int(rng.integers(1, 25))),
        before=float(rng.uniform(60, 300)),
        converge=float(rng.uniform(5, 150)),
        parallel=float(rng.uniform(1, 150)),
        policy_frequency=policy_frequency,
        simulation_frequency=policy_frequency * int(rng.integers(1, 5)),
        lidar_cells=int(rng.integers(4, 40)),
        lidar_range=float(rng.uniform(10, 120)),
        target_speeds=tuple(20.0 + step * k for k in range(int(rng.integers(2, 5)))),
    )
