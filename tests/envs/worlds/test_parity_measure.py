"""The measure of parity itself: it sees what is wrong, and allows what one bit does."""

import numpy as np
import parity
import pytest

from hmi_marl.envs.scene import Scene
from hmi_marl.envs.worlds.batched import BatchedWorld
from hmi_marl.envs.worlds.batched.memory import CRASHED, LANE, SPEED, TARGET_LANE, X

SCENE = Scene(vehicles=4)


def wrong(block, field, change):
    """A step of the batched world after which a number of its second vehicle is wrong."""
    step = BatchedWorld.take_step

    def stepped(self, *arguments):
        step(self, *arguments)
        values = getattr(self, block)
        values[:, field, 1] = change(values[:, field, 1])

    return stepped


@pytest.mark.usefixtures("unmeasured")
@pytest.mark.parametrize(
    ("block", "field", "change"),
    [
        ("_floats", X, lambda x: x + 1e-6),
        ("_floats", SPEED, lambda speed: speed * np.nan),
        ("_integers", LANE, lambda lane: lane + 1),
        ("_integers", TARGET_LANE, lambda lane: (lane + 1) % 3),
        ("_integers", CRASHED, lambda crashed: 1 - crashed),
    ],
)
def test_a_wrong_number_is_found(monkeypatch, block, field, change):
    monkeypatch.setattr(BatchedWorld, "take_step", wrong(block, field, change))
    with pytest.raises(AssertionError, match="step"):
        parity.assert_parity(SCENE, [3], duration=1.0)


def test_highway_env_moved_by_one_bit_is_within_its_own_distance():
    drives, _, fitted = parity.drive_both(Scene(), np.array([173], np.uint64), 20.0, 3.0, "random")
    itself = parity.distances_to_itself(fitted, 173, 3.0, drives[0])
    moved = [name for name, distance in itself[-1].items() if distance > parity.allowed(name)]
    assert moved  # a car nearly stops in this episode, and one bit grows beyond 1e-9
    parity.compare(itself, itself, "itself")
    twice = [{name: 2 * distance for name, distance in step.items()} for step in itself]
    with pytest.raises(AssertionError, match=r"position|heading|speed"):
        parity.compare(twice, itself, "twice as far")


def test_another_number_of_vehicles_is_infinitely_far():
    one, two = {"lane": np.zeros(1)}, {"lane": np.zeros(2)}
    assert parity.distances(one, two) == {"lane": np.inf}
    assert parity.distances(two, two) == {"lane 0": 0.0, "lane 1": 0.0}
