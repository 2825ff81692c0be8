import gymnasium
import highway_env  # noqa: F401 (registers its environments)
import numpy as np
import pytest
from highway_env.vehicle.controller import ControlledVehicle

from hmi_marl.envs.scene import TRAFFIC_SPEED, Scene, draw_start
from hmi_marl.envs.worlds import make_world
from hmi_marl.envs.worlds.highway import HighwayWorld, highway_config

ALL = np.ones(1, np.bool_)


class Dictated:
    """Stands in for highway-env's random numbers, so that its own code places our traffic."""

    def __init__(self, scene, start):
        speeds = start.speed - TRAFFIC_SPEED
        self._lanes = iter(start.lane)
        self._uniform = iter(np.column_stack([start.longitudinal, speeds]).ravel())

    def integers(self, *_):
        return next(self._lanes)

    def uniform(self, *_):
        return next(self._uniform)


def unmodified(scene, seed):
    """highway-env's own merge-generic-v1, straight from its registry, with the seed's traffic."""
    start = draw_start(scene, seed)
    config = highway_config(scene) | {
        "vehicles_count": len(start.lane),
        "observation": {
            "type": "LidarObservation",
            "cells": scene.lidar_cells,
            "maximum_range": scene.lidar_range,
        },
    }
    env = gymnasium.make("merge-generic-v1", config=config).unwrapped
    env.np_random = Dictated(scene, start)
    observation, _ = env.reset()
    return env, observation


def all_vehicles(road):
    return np.array([[*v.position, v.heading, v.speed, v.crashed] for v in road.vehicles], float)


SCENES = [
    Scene(),
    Scene(lanes=1, vehicles=3),
    Scene(lanes=5, vehicles=(20, 30), parallel=120.0),
    Scene(lanes=2, policy_frequency=3, simulation_frequency=12, lidar_cells=9, lidar_range=35.0),
]


@pytest.mark.usefixtures("unmeasured")
@pytest.mark.parametrize("scene", SCENES, ids=str)
@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_it_follows_an_unmodified_merge_generic_v1_exactly(scene, seed):
    scene = scene.fitted(5.0)
    world = HighwayWorld(scene, 1)
    world.reset(np.array([seed], np.uint64), np.ones(1), ALL)
    reference, observation = unmodified(scene, seed)
    actions = np.random.default_rng(seed).integers(0, 5, 5 * scene.policy_frequency)
    for action in actions:
        ours = all_vehicles(world.merges[0].road)
        np.testing.assert_array_equal(ours, all_vehicles(reference.road))
        np.testing.assert_array_equal(
            world.lidar(inflated=False)[0] / np.float32(scene.lidar_range), observation
        )
        assert world.ego().crashed[0] == reference.vehicle.crashed
        if reference.vehicle.crashed:
            break
        world.step(np.array([action]), ALL)
        observation, *_ = reference.step(action)


def test_what_is_read_off_is_highway_envs():
    scene = Scene(vehicles=12).fitted(20.0)
    world = HighwayWorld(scene, 1)
    world.reset(np.array([3], np.uint64), np.ones(1), ALL)
    seen_merging = False
    for step in range(60):
        world.step(np.array([[1, 0, 1, 3, 4][step % 5]]), ALL)
        ego, merge = world.ego(), world.merges[0]
        car = merge.vehicle
        assert (ego.x[0], ego.y[0]) == tuple(car.position)
        assert (ego.speed[0], ego.heading[0]) == (car.speed, car.heading)
        assert ego.target_speed[0] == car.target_speed
        assert ego.lane[0] == car.lane_index[2]
        assert ego.lateral[0] == pytest.approx(car.position[1] - 4.0 * car.lane_index[2])
        merging = [
            (v.target_speed - v.speed) / v.target_speed
            for v in merge.road.vehicles
            if v.lane_index == ("b", "c", scene.lanes) and isinstance(v, ControlledVehicle)
        ]
        seen_merging = seen_merging or bool(merging)
        assert ego.merging_slowness[0] == pytest.approx(sum(merging))
        if car.crashed:
            break
    assert seen_merging


def test_the_gap_is_bumper_to_bumper_in_the_lane():
    world = HighwayWorld(Scene(vehicles=1).fitted(2.0), 1)
    world.reset(np.zeros(1, np.uint64), np.ones(1), ALL)
    road, car = world.merges[0].road, world.merges[0].vehicle
    other = road.vehicles[1]
    other.position = car.position + np.array([40.0, 0.0])
    assert world.ego().gap[0] == pytest.approx(35.0)  # both are 5 m long
    other.position = car.position - np.array([40.0, 0.0])
    assert np.isinf(world.ego().gap[0])


def test_worlds_of_a_batch_are_the_same_alone():
    scene = Scene(vehicles=(1, 6)).fitted(3.0)
    seeds, inflation = np.array([5, 6, 7], np.uint64), np.array([1.0, 3.0, 9.0])
    batch = HighwayWorld(scene, 3)
    batch.reset(seeds, inflation, np.ones(3, np.bool_))
    for k in range(3):
        alone = HighwayWorld(scene, 1)
        alone.reset(seeds[k : k + 1], inflation[k : k + 1], ALL)
        for _ in range(5):
            alone.step(np.array([3]), ALL)
            batch.step(np.array([3, 3, 3]), np.arange(3) == k)
        np.testing.assert_array_equal(alone.lidar(True)[0], batch.lidar(True)[k])
        np.testing.assert_array_equal(alone.snapshot(0).position, batch.snapshot(k).position)


def test_halting_stops_the_driven_car_alone():
    world = HighwayWorld(Scene(vehicles=3).fitted(2.0), 1)
    world.reset(np.zeros(1, np.uint64), np.ones(1), ALL)
    before = world.snapshot(0)
    world.halt(ALL)
    after = world.snapshot(0)
    assert world.ego().speed[0] == 0.0
    np.testing.assert_array_equal(before.position, after.position)
    np.testing.assert_array_equal(before.speed[1:], after.speed[1:])


def test_a_snapshot_shows_all_vehicles_and_the_end_of_the_ramp():
    world = HighwayWorld(Scene(vehicles=4).fitted(2.0), 1)
    world.reset(np.zeros(1, np.uint64), np.ones(1), ALL)
    world.step(np.array([1]), ALL)
    snapshot = world.snapshot(0)
    assert snapshot.time == pytest.approx(0.2)
    assert snapshot.position.shape == (len(world.merges[0].road.vehicles), 2)
    np.testing.assert_array_equal(snapshot.position[0], world.merges[0].vehicle.position)
    np.testing.assert_allclose(snapshot.obstacles, [[310.0, 12.0]])


def test_the_error_for_an_unknown_world_names_the_known_ones():
    with pytest.raises(ValueError, match="unknown world 'moon'; known: highway"):
        make_world("moon", Scene().fitted(2.0), 1)
