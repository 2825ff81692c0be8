import hashlib
import inspect
import subprocess
import sys
from dataclasses import fields
from pathlib import Path

import numpy as np
import pettingzoo
import pytest
from pettingzoo.test import api_test, parallel_api_test, parallel_seed_test, seed_test

import hmi_marl
from hmi_marl import Driver, Scene, TraitDistributions, merge_v0
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.observations import driver_layout, vehicle_ai_layout
from hmi_marl.envs.rewards import TERMS

SMALL = {"scene": Scene(vehicles=3), "duration": 3.0}
ATTENTIVE = Driver("attentive", beta=0.0, alpha=1.0, eta=0.0, inflation=1.0)
EVERY_KIND = [
    {},
    {"driver": "bart", "observe_traits": False, "ai_sees_attention": False},
    {"driver": ["lisa", "homer"], "reward": "individual", "end_at_crash": False},
    {"driver": TraitDistributions(), "reward": "driving", "alert_window": 1},
]


@pytest.mark.usefixtures("unmeasured")
@pytest.mark.parametrize("settings", EVERY_KIND, ids=str)
def test_pettingzoos_own_checks(settings):
    api_test(merge_v0.env(**SMALL, **settings), num_cycles=40)
    parallel_api_test(merge_v0.parallel_env(**SMALL, **settings), num_cycles=40)
    seed_test(lambda: merge_v0.env(**SMALL, **settings), num_cycles=40)
    parallel_seed_test(lambda: merge_v0.parallel_env(**SMALL, **settings), num_cycles=40)


@pytest.mark.slow
def test_pettingzoos_checks_at_whole_size():
    api_test(merge_v0.env(), num_cycles=105)
    parallel_api_test(merge_v0.parallel_env(), num_cycles=105)


def aec_episode(seed, **settings):
    """Everything that one AEC episode of random actions shows."""
    env = merge_v0.env(**settings)
    env.reset(seed=seed)
    rng = np.random.default_rng(seed)
    shown = []
    for agent in env.agent_iter():
        observation, reward, terminated, truncated, info = env.last()
        shown.append((agent, observation.tobytes(), reward, terminated, truncated, sorted(info)))
        shown.append((env.state().tobytes(), tuple(info.values())))
        over = terminated or truncated
        env.step(None if over else int(rng.integers(env.action_space(agent).n)))
    return shown


DIGEST = "import test_merge_v0 as t; print(t.digest())"


def digest():
    """A fingerprint of whole episodes, for another process to make again."""
    shown = [aec_episode(seed, driver=["bart", "marge"], duration=4.0) for seed in (1, 2)]
    return hashlib.sha256(repr(shown).encode()).hexdigest()


@pytest.mark.usefixtures("unmeasured")
def test_whole_episodes_are_equal_in_a_new_process():
    command = [sys.executable, "-c", DIGEST]
    here = Path(__file__).parent
    other = subprocess.run(command, cwd=here, capture_output=True, text=True, check=True)
    assert other.stdout.strip().splitlines()[-1] == digest()


def test_whole_episodes_differ_by_seed_and_agree_by_seed():
    assert aec_episode(4, **SMALL) == aec_episode(4, **SMALL)
    assert aec_episode(4, **SMALL) != aec_episode(5, **SMALL)


def test_resets_without_a_seed_go_on_in_a_reproducible_series():
    first, second = merge_v0.raw_env(**SMALL), merge_v0.raw_env(**SMALL)
    for env in (first, second):
        env.reset(seed=9)
        env.reset()
        env.reset()
    np.testing.assert_array_equal(first.state(), second.state())
    assert first.team.seed == second.team.seed != 9
    first.reset(seed=9)
    second.reset()
    assert first.team.seed == 9
    assert not np.array_equal(first.state(), second.state())
    unseeded = [merge_v0.raw_env(**SMALL) for _ in range(2)]
    for env in unseeded:
        env.reset()
    assert unseeded[0].team.seed != unseeded[1].team.seed


def seen_intent(env, observation):
    return int(env.layout("vehicle_ai").chosen(observation, "intended_action"))


def test_taking_turns_the_ai_observes_the_present_intent():
    env = merge_v0.raw_env(**SMALL, driver=ATTENTIVE)
    env.reset(seed=0)
    for intended in (1, 3, 4, 1):
        env.step(intended)
        assert env.agent_selection == "vehicle_ai"
        assert seen_intent(env, env.last()[0]) == intended
        env.step(0)


def test_at_once_the_ai_observes_the_previous_intent():
    env = merge_v0.parallel_env(**SMALL, driver=ATTENTIVE)
    observations, _ = env.reset(seed=0)
    assert seen_intent(env, observations["vehicle_ai"]) == -1
    for intended in (1, 3, 4, 1):
        observations, *_ = env.step({"driver": intended, "vehicle_ai": 0})
        assert seen_intent(env, observations["vehicle_ai"]) == intended


def test_turns_and_at_once_are_the_same_world():
    turns, at_once = merge_v0.raw_env(**SMALL), merge_v0.parallel_env(**SMALL)
    turns.reset(seed=3)
    observations, _ = at_once.reset(seed=3)
    rng = np.random.default_rng(0)
    while at_once.agents:
        actions = {"driver": int(rng.integers(5)), "vehicle_ai": int(rng.integers(2))}
        np.testing.assert_array_equal(turns.observe("driver"), observations["driver"])
        turns.step(actions["driver"])
        turns.step(actions["vehicle_ai"])
        observations, rewards, terminations, truncations, infos = at_once.step(actions)
        assert turns.rewards == rewards
        assert turns.terminations == terminations
        assert turns.truncations == truncations
        assert turns.infos == infos


@pytest.mark.parametrize("end", ["time", "crash"])
def test_an_episode_ends_for_both_at_once_with_the_last_rewards(end):
    settings = {"driver": ATTENTIVE, "reward": "individual"}
    if end == "time":
        env = merge_v0.env(**settings, duration=0.6)
    else:
        env = merge_v0.env(**settings, scene=Scene(lanes=1, vehicles=50))
    env.reset(seed=2)
    last = {}
    for agent in env.agent_iter():
        _, reward, terminated, truncated, info = env.last()
        if terminated or truncated:
            last[agent] = (reward, terminated, truncated, info)
            env.step(None)
        else:
            env.step(3 if agent == "driver" else 0)  # always faster: runs into another car
    assert set(last) == {"driver", "vehicle_ai"}
    for reward, terminated, truncated, info in last.values():
        assert (terminated, truncated) == ((False, True) if end == "time" else (True, False))
        assert info["crashed"] == (end == "crash")
        assert reward != 0
    info = last["driver"][3]
    driving = ("collision", "speed_reward", "right_lane", "merging", "lane_change", "distraction")
    assert last["driver"][0] == pytest.approx(sum(info[name] for name in driving))
    assert last["vehicle_ai"][0] == info["alert"] + info["accept_alert"] == 10.0
    assert env.agents == []


def test_info_carries_the_promised_names():
    env = merge_v0.parallel_env(**SMALL)
    _, infos = env.reset(seed=0)
    promised = {"distracted", "accepted", "counter", "applied_action", "crashed", "speed", *TERMS}
    assert promised <= set(infos["driver"])
    _, rewards, *_, infos = env.step({"driver": 1, "vehicle_ai": 1})
    assert infos["driver"] == infos["vehicle_ai"]
    info = infos["driver"]
    assert info["applied_action"] == 1
    assert (info["accepted"], info["counter"]) == (True, 0)
    assert info["inflation"] == 9.0  # Homer
    assert rewards["driver"] == pytest.approx(sum(info[name] for name in TERMS))


def test_the_documented_sizes_are_true():
    config = merge_v0.raw_env().config
    page = merge_v0.__doc__
    for agent, layout in (
        ("driver", driver_layout(config)),
        ("vehicle_ai", vehicle_ai_layout(config)),
    ):
        assert f"`{agent}` ({layout.size})" in page
        for part in layout.slices:
            assert f"`{part}`" in page
    for term in TERMS:
        assert f"`{term}`" in page


def test_the_state_fits_its_space():
    env = merge_v0.env(driver="homer")
    env.reset(seed=1)
    assert env.state_space.contains(env.state())
    assert env.state().shape == (env.unwrapped.state_layout.size,)


def test_both_are_registered_with_pettingzoo():
    aec = pettingzoo.make("aec", "hmi_marl/merge-v0", driver="bart", **SMALL)
    parallel = pettingzoo.make("parallel", "hmi_marl/merge_v0", driver="bart", **SMALL)
    assert aec.possible_agents == parallel.possible_agents == ["driver", "vehicle_ai"]
    assert aec.metadata["is_parallelizable"] is False
    hmi_marl.register_envs()  # a second time changes nothing and warns of nothing


@pytest.mark.parametrize("action", [5, -1, 1.5, "left", None, [1, 2]])
def test_a_drivers_action_out_of_range_is_refused(action):
    env = merge_v0.env(**SMALL)
    env.reset(seed=0)
    with pytest.raises(ValueError, match="driver"):
        env.step(action)
    env.step(1)  # and the environment can go on
    with pytest.raises(ValueError, match="vehicle_ai is out of range: it is 0 to 1"):
        env.step(2)


def test_at_once_a_bad_action_leaves_the_team_as_it_was():
    env = merge_v0.parallel_env(**SMALL)
    env.reset(seed=0)
    before = env.state()
    for actions, message in (
        ({"driver": 1, "vehicle_ai": 7}, "action 7 of vehicle_ai"),
        ({"driver": 9, "vehicle_ai": 0}, "action 9 of driver"),
        ({"driver": 1}, "actions are needed for"),
    ):
        with pytest.raises(ValueError, match=message):
            env.step(actions)
    np.testing.assert_array_equal(env.state(), before)
    env.step({"driver": 1, "vehicle_ai": 0})


def test_stepping_after_the_end_is_refused():
    parallel = merge_v0.parallel_env(**SMALL | {"duration": 0.2})
    parallel.reset(seed=0)
    parallel.step({"driver": 1, "vehicle_ai": 0})
    with pytest.raises(RuntimeError, match="episode is over: call reset"):
        parallel.step({"driver": 1, "vehicle_ai": 0})
    assert parallel.step({}) == ({}, {}, {}, {}, {})  # as wrappers that outlive the agents ask
    for make in (merge_v0.raw_env, merge_v0.env):
        env = make(**SMALL | {"duration": 0.2})
        env.reset(seed=0)
        env.step(1)
        env.step(0)
        with pytest.raises(ValueError, match="only valid action is None"):
            env.step(1)
        env.step(None)
        env.step(None)
        for action in (1, None):
            with pytest.raises(RuntimeError, match="episode is over: call reset"):
                env.step(action)
        env.reset(seed=0)
        env.step(1)


def test_before_the_first_reset_everything_asks_for_it():
    raw, parallel = merge_v0.raw_env(**SMALL), merge_v0.parallel_env(**SMALL)
    for call in (
        lambda: raw.step(1),
        lambda: raw.observe("driver"),
        raw.state,
        lambda: parallel.step({"driver": 1, "vehicle_ai": 0}),
        lambda: parallel.step({}),
        parallel.state,
    ):
        with pytest.raises(RuntimeError, match=r"call reset\(\) first"):
            call()


@pytest.mark.parametrize("make", [merge_v0.env, merge_v0.raw_env, merge_v0.parallel_env])
def test_every_keyword_is_shown_and_the_error_for_a_typo_names_the_known_ones(make):
    shown = inspect.signature(make).parameters
    assert set(shown) == {"world", "render_mode", *(field.name for field in fields(TeamConfig))}
    assert shown["reward"].default == "team"
    message = (
        rf"{make.__name__}.* got an unexpected keyword argument 'drvier'; "
        r"did you mean driver\? help\(.*\) lists all"
    )
    with pytest.raises(TypeError, match=message):
        make(drvier="bart")


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"driver": "ned"}, "unknown driver"),
        ({"world": "moon"}, "unknown world"),
        ({"render_mode": "ascii"}, "render_mode is None or one of"),
    ],
)
def test_bad_keywords_are_refused(settings, message):
    for make in (merge_v0.env, merge_v0.raw_env, merge_v0.parallel_env):
        with pytest.raises(ValueError, match=message):
            make(**settings)


@pytest.mark.parametrize("make", [merge_v0.env, merge_v0.raw_env, merge_v0.parallel_env])
def test_random_numbers_for_wrappers_follow_the_seed(make):
    env, other = make(**SMALL), make(**SMALL)
    assert env.unwrapped.np_random is env.unwrapped.np_random
    assert env.unwrapped.np_random.random() != other.unwrapped.np_random.random()
    drawn = []
    for seed in (1, 1, 2):
        env.reset(seed=seed)
        drawn.append(env.unwrapped.np_random.random())
    assert drawn[0] == drawn[1] != drawn[2]
    assert drawn[0] == np.random.default_rng(1).random()
    env.reset()
    assert env.unwrapped.np_random.random() not in drawn, "it goes on, as the episodes do"


def test_random_numbers_for_wrappers_change_no_episode():
    env = merge_v0.parallel_env(**SMALL)
    states = []
    for draws in (0, 3):
        env.reset(seed=1)
        env.np_random.random(draws)
        env.step({"driver": 1, "vehicle_ai": 0})
        env.reset()
        states.append(env.state())
    np.testing.assert_array_equal(*states)


def test_a_refused_action_keeps_the_rewards_that_wait():
    env = merge_v0.env(**SMALL)
    env.reset(seed=0)
    env.step(1)
    env.step(0)
    before = env.last()[1]
    assert before != 0.0
    with pytest.raises(ValueError, match="out of range"):
        env.step(9)
    assert env.last()[1] == before


def test_pictures():
    env = merge_v0.env(render_mode="rgb_array", **SMALL)
    env.reset(seed=0)
    picture = env.render()
    assert picture.ndim == 3
    assert picture.dtype == np.uint8
    env.close()
    blind = merge_v0.parallel_env(**SMALL)
    blind.reset(seed=0)
    with pytest.raises(RuntimeError, match="render_mode="):
        blind.render()
    blind.close()
