import re
from pathlib import Path

import numpy as np
import pytest

from hmi_marl.agents.hmis import RandomAlert
from hmi_marl.agents.memory import Memoryless
from hmi_marl.agents.rollout import Observer, begin, play, turns
from hmi_marl.envs.config import TeamConfig

ROOT = Path(__file__).parents[2]
CONFIG = TeamConfig(driver="bart", duration=2.0)
SEEDS = np.arange(4, dtype=np.uint64)


class Counting(Memoryless):
    """A driver with the number of the step, modulo 5, as a^H."""

    def __init__(self):
        self.step = 0

    def act(self, observations):
        self.step += 1
        return np.full(len(observations), (self.step - 1) % 5)


class SeesIntent(Memoryless):
    """An HMI that keeps the intended action that it sees."""

    def __init__(self, layout, sequential):
        self.layout, self.sequential, self.seen = layout, sequential, []

    def act(self, observations):
        self.seen.append(self.layout.chosen(observations, "intended_action")[0])
        return np.zeros(len(observations), np.int64)


class Log(Observer):
    def __init__(self):
        self.calls = []

    def before(self, teaming):
        self.calls.append(("before", int(teaming.steps[0]), bool(teaming.intent_given.any())))

    def seen(self, teaming, observations):
        self.calls.append(("seen", observations.shape, bool(teaming.intent_given.any())))

    def after(self, teaming, result):
        self.calls.append(("after", int(teaming.steps[0]), result.rewards["driver"].shape))


@pytest.mark.parametrize("sequential", [True, False])
def test_an_hmi_sees_the_intent_of_this_step_or_of_the_last(sequential):
    driver = Counting()
    teaming = begin(CONFIG, driver, RandomAlert(0.0), SEEDS, "batched")
    hmi = SeesIntent(teaming.layouts["vehicle_ai"], sequential)
    for _, _ in zip(range(4), turns(teaming, driver, hmi), strict=False):
        pass
    assert hmi.seen == ([0, 1, 2, 3] if sequential else [-1, 0, 1, 2])


def test_observers_are_called_before_each_turn_as_the_hmi_sees_and_after():
    driver, hmi, log = Counting(), RandomAlert(0.5), Log()
    teaming = begin(CONFIG, driver, hmi, SEEDS, "batched")
    size = teaming.layouts["vehicle_ai"].size
    next(turns(teaming, driver, hmi, [log]))
    assert log.calls == [("before", 0, False), ("seen", (4, size), True), ("after", 1, (4,))]


class Watching(Memoryless):
    """A policy that keeps what it was shown."""

    def __init__(self, reads=None):
        self.shown = None
        if reads is not None:
            self.reads = reads

    def act(self, observations):
        self.shown = observations.copy()
        return np.ones(len(observations), np.int64)


@pytest.mark.parametrize("watched", [False, True])
def test_policies_are_shown_what_they_read_and_observers_everything(watched):
    driver, hmi = Watching(("speed",)), Watching(("intended_action",))
    teaming = begin(CONFIG, driver, hmi, SEEDS, "batched")
    before = teaming.observe("driver")
    next(turns(teaming, driver, hmi, [Log()] if watched else [Observer()]))
    layouts = teaming.layouts
    speed = layouts["driver"].scalar(driver.shown, "speed")
    np.testing.assert_array_equal(speed, layouts["driver"].scalar(before, "speed"))
    assert np.count_nonzero(driver.shown) == np.count_nonzero(speed) == 4
    assert (layouts["vehicle_ai"].chosen(hmi.shown, "intended_action") == 1).all()
    assert (np.count_nonzero(hmi.shown) == 4) == (not watched)  # else the lidar too, for one


def test_a_policy_without_a_list_of_parts_is_shown_all():
    driver, hmi = Watching(), Watching()
    teaming = begin(CONFIG, driver, hmi, SEEDS, "batched")
    before = teaming.observe("driver")
    next(turns(teaming, driver, hmi))
    np.testing.assert_array_equal(driver.shown, before)
    assert hmi.shown.any(axis=0).sum() > 10


def test_play_ends_when_the_last_episode_has_ended():
    driver, hmi, log = Counting(), RandomAlert(0.5), Log()
    teaming = begin(CONFIG, driver, hmi, SEEDS, "batched")
    assert play(teaming, driver, hmi, [log]) is teaming
    assert teaming.over.all()
    assert len(log.calls) == 3 * teaming.steps.max()
    play(teaming, driver, hmi, [log])
    assert len(log.calls) == 3 * teaming.steps.max()  # nothing is left to play


def test_a_turn_that_fails_can_be_taken_again():
    class Failing(Memoryless):
        def act(self, observations):
            raise OSError("no memory")

    driver, sound = Counting(), RandomAlert(0.0)
    teaming = begin(CONFIG, driver, sound, SEEDS, "batched")
    before = teaming.state()
    with pytest.raises(OSError, match="no memory"):
        next(turns(teaming, driver, Failing()))
    np.testing.assert_array_equal(teaming.state(), before)
    next(turns(teaming, driver, sound))
    assert (teaming.steps == 1).all()


def test_the_order_of_moves_is_written_once():
    """Only these modules take a turn in its two halves; all others go through Teaming.turn."""
    halves = re.compile(r"\.(intend|withdraw)\(")
    where = {
        path.relative_to(ROOT / "hmi_marl").as_posix()
        for path in (ROOT / "hmi_marl").rglob("*.py")
        if halves.search(path.read_text(encoding="utf-8"))
    }
    assert where == {
        "envs/teaming.py",  # the turn itself
        "envs/seats.py",  # a partner drives before the vehicle AI's seat is observed
        "envs/merge_v0.py",  # PettingZoo's AEC interface: one agent's action at a time
    }
    moves = re.compile(r"moves_sequentially\(")
    asked = {
        path.relative_to(ROOT / "hmi_marl").as_posix()
        for path in (ROOT / "hmi_marl").rglob("*.py")
        if moves.search(path.read_text(encoding="utf-8"))
    }
    assert asked == {
        "envs/seats.py",
        "agents/rollout.py",
        "agents/adaptive/hmis.py",  # refuses HMIs that move at the same time
        "agents/mixture.py",  # refuses HMIs that move at different times
    }
