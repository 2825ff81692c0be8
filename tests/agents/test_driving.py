import numpy as np
import pytest

from hmi_marl.agents import RandomDriver, RuleBasedDriver
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import Driver
from hmi_marl.envs.observations import driver_layout
from hmi_marl.envs.teaming import Teaming
from hmi_marl.envs.worlds import VEHICLE_ACTIONS, make_world


def attentive(inflation):
    return Driver("attentive", beta=0.0, alpha=1.0, eta=0.0, inflation=inflation)


def seen(gap, opening, speed, target_speed=25.0):
    """One observation of a car ahead at this gap [m], opening at this rate [m/s]."""
    config = TeamConfig()
    layout = driver_layout(config)
    observation = np.zeros((1, layout.size), np.float32)
    lidar = np.full((16, 2), 60.0)
    lidar[0] = gap, opening
    observation[:, layout["lidar"]] = (lidar / 60).ravel()
    observation[:, layout["speed"]] = speed / 40
    observation[:, layout["target_speed"]] = target_speed / 40
    return VEHICLE_ACTIONS[RuleBasedDriver(config).act(observation)[0]]


@pytest.mark.parametrize(
    ("gap", "opening", "action"),
    [
        (60.0, 60.0, "speed_up"),  # nothing in sight
        (10.0, 0.0, "slow_down"),  # 0.4 s at 25 m/s
        (50.0, -20.0, "slow_down"),  # closes in 2.5 s
        (0.0, 0.0, "slow_down"),  # inside what is perceived
        (20.0, 1.0, "keep_speed"),  # 0.8 s
        (40.0, -5.0, "keep_speed"),  # far, but closing
        (40.0, 1.0, "speed_up"),  # far and opening
    ],
)
def test_the_rule_by_hand(gap, opening, action):
    assert seen(gap, opening, speed=25.0) == action


def test_at_the_highest_speed_it_keeps_it():
    assert seen(60.0, 60.0, speed=30.0, target_speed=30.0) == "keep_speed"
    assert seen(5.0, -10.0, speed=30.0, target_speed=30.0) == "slow_down"


def drive(inflation, count=10):
    config = TeamConfig(driver=attentive(inflation), duration=12.0)
    teams = Teaming(config, count, make_world("batched", config.scene, count, threads=1))
    driver = RuleBasedDriver(config)
    teams.reset(np.arange(count, dtype=np.uint64))
    speeds, headways, lanes = [], [], set()
    while not teams.over.all():
        active = ~teams.over
        teams.intend(driver.act(teams.observe("driver")))
        teams.step(np.zeros(count, np.int64))
        speeds += teams.ego.speed[active].tolist()
        headways += teams.time_headway()[active].tolist()
        lanes |= set(teams.ego.lane.tolist())
    return np.mean(speeds), np.median(headways), lanes


def test_inflation_makes_it_more_careful_and_it_keeps_its_lane():
    confident, cautious = drive(3.0), drive(9.0)
    assert cautious[0] < confident[0] - 1.0  # slower by more than 1 m/s
    assert cautious[1] > 1.2 * confident[1]  # a fifth more headway at least
    assert confident[2] == cautious[2] == {2}


def test_the_random_driver_takes_every_action_evenly_and_by_seed_alone():
    driver, count, steps = RandomDriver(), 300, 200
    nothing = np.zeros((count, 1), np.float32)
    driver.reset(np.arange(count, dtype=np.uint64))
    actions = np.array([driver.act(nothing) for _ in range(steps)])
    for action in range(5):
        share = (actions == action).mean()
        assert abs(share - 0.2) < 4 * np.sqrt(0.2 * 0.8 / actions.size)
    alone = RandomDriver()
    alone.reset(np.array([12], np.uint64))
    assert [int(alone.act(nothing[:1])[0]) for _ in range(steps)] == actions[:, 12].tolist()
    driver.reset(np.full(count, 12, np.uint64), np.arange(count) == 7)
    assert driver.act(nothing)[7] == actions[0, 12]
