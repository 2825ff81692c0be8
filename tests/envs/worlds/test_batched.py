import numpy as np
import pytest
from parity import assert_parity, random_scene

from hmi_marl import Scene, merge_v0
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.scene import draw_start
from hmi_marl.envs.teaming import Teaming
from hmi_marl.envs.worlds import make_world
from hmi_marl.envs.worlds.batched import BatchedWorld


def seeds(count, first=0):
    return np.arange(first, first + count, dtype=np.uint64)


@pytest.mark.usefixtures("unmeasured")
@pytest.mark.parametrize(
    ("inflation", "driver"),
    [pytest.param(1.0, "rule", marks=pytest.mark.slow), (3.0, "random"), (9.0, "rule")],
)
def test_it_follows_highway_env(inflation, driver):
    steps, _ = assert_parity(Scene(), seeds(2, int(inflation)), inflation=inflation, driver=driver)
    assert steps > 40


@pytest.mark.usefixtures("unmeasured")
@pytest.mark.parametrize(
    "number", [0, 2, *(pytest.param(k, marks=pytest.mark.slow) for k in (1, 3))]
)
def test_it_follows_highway_env_in_any_scene(number):
    rng = np.random.default_rng(number)
    assert_parity(random_scene(rng), seeds(2), 8.0, float(rng.uniform(1, 9)), "random")


@pytest.mark.usefixtures("unmeasured")
def test_it_follows_highway_env_on_an_empty_road():
    assert_parity(Scene(vehicles=(0, 1)), seeds(4, 20), 6.0, 3.0, "random")


@pytest.mark.long
@pytest.mark.parametrize("block", range(20))
@pytest.mark.parametrize("driver", ["random", "rule"])
def test_it_follows_highway_env_for_200_seeds(driver, block):
    inflation = (1.0, 3.0, 9.0)[block % 3]
    assert_parity(Scene(), seeds(10, 1000 + 10 * block), inflation=inflation, driver=driver)


@pytest.mark.long
@pytest.mark.parametrize("number", range(100, 120))
def test_it_follows_highway_env_in_many_scenes(number):
    rng = np.random.default_rng(number)
    driver = ("random", "rule")[number % 2]
    assert_parity(random_scene(rng), seeds(6), 12.0, float(rng.uniform(1, 9)), driver)


@pytest.mark.usefixtures("unmeasured")
@pytest.mark.parametrize(
    ("driver", "end_at_crash"),
    [
        ("bart", True),
        ("homer", False),
        pytest.param("bart", False, marks=pytest.mark.slow),
        pytest.param("homer", True, marks=pytest.mark.slow),
    ],
)
def test_a_whole_episode_equals_the_highway_worlds(driver, end_at_crash):
    crashes = 0
    for seed in range(3):
        envs = [
            merge_v0.parallel_env(
                driver=driver,
                world=world,
                end_at_crash=end_at_crash,
                scene=Scene(vehicles=12),
                duration=12.0,
            )
            for world in ("highway", "batched")
        ]
        rng = np.random.default_rng(seed)
        seen = [env.reset(seed=seed) for env in envs]
        while envs[0].agents:
            for agent in envs[0].possible_agents:
                ours, theirs = (one[0][agent] for one in seen)
                np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-6)
                assert seen[0][-1][agent] == pytest.approx(seen[1][-1][agent], abs=1e-9)
            np.testing.assert_allclose(envs[0].state(), envs[1].state(), rtol=0, atol=1e-6)
            actions = {"driver": int(rng.integers(5)), "vehicle_ai": int(rng.integers(2))}
            seen = [env.step(actions) for env in envs]
            assert seen[0][1] == pytest.approx(seen[1][1], abs=1e-9)
            assert seen[0][2:4] == seen[1][2:4]
        crashes += seen[0][-1]["driver"]["crashed"]
    assert crashes > 0  # or standing after a crash was not seen


def drive(count, which, threads):
    """States and rewards of teams ``which`` out of seeds 0 .. count - 1, over three seconds."""
    config = TeamConfig(driver=["lisa", "homer"], duration=3.0)
    world = BatchedWorld(config.scene, len(which), threads)
    teams = Teaming(config, len(which), world)
    teams.reset(seeds(count)[which])
    actions = np.random.default_rng(0).integers(0, 5, (15, count))
    states = []
    for step in range(15):
        teams.intend(actions[step, which])
        result = teams.step(actions[step, which] % 2)
        rewards = np.stack(list(result.rewards.values()), axis=1)
        states.append(np.concatenate([teams.state().astype(np.float64), rewards], axis=1))
    return np.array(states)


def test_a_team_is_the_same_to_the_bit_alone_among_7_and_among_4096():
    many = drive(4096, np.arange(4096), threads=None)
    for which in (np.array([5]), np.array([9, 5, 4000, 77, 1, 2, 3])):
        np.testing.assert_array_equal(drive(4096, which, threads=1), many[:, which])
    np.testing.assert_array_equal(drive(4096, np.arange(300), threads=1), many[:, :300])


def test_it_starts_from_the_scene_of_the_seed():
    scene = Scene(vehicles=(1, 50)).fitted(20.0)
    world = BatchedWorld(scene, 20)
    world.reset(seeds(20, 7), np.ones(20), np.ones(20, np.bool_))
    for k in range(20):
        start, snapshot = draw_start(scene, 7 + k), world.snapshot(k)
        traffic = snapshot.position[1:-1]
        np.testing.assert_array_equal(traffic[:, 0], start.longitudinal)
        np.testing.assert_array_equal(traffic[:, 1], 4.0 * start.lane)
        np.testing.assert_array_equal(snapshot.speed[1:-1], start.speed)


def test_resetting_and_stepping_some_leaves_the_others_alone():
    scene = Scene().fitted(4.0)
    world = BatchedWorld(scene, 6)
    everywhere, some = np.ones(6, np.bool_), np.array([True, False] * 3)
    world.reset(seeds(6), np.full(6, 3.0), everywhere)
    world.step(np.full(6, 3), everywhere)
    before = [world.snapshot(k) for k in range(6)]
    lidar = world.lidar(inflated=True)
    kept = lidar.copy()
    world.reset(seeds(6, 50), np.full(6, 9.0), some)
    world.step(np.full(6, 4), some)
    for k in range(6):
        same = np.array_equal(world.snapshot(k).position, before[k].position)
        assert same == (not some[k])
        assert world.snapshot(k).time == pytest.approx(0.2)
    np.testing.assert_array_equal(world.lidar(inflated=True)[~some], kept[~some])
    np.testing.assert_array_equal(lidar, kept)  # what was handed out stays as it was


def test_what_is_handed_out_is_not_overwritten():
    scene = Scene().fitted(4.0)
    world = BatchedWorld(scene, 2)
    everywhere = np.ones(2, np.bool_)
    ego, snapshot, lidar = world.ego(), world.snapshot(1), world.lidar(False)
    kept = ego.x.copy(), snapshot.position.copy(), lidar.copy()
    world.step(np.array([3, 3]), everywhere)
    for shown, copy in zip((ego.x, snapshot.position, lidar), kept, strict=True):
        np.testing.assert_array_equal(shown, copy)


def test_the_memory_of_a_team_is_small_and_constant():
    world = BatchedWorld(Scene(vehicles=20).fitted(20.0), 64)
    first = world.bytes_per_world
    everywhere = np.ones(64, np.bool_)
    for step in range(30):
        world.step(np.full(64, 3), everywhere)
        world.lidar(inflated=True)
        world.reset(seeds(64, step), np.ones(64), everywhere)
    assert world.bytes_per_world == first < 16_000


@pytest.mark.parametrize("threads", [0, -1, 10_000])
def test_more_threads_than_there_are_are_refused(threads):
    with pytest.raises(ValueError, match="threads lies in 1 to"):
        make_world("batched", Scene().fitted(2.0), 1, threads)


def test_other_eyes_see_otherwise_whether_or_not_they_looked_before():
    scene = Scene(vehicles=20).fitted(4.0)
    inflation, which = np.array([4.0, 4.0, 4.0]), np.array([True, False, True])
    grids = {}
    for name in ("highway", "batched"):
        world, fresh = make_world(name, scene, 3), make_world(name, scene, 3)
        for each, factor in ((world, np.ones(3)), (fresh, np.where(which, inflation, 1.0))):
            each.reset(seeds(3, 4), factor, np.ones(3, np.bool_))
        before = [world.lidar(inflated) for inflated in (True, False)]
        kept = [grid.copy() for grid in before]
        world.perceive(inflation, which)
        np.testing.assert_array_equal(world.lidar(True), fresh.lidar(True))
        np.testing.assert_array_equal(world.lidar(False), kept[1])
        np.testing.assert_array_equal(before, kept)  # what was handed out stays as it was
        assert (world.lidar(True) != kept[0]).any(axis=(1, 2)).tolist() == which.tolist()
        for each in (world, fresh):
            each.step(np.array([3, 1, 0]), np.ones(3, np.bool_))
        np.testing.assert_array_equal(world.lidar(True), fresh.lidar(True))
        world.perceive(np.ones(3), np.ones(3, np.bool_))
        np.testing.assert_array_equal(world.lidar(True), world.lidar(False))
        grids[name] = fresh.lidar(True)
    np.testing.assert_allclose(*grids.values(), atol=1e-6)
