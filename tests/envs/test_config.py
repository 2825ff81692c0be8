import math

import pytest

from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import DRIVERS, Driver, TraitDistributions
from hmi_marl.envs.scene import Scene


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"driver": "ned"}, "unknown driver 'ned'; known drivers: lisa"),
        ({"reward": "selfish"}, "reward= is one of"),
        ({"alert_window": 0}, "at least 1 step"),
        ({"duration": 0.0}, "positive number of seconds"),
        ({"duration": math.nan}, "positive number of seconds"),
        ({"duration": 0.5}, "whole number of steps"),
        ({"duration": 20.0, "scene": Scene(after=100.0)}, "too short"),
    ],
)
def test_a_bad_setting_is_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        TeamConfig(**settings)


def test_a_scene_that_is_none_is_refused():
    with pytest.raises(TypeError, match="scene= takes a Scene"):
        TeamConfig(scene={"lanes": 3})


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
