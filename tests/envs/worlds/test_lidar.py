from types import SimpleNamespace

import numpy as np
import pytest
from highway_env import utils
from highway_env.envs.common.observation import LidarObservation
from highway_env.vehicle.kinematics import Vehicle
from hypothesis import given, settings
from hypothesis import strategies as st

from hmi_marl.envs.scene import Scene
from hmi_marl.envs.worlds.highway import HighwayWorld, PerceivedObject, trace

ALL = np.ones(1, np.bool_)
CAR = {"LENGTH": 5.0, "WIDTH": 2.0}


def really_larger(road, observer, inflation):
    """Give every other object on the road its inflated size, for real."""
    for other in road.vehicles + road.objects:
        if other is not observer:
            other.LENGTH, other.WIDTH = other.LENGTH * inflation, other.WIDTH * inflation


def surrounded(observer, others):
    """Is the observer inside any of the objects, by highway-env's polygon of each?"""
    for other in others:
        corners = other.polygon()
        edges, to_point = np.diff(corners, axis=0), observer.position - corners[:-1]
        turns = edges[:, 0] * to_point[:, 1] - edges[:, 1] * to_point[:, 0]
        if np.all(turns >= 0) or np.all(turns <= 0):
            return True
    return False


@pytest.mark.usefixtures("unmeasured")
@pytest.mark.parametrize(
    "inflation",
    [
        pytest.param(1.0, marks=pytest.mark.slow),
        3.0,
        pytest.param(6.0, marks=pytest.mark.slow),
        9.0,
    ],
)
def test_inflated_lidar_is_highway_envs_on_a_road_of_really_larger_objects(inflation):
    scene = Scene(vehicles=(3, 20)).fitted(10.0)
    outside = inside = 0
    for seed in range(6):
        world = HighwayWorld(scene, 1)
        world.reset(np.array([seed], np.uint64), np.array([inflation]), ALL)
        for _ in range(1 + 5 * seed):
            world.step(np.array([1]), ALL)
        ours = world.lidar(inflated=True)[0]
        merge = world.merges[0]
        others = [v for v in merge.road.vehicles if v is not merge.vehicle] + merge.road.objects
        really_larger(merge.road, merge.vehicle, inflation)
        if surrounded(merge.vehicle, others):
            inside += 1
            assert np.all(ours[:, 0] == 0)
            continue
        outside += 1
        reference = LidarObservation(merge, scene.lidar_cells, scene.lidar_range, normalize=False)
        reference.observer_vehicle = merge.vehicle
        np.testing.assert_array_equal(
            ours, reference.trace(merge.vehicle.position, merge.vehicle.velocity)
        )
    assert outside + inside == 6
    assert outside > 0
    assert inside > 0 or inflation < 6


def test_the_ai_sees_true_sizes():
    scene = Scene(vehicles=15).fitted(2.0)
    small, large = HighwayWorld(scene, 1), HighwayWorld(scene, 1)
    small.reset(np.array([1], np.uint64), np.array([1.0]), ALL)
    large.reset(np.array([1], np.uint64), np.array([9.0]), ALL)
    np.testing.assert_array_equal(small.lidar(False), large.lidar(False))
    np.testing.assert_array_equal(small.lidar(False), small.lidar(True))
    assert np.any(large.lidar(True) != large.lidar(False))


def test_distances_by_hand():
    observer = Vehicle(None, [0.0, 0.0], speed=20.0)
    ahead = Vehicle(None, [40.0, 0.0], speed=15.0)
    grid = trace(observer, [ahead], 3.0, cells=16, maximum_range=60.0)
    assert grid[0].tolist() == pytest.approx([40.0 - 7.5, -5.0])  # half of 5 m x 3; closing
    assert np.all(grid[2:15] == 60.0)
    assert np.all(trace(observer, [ahead], 20.0, 16, 60.0)[:, 0] == 0)  # 40 m < half of 100 m


def test_things_that_are_not_solid_are_not_seen():
    observer = Vehicle(None, [0.0, 0.0])
    ghost = Vehicle(None, [10.0, 0.0])
    ghost.solid = False
    assert np.all(trace(observer, [ghost], 1.0, 8, 60.0) == 60.0)


@settings(max_examples=200, deadline=None)
@given(
    x=st.floats(-50, 50),
    y=st.floats(-50, 50),
    heading=st.floats(-3, 3),
    inflation=st.floats(1, 12),
)
def test_every_ray_reads_within_its_range(x, y, heading, inflation):
    observer, other = Vehicle(None, [0.0, 0.0]), Vehicle(None, [x, y], heading=heading)
    grid = trace(observer, [other], inflation, 16, 60.0)
    assert grid.dtype == np.float32
    assert np.all((grid[:, 0] >= 0) & (grid[:, 0] <= 60))
    if PerceivedObject.of(other, inflation).contains(observer.position):
        assert np.all(grid[:, 0] == 0)


@given(st.floats(-3, 3), st.floats(-40, 40), st.floats(-40, 40))
def test_contains_is_the_rectangle_of_highway_envs_corners(heading, x, y):
    thing = SimpleNamespace(position=np.zeros(2), heading=heading, velocity=np.zeros(2), **CAR)
    seen = PerceivedObject.of(thing, 9.0)
    corners = utils.rect_corners(seen.position, seen.LENGTH, seen.WIDTH, heading)
    assert all(seen.contains(corner * 0.999) for corner in corners)
    assert not any(seen.contains(corner * 1.001) for corner in corners)
    assert seen.contains(np.array([x, y])) == seen.contains(-np.array([x, y]))
