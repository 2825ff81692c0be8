"""Holding the batched world against highway-env, vehicle by vehicle and ray by ray."""

from dataclasses import fields

import numpy as np

from hmi_marl.agents import RandomDriver, RuleBasedDriver
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import Driver
from hmi_marl.envs.scene import Scene
from hmi_marl.envs.teaming import Teaming
from hmi_marl.envs.worlds.batched.memory import CRASHED, LANE, TARGET_LANE

POSITION, LIDAR = 1e-9, 1e-6


def assert_same_vehicles(highway, batched, team, where):
    """Every vehicle's motion within 1e-9, and not one discrete difference."""
    merge = highway.merges[team]
    vehicles = merge.road.vehicles
    ours, theirs = batched.snapshot(team), highway.snapshot(team)
    assert len(ours.position) == len(theirs.position), where
    for name in ("position", "heading", "speed"):
        np.testing.assert_allclose(
            getattr(ours, name), getattr(theirs, name), rtol=0, atol=POSITION, err_msg=where
        )
    number = {index: k for k, index in enumerate(merge.road.network.lanes_dict())}
    for field, expected in (
        (LANE, [number[v.lane_index] for v in vehicles]),
        (TARGET_LANE, [number[tuple(v.target_lane_index)] for v in vehicles]),
        (CRASHED, [int(v.crashed) for v in vehicles]),
    ):
        found = batched._integers[team, field, : len(vehicles)].tolist()
        assert found == expected, (where, field)


def assert_same_view(highway, batched, alive, where):
    """What a world reports of the driven cars, and both lidars."""
    ours, theirs = batched.ego(), highway.ego()
    for field in fields(ours):
        mine, other = (getattr(ego, field.name)[alive].astype(float) for ego in (ours, theirs))
        np.testing.assert_allclose(mine, other, rtol=0, atol=POSITION, err_msg=where)
    for inflated in (False, True):
        mine, other = (world.lidar(inflated)[alive] for world in (batched, highway))
        np.testing.assert_allclose(mine, other, rtol=0, atol=LIDAR, err_msg=where)


def assert_parity(scene: Scene, seeds, duration=20.0, inflation=3.0, driver="random"):
    """Drive both worlds by the same actions up to and including the end; returns steps driven."""
    attentive = Driver("attentive", beta=0.0, alpha=1.0, eta=0.0, inflation=inflation)
    config = TeamConfig(driver=attentive, scene=scene, duration=duration)
    teams = [Teaming(config, len(seeds), world) for world in ("highway", "batched")]
    policy = RandomDriver() if driver == "random" else RuleBasedDriver(config)
    seeds = np.asarray(seeds, np.uint64)
    for seat in (*teams, policy):
        seat.reset(seeds)
    highway, batched = (team.world for team in teams)
    alive, steps = np.ones(len(seeds), np.bool_), 0
    while True:
        for k in np.flatnonzero(alive):
            where = f"{scene}, seed {seeds[k]}, step {teams[0].steps[k]}"
            assert_same_vehicles(highway, batched, k, where)
        if alive.any():
            assert_same_view(highway, batched, alive, str(scene))
        alive = ~teams[0].over
        np.testing.assert_array_equal(teams[0].over, teams[1].over)
        if not alive.any():
            return steps
        actions = policy.act(teams[0].observe("driver"))
        for team in teams:
            team.intend(actions)
            team.step(np.zeros(len(seeds), np.int64))
        steps += int(alive.sum())


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
