import inspect
import math
from dataclasses import fields

import numpy as np
import pytest

from hmi_marl.envs.config import TeamConfig, takes_team_settings
from hmi_marl.envs.drivers import DRIVERS, Driver, TraitDistributions
from hmi_marl.envs.scene import Scene


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"driver": "ned"}, "unknown driver 'ned'; known: lisa"),
        ({"reward": "selfish"}, "reward is one of"),
        ({"alert_window": 0}, "alert_window lies in 1 to 10000 steps"),
        ({"duration": 0.0}, "duration lies in"),
        ({"duration": math.nan}, "duration lies in"),
        ({"duration": 0.5}, "whole number of steps"),
        ({"duration": 20.0, "scene": Scene(after=100.0)}, "too short"),
    ],
)
def test_a_bad_setting_is_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        TeamConfig(**settings)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"scene": {"lanes": 3}}, "scene is a Scene, not"),
        ({"weights": {"collision": -5.0}}, "weights is a RewardWeights, not"),
        ({"weights": None}, "weights is a RewardWeights, not"),
        ({"observe_traits": 1}, "observe_traits is True or False, not 1"),
        ({"ai_sees_attention": "no"}, "ai_sees_attention is True or False, not 'no'"),
        ({"end_at_crash": None}, "end_at_crash is True or False, not None"),
        ({"duration": "20"}, "duration is a number, not '20'"),
        ({"duration": True}, "duration is a number, not True"),
        ({"alert_window": 7.0}, "alert_window is a whole number"),
        ({"driver": {"lisa", "bart"}}, "driver= takes"),
    ],
)
def test_a_setting_of_the_wrong_type_is_refused_by_name(settings, message):
    with pytest.raises(TypeError, match=message):
        TeamConfig(**settings)


def test_numbers_and_truth_values_of_numpy_become_pythons():
    config = TeamConfig(observe_traits=np.False_, duration=np.float32(2), alert_window=np.int64(3))
    assert config == TeamConfig(observe_traits=False, duration=2, alert_window=3)
    assert config.observe_traits is False
    assert type(config.duration) is float
    assert type(config.alert_window) is int


def test_a_function_that_takes_team_settings_shows_them_and_refuses_others():
    @takes_team_settings
    def make(world="highway", **settings):
        """Make it."""
        return world, settings

    assert make("batched", driver="bart") == ("batched", {"driver": "bart"})
    names = [field.name for field in fields(TeamConfig)]
    assert list(inspect.signature(make).parameters) == ["world", *names]
    assert make.__doc__ == "Make it."
    with pytest.raises(
        TypeError,
        match=r"make\(\) got an unexpected keyword argument 'drvier'; did you mean driver\?",
    ):
        make(drvier="bart")


def test_the_horizon_counts_policy_steps():
    assert TeamConfig().horizon == 100
    assert TeamConfig(duration=0.4).horizon == 2
    assert TeamConfig(duration=10.0, scene=Scene(policy_frequency=3)).horizon == 30


def test_the_only_driver_is_known_if_there_is_one():
    mona = Driver("mona", 0.1, 0.9, 0.5, 2.0)
    assert TeamConfig(driver="Bart").only_driver is DRIVERS["bart"]
    assert TeamConfig(driver=mona).only_driver is mona
    assert TeamConfig(driver=[mona, mona]).only_driver is mona
    assert TeamConfig(driver=["lisa", mona]).only_driver is None
    assert TeamConfig(driver=TraitDistributions()).only_driver is None
