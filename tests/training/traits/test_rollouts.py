from dataclasses import replace

import numpy as np
import pytest

from hmi_marl.agents.learned.situations import LONG_AGO, situations
from hmi_marl.demonstrations.dataset import STATE_PARTS, observed_layout
from hmi_marl.envs.config import VEHICLE_AI, TeamConfig
from hmi_marl.envs.drivers import Driver
from hmi_marl.envs.scene import Scene
from hmi_marl.envs.teaming import Teaming
from hmi_marl.envs.worlds import VEHICLE_ACTIONS
from hmi_marl.training.traits.rollouts import drive

BLIND = Driver("blind", beta=1.0, alpha=0.0, eta=0.0, inflation=9.0)
CONFIG = TeamConfig(driver=BLIND, duration=2.0, scene=Scene(vehicles=(5, 9)))
SEEDS = np.arange(6, dtype=np.uint64)
FASTER, SLOWER = (VEHICLE_ACTIONS.index(name) for name in ("speed_up", "slow_down"))


def by_turns(x):
    """Speed up where the car goes straight in the leftmost lane, else slow down."""
    lane = observed_layout(CONFIG)["lane"]
    return np.where(x[:, lane.start] == 1, FASTER, SLOWER)


def test_the_policy_is_never_distracted_and_sees_true_sizes():
    drives = drive(CONFIG, by_turns, 0.3, SEEDS)
    seen = Teaming(TeamConfig(driver="lisa", duration=2.0, scene=CONFIG.scene), 6, "batched")
    seen.reset(SEEDS)  # the same scenes, whoever drives
    layout = seen.layouts[VEHICLE_AI]
    shown = seen.observe(VEHICLE_AI)
    size = observed_layout(CONFIG).size
    assert not np.array_equal(shown[:, layout["lidar"]], 0)
    states = np.concatenate([layout.get(shown, name) for name in STATE_PARTS], axis=1)
    np.testing.assert_array_equal(drives.situations[:, 0, :size], states)
    again = np.stack([by_turns(x) for x in np.moveaxis(drives.situations, 1, 0)], axis=1)
    np.testing.assert_array_equal(drives.actions, again)


def test_what_the_policy_does_is_what_the_car_does():
    steps = iter(range(10))

    def to_and_fro(x):
        return np.full(len(x), (FASTER, SLOWER)[next(steps) % 2])

    drives = drive(CONFIG, to_and_fro, 0.3, SEEDS)
    attentive = Driver("attentive", beta=0.0, alpha=1.0, eta=0.0, inflation=1.0)
    by_hand = Teaming(replace(CONFIG, driver=attentive), 6, "batched")
    by_hand.reset(SEEDS)
    for t in range(10):
        by_hand.intend(drives.actions[:, t])
        by_hand.step(drives.alerts[:, t])
        np.testing.assert_array_equal(by_hand.applied, drives.actions[:, t])
        np.testing.assert_array_equal(by_hand.ego.speed, drives.speed[:, t])
    assert (np.diff(drives.speed, axis=1) != 0).any()


def test_situations_are_those_of_the_recorded_drive():
    drives = drive(CONFIG, by_turns, 0.3, SEEDS)
    size = observed_layout(CONFIG).size
    states = drives.situations[:, :, :size]
    expected = situations(states, drives.actions, drives.alerts)
    np.testing.assert_array_equal(drives.situations, expected)


@pytest.mark.parametrize("rate", [0.0, 1.0])
def test_alerts_sound_as_often_as_they_are_to(rate):
    drives = drive(CONFIG, by_turns, rate, SEEDS)
    assert (drives.alerts == rate).all()
    now = drives.situations[:, :, -LONG_AGO - 1]
    assert (now == rate).all()


def test_a_drive_depends_on_its_own_seed_alone():
    together, alone = drive(CONFIG, by_turns, 0.3, SEEDS), drive(CONFIG, by_turns, 0.3, SEEDS[2:3])
    for name, values in vars(alone).items():
        np.testing.assert_array_equal(values[0], getattr(together, name)[2])


def test_a_crashed_car_stands_until_the_time_is_over():
    def into_the_ramp_end(x):
        return np.full(len(x), VEHICLE_ACTIONS.index("move_right"))

    config = TeamConfig(driver=BLIND, duration=20.0, scene=Scene(vehicles=20))
    drives = drive(config, into_the_ramp_end, 0.2, np.arange(40, dtype=np.uint64))
    assert drives.crashed.any()
    assert drives.actions.shape == (40, 100)
    assert (drives.speed[drives.crashed, -1] == 0).all()
    assert (drives.speed[~drives.crashed, -1] > 0).all()


def test_the_return_is_that_of_the_five_driving_terms():
    drives = drive(CONFIG, by_turns, 0.3, SEEDS)
    assert not drives.crashed.any()
    speed = (5.0 * np.clip(drives.speed / 30.0, 0, None)).sum(axis=1)
    right = drives.driving_return - speed
    # What is left: at most 0.1 a step for the right lane, and little for slow merging.
    assert (right <= 0.1 * 10 + 1e-9).all()
    assert (right > -0.5 * 10).all()
