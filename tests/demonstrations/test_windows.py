from dataclasses import replace

import numpy as np
import pytest
from demonstrations import made_up

from hmi_marl.demonstrations.dataset import alert_rate, held_out
from hmi_marl.demonstrations.env import team_of
from hmi_marl.demonstrations.parquet import read_observed, write_demonstrations
from hmi_marl.demonstrations.recording import CollectSettings, collect
from hmi_marl.envs.drivers import PAPER_DRIVERS
from hmi_marl.envs.rewards import RewardWeights
from hmi_marl.envs.scene import Scene


def test_a_team_comes_back_from_its_dataset(tmp_path):
    settings = CollectSettings(
        duration=1.0, steps=5, vehicles=(2, 3), alert_window=4, end_at_crash=True
    )
    write_demonstrations(tmp_path, collect(settings))
    config, told = settings.team(PAPER_DRIVERS), team_of(read_observed(tmp_path))
    for name in ("scene", "weights", "alert_window", "duration", "end_at_crash"):
        assert getattr(told, name) == getattr(config, name)


def test_recordings_that_tell_nothing_are_of_the_default_scene():
    observed = made_up([10, 7]).observed
    told = {"scene": {"lidar_cells": 4}}  # of the made-up layout
    config = team_of(replace(observed, about={"team": told}))
    assert config.duration == 2.0
    assert not config.end_at_crash
    assert config.weights == RewardWeights()
    assert replace(config.scene, after=None) == Scene(lidar_cells=4)


def test_states_that_do_not_fit_their_scene_are_refused():
    with pytest.raises(ValueError, match="not laid out as their scene would be seen"):
        team_of(made_up([10]).observed)


def test_windows_longer_than_an_episode_are_refused():
    observed = made_up([10]).observed
    team = {"scene": {"lidar_cells": 4}, "duration": 1.0}
    with pytest.raises(ValueError, match="a window has 10 steps, but an episode of this team 5"):
        team_of(replace(observed, about={"team": team}))


def test_alerts_count_by_steps_that_there_were():
    observed = made_up([4, 2]).observed
    alerts = np.array([[1, 0, 0, 1], [1, 0, 0, 0]])
    assert alert_rate(replace(observed, alerts=alerts)) == 0.5


def test_the_last_windows_of_every_driver_are_held_out():
    driver = [0, 0, 1, 0, 1, 0, 0, -1]
    observed = made_up([3] * 8, driver=driver, names=("ada", "bob")).observed
    marked = held_out(observed, 0.4)
    # Of ada's windows 0, 1, 3, 5, 6 the last two, of bob's 2 and 4 the last one.
    assert np.flatnonzero(marked).tolist() == [4, 5, 6]
    assert not held_out(observed, 0.0).any()
