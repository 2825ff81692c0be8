import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from hmi_marl import Scene, merge_v0
from hmi_marl.agents import RandomAlert, RuleBasedDriver
from hmi_marl.envs.config import TeamConfig

SMALL = {"scene": Scene(vehicles=3), "duration": 3.0}
SEATS = ["hmi_marl/MergeDriver-v0", "hmi_marl/MergeHMI-v0"]


@pytest.mark.parametrize("seat", SEATS)
@pytest.mark.parametrize("settings", [{}, {"driver": "bart", "ai_sees_attention": False}], ids=str)
def test_gymnasiums_own_check(seat, settings):
    env = gymnasium.make(seat, render_mode="rgb_array", **SMALL, **settings)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "render_mode=.human. on a machine without a display")
        check_env(env.unwrapped)
    env.close()


def episode(env, seed, choose):
    observation, info = env.reset(seed=seed)
    shown = [(observation.tobytes(), None, info)]
    over = False
    while not over:
        observation, reward, terminated, truncated, info = env.step(choose(observation))
        shown.append((observation.tobytes(), reward, info))
        over = terminated or truncated
    return shown


@pytest.mark.parametrize("seat", SEATS)
def test_episodes_are_equal_by_seed(seat):
    env = gymnasium.make(seat, **SMALL)
    assert episode(env, 3, lambda _: 1) == episode(env, 3, lambda _: 1)
    assert episode(env, 3, lambda _: 1) != episode(env, 4, lambda _: 1)


def test_the_drivers_seat_is_the_team_with_that_hmi():
    view = gymnasium.make("hmi_marl/MergeDriver-v0", partner="always", **SMALL)
    whole = merge_v0.raw_env(**SMALL)
    observation, _ = view.reset(seed=1)
    whole.reset(seed=1)
    over = False
    while not over:
        np.testing.assert_array_equal(observation, whole.observe("driver"))
        whole.step(3)
        whole.step(1)
        observation, reward, terminated, truncated, info = view.step(3)
        assert reward == whole.rewards["driver"]
        assert info == whole.infos["driver"]
        over = terminated or truncated


def test_the_hmis_seat_sees_what_its_driver_is_about_to_do():
    view = gymnasium.make("hmi_marl/MergeHMI-v0", partner=lambda _: 4, driver="lisa", **SMALL)
    layout = view.unwrapped.layout
    observation, _ = view.reset(seed=1)
    assert int(layout.chosen(observation, "intended_action")) == 4
    assert int(layout.chosen(observation, "previous_intended_action")) == -1
    observation, *_ = view.step(0)
    assert int(layout.chosen(observation, "previous_intended_action")) == 4


def test_partners_by_name_by_policy_and_by_function_are_the_same():
    config = TeamConfig(**SMALL)
    rule = RuleBasedDriver(config)
    partners = ["rule", rule, lambda observation: rule.act(observation[None])[0]]
    episodes = [
        episode(gymnasium.make("hmi_marl/MergeHMI-v0", partner=partner, **SMALL), 5, lambda _: 0)
        for partner in partners
    ]
    assert episodes[0] == episodes[1] == episodes[2]
    alerts = [
        episode(gymnasium.make("hmi_marl/MergeDriver-v0", partner=partner, **SMALL), 5, lambda _: 1)
        for partner in ("random:0.3", RandomAlert(0.3))
    ]
    assert alerts[0] == alerts[1]


@pytest.mark.parametrize("seat", SEATS)
def test_bad_partners_and_actions_are_refused(seat):
    with pytest.raises(ValueError, match=r"unknown .*known"):
        gymnasium.make(seat, partner="hal")
    with pytest.raises(TypeError, match="partner= takes"):
        gymnasium.make(seat, partner=3)
    env = gymnasium.make(seat, **SMALL | {"duration": 0.2}).unwrapped
    with pytest.raises(RuntimeError, match=r"call reset\(\)"):
        env.step(0)
    env.reset(seed=0)
    with pytest.raises(ValueError, match="out of range"):
        env.step(7)
    env.step(0)
    with pytest.raises(RuntimeError, match="episode is over"):
        env.step(0)
