import json
import pickle
from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
import pytest
from demonstrations import made_up
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env

from hmi_marl import DRIVERS, Scene
from hmi_marl.demonstrations.dataset import observed_layout
from hmi_marl.demonstrations.env import DemonstratedDriver, env_spec, team_config, team_of
from hmi_marl.demonstrations.parquet import read_observed, write_demonstrations
from hmi_marl.demonstrations.recording import CollectSettings, collect
from hmi_marl.envs.alerts import Fatigue
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import PAPER_DRIVERS, Choice, Driver, TraitDistributions, Uniform
from hmi_marl.envs.rewards import RewardWeights
from hmi_marl.files import json_value

CONFIG = TeamConfig(
    duration=2.0,
    scene=Scene(vehicles=(2, 3), lidar_cells=4),
    weights=RewardWeights(alert=3.0),
    alert_strengths=(0.5, 1.0),
)
TEAM = {name: value for name, value in json_value(CONFIG).items() if name != "driver"}


def make(**settings: Any) -> DemonstratedDriver:
    return DemonstratedDriver(**{"team": TEAM, "hmi": "random:0.2", "drivers": ["bart"]} | settings)


def test_a_team_comes_back_from_json() -> None:
    assert team_config(json.loads(json.dumps(TEAM))) == CONFIG
    assert team_config({}, duration=4.0) == TeamConfig(duration=4.0)
    assert team_config({"duration": 2.0}, duration=4.0) == TeamConfig(duration=2.0)
    with pytest.raises(TypeError, match="colour"):
        team_config({"colour": "red"})


def test_gymnasiums_own_check() -> None:
    check_env(make(), skip_render_check=True)


def test_it_sees_what_demonstrations_record_in_true_size() -> None:
    env = make(drivers=["homer"])
    seen, info = env.reset(seed=3)
    assert env.layout == observed_layout(CONFIG)
    whole = env.team.teaming
    for part in env.layout.parts:
        of_hmi = whole.observe("vehicle_ai")[0, whole.layouts["vehicle_ai"][part.name]]
        np.testing.assert_array_equal(seen[env.layout[part.name]], of_hmi)
    assert info["inflation"] == DRIVERS["homer"].inflation > 1


def test_the_driver_of_an_episode_can_be_named() -> None:
    env = make(drivers=["bart", "lisa"])
    for options, possible in ((None, ("bart", "lisa")), ({"driver": "homer"}, ("homer",))):
        _, info = env.reset(seed=1, options=options)
        assert info["beta"] in [DRIVERS[name].beta for name in possible]
    assert env.reset(seed=1)[1]["beta"] != DRIVERS["homer"].beta, "of that episode alone"
    any_driver = make(drivers=[])
    assert any_driver.reset(seed=1)[1]["beta"] != any_driver.reset(seed=2)[1]["beta"]
    with pytest.raises(ValueError, match="unknown driver 'ned'; known drivers: "):
        env.reset(options={"driver": "ned"})


def test_a_seed_is_that_of_the_episode() -> None:
    env = make()
    env.reset(seed=2**64 - 1)
    assert env.team.seed == 2**64 - 1
    env.reset()
    assert env.team.seed != 2**64 - 1, "the next one of the series"
    again = pickle.loads(pickle.dumps(env))
    np.testing.assert_array_equal(again.reset(seed=4)[0], env.reset(seed=4)[0])


def test_a_spec_goes_through_json() -> None:
    observed = made_up([3], names=("lisa", "population-0")).observed
    assert env_spec(observed) is None
    object.__setattr__(observed, "about", {"team": TEAM, "hmi": "random:0.2"})
    spec = env_spec(observed)
    assert spec is not None
    assert spec.kwargs["drivers"] == ["lisa"]
    env = gymnasium.make(EnvSpec.from_json(spec.to_json()))
    assert env.reset(seed=1)[0].shape == (observed_layout(CONFIG).size,)
    assert env.unwrapped.config.end_at_crash


def test_a_team_comes_back_from_its_dataset(tmp_path):
    settings = CollectSettings(
        duration=1.0, steps=5, vehicles=(2, 3), alert_window=4, end_at_crash=True
    )
    write_demonstrations(tmp_path, collect(settings))
    config, found = settings.team(PAPER_DRIVERS), team_of(read_observed(tmp_path))
    for name in ("scene", "weights", "alert_window", "duration", "end_at_crash"):
        assert getattr(found, name) == getattr(config, name)


def test_recordings_that_say_nothing_are_of_the_default_scene():
    observed = made_up([10, 7]).observed
    team = {"scene": {"lidar_cells": 4}}  # of the made-up layout
    config = team_of(replace(observed, about={"team": team}))
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


@pytest.mark.parametrize("driver", ["homer", ["lisa", Driver("own", 0.1, 0.2, 0.3, 4.0)], None])
def test_a_configuration_is_what_json_says_it_was(driver: Any) -> None:
    drawn = TraitDistributions(beta=Choice((0.1, 0.2)), eta=Uniform(0.5, 1.0))
    config = TeamConfig(
        driver=drawn if driver is None else driver,
        alert_strengths=(0.5, 1.0),
        fatigue=Fatigue(levels=4),
        scene=Scene(vehicles=(2, 3), target_speeds=(10.0, 20.0)),
    )
    assert team_config(json.loads(json.dumps(json_value(config)))) == config
