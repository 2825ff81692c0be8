import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hmi_marl.envs.scene import EGO_START, SAFE_DISTANCE, Scene, draw_start


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"vehicles": 0}, "scene.vehicles lies in 1 to 50, but got 0"),
        ({"vehicles": (0, 0)}, "vehicles lies in 1 to 50"),
        ({"vehicles": (-1, 5)}, "vehicles lies in 0 to 50"),
        ({"vehicles": 51}, "vehicles lies in 1 to 50"),
        ({"vehicles": (9, 3)}, "runs backwards"),
        ({"vehicles": (1, 2, 3)}, "pair"),
        ({"lanes": 0}, "lanes lies in 1 to 5"),
        ({"lanes": 6}, "lanes lies in 1 to 5"),
        ({"before": 10.0}, r"before lies in \[60, 10000\] m"),
        ({"after": 20.0}, r"after lies in \[90, 1e\+06\] m"),
        ({"parallel": float("nan")}, "parallel lies in"),
        ({"policy_frequency": 4}, "does not divide simulation_frequency = 15"),
        ({"policy_frequency": 0}, "policy_frequency lies in"),
        ({"lidar_cells": 2}, "lidar_cells lies in"),
        ({"lidar_range": 0.0}, "lidar_range lies in"),
        ({"target_speeds": (30.0, 20.0)}, "target_speeds"),
        ({"target_speeds": (20.0, 25.0, 40.0)}, "evenly spaced"),
        ({"target_speeds": (20.0,)}, "at least two"),
    ],
)
def test_a_scene_out_of_range_is_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        Scene(**arguments)


@pytest.mark.parametrize(
    "arguments",
    [
        {"vehicles": 2.5},
        {"lanes": True},
        {"before": "150"},
        {"target_speeds": 30.0},
        {"target_speeds": "2030"},
        {"target_speeds": ("20", "30")},
        {"target_speeds": (True, 2.0)},
        {"target_speeds": None},
    ],
)
def test_a_scene_of_the_wrong_type_is_refused(arguments):
    with pytest.raises(TypeError, match=r"scene\."):
        Scene(**arguments)


def test_the_road_is_long_enough_for_the_whole_episode():
    for duration in (2.0, 20.0, 60.0):
        scene = Scene().fitted(duration)
        assert scene.length >= EGO_START + 30.0 * duration
        assert scene.length >= scene.merge_end + 30.0 * duration  # for those ahead, too
    with pytest.raises(ValueError, match=r"too short for 40 s at 30 m/s: use at least 920"):
        Scene(after=450.0).fitted(40.0)
    assert Scene(after=450.0).fitted(20.0).after == 450.0


def test_an_open_road_has_no_length_yet():
    with pytest.raises(ValueError, match="fitted"):
        _ = Scene().length


scenes = st.builds(
    Scene,
    lanes=st.integers(1, 5),
    vehicles=st.tuples(st.integers(1, 20), st.integers(20, 50)),
    before=st.floats(60, 400),
    converge=st.floats(10, 200),
    parallel=st.floats(10, 200),
)


@settings(max_examples=60)
@given(scenes, st.integers(0, 2**64 - 1))
def test_traffic_starts_on_the_road_and_apart(scene, seed):
    start = draw_start(scene, seed)
    assert len(start.lane) <= scene.vehicle_range[1]
    assert np.all((start.lane >= 0) & (start.lane < scene.lanes))
    assert np.all((start.longitudinal >= 0) & (start.longitudinal < scene.merge_end))
    assert np.all((start.speed >= 28) & (start.speed < 32))
    for lane in range(scene.lanes):
        places = start.longitudinal[start.lane == lane].tolist()
        places += [EGO_START] if lane == scene.lanes - 1 else []
        assert np.all(np.diff(sorted(places)) > SAFE_DISTANCE)
    again = draw_start(scene, seed)
    assert again.longitudinal.tolist() == start.longitudinal.tolist()


def test_the_number_of_vehicles_is_drawn_evenly():
    # Few vehicles on a long road always find a place.
    scene = Scene(vehicles=(1, 4), before=2000.0)
    counts = np.array([len(draw_start(scene, seed).lane) for seed in range(4000)])
    for number in (1, 2, 3, 4):
        assert abs((counts == number).mean() - 0.25) < 4 * np.sqrt(0.25 * 0.75 / 4000)
    fixed = Scene(vehicles=3, before=2000.0)
    assert {len(draw_start(fixed, seed).lane) for seed in range(100)} == {3}


def test_one_vehicle_more_leaves_the_others_where_they_were():
    few, more = (draw_start(Scene(vehicles=count), 5) for count in (4, 5))
    assert more.longitudinal[:4].tolist() == few.longitudinal.tolist()


def test_a_range_may_begin_at_none():
    scene = Scene(vehicles=(0, 3), before=2000.0)
    counts = {len(draw_start(scene, seed).lane) for seed in range(100)}
    assert counts == {0, 1, 2, 3}
