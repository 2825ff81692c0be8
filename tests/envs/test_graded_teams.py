"""Graded alerts and fatigue in every interface; the paper's bit stays as it was."""

import hashlib

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env
from pettingzoo.test import api_test, parallel_api_test, parallel_seed_test, seed_test
from standing_world import standing_teams

import hmi_marl
from hmi_marl import Scene, TraitDistributions, merge_v0
from hmi_marl.agents import partners
from hmi_marl.envs.alerts import Fatigue
from hmi_marl.envs.config import TeamConfig, TeamSettings
from hmi_marl.envs.observations import driver_layout, state_layout, vehicle_ai_layout
from hmi_marl.envs.streams import team_seed

SMALL = {"scene": Scene(vehicles=2), "duration": 3.0}
GRADES = (0.2, 0.6, 1.0)
WEARY = Fatigue(levels=5, per_alert=3, effect=0.7)
GRADED, WEARIED = {"alert_strengths": GRADES}, {"alert_strengths": GRADES, "fatigue": WEARY}
EVERY_KIND = [GRADED, WEARIED, {"fatigue": WEARY, "ai_sees_attention": False}]


def seeds(count):
    return np.arange(count, dtype=np.uint64)


def play(teams, rng):
    """An episode of random actions; yields the actions and what each step gave."""
    while not teams.over.all():
        intents = rng.integers(0, 5, teams.num_teams)
        alerts = rng.integers(0, teams.alerts.choices, teams.num_teams)
        teams.intend(intents)
        yield intents, alerts, teams.step(alerts)


BEFORE_GRADES = "51f9dd933865873ae36283c09a3e4033c9166b8a5ae54d2d6c27c1b7d5a70d12"
"""A fingerprint of episodes, taken before there were strengths and fatigue."""


def test_by_default_episodes_are_to_the_bit_as_they_were_before():
    teams = standing_teams(50, driver=TraitDistributions(), duration=8.0)
    teams.reset(seeds(50))
    found = hashlib.sha256()
    for *_, result in play(teams, np.random.default_rng(0)):
        for terms in (*result.terms.values(), *result.rewards.values()):
            found.update(np.round(terms, 9).tobytes())
        for agent in ("driver", "vehicle_ai"):
            found.update(teams.observe(agent).tobytes())
        found.update(teams.state().tobytes())
    assert found.hexdigest() == BEFORE_GRADES


def test_by_default_spaces_and_layouts_are_those_of_the_paper():
    env = merge_v0.env()
    assert env.action_space("vehicle_ai").n == 2
    assert (driver_layout(TeamConfig()).size, vehicle_ai_layout(TeamConfig()).size) == (52, 65)
    assert state_layout(TeamConfig()).size == 97
    env.reset(seed=1)
    assert not {"fatigue", "strength"} & set(env.infos["driver"])


@pytest.mark.parametrize("settings", EVERY_KIND, ids=str)
def test_pettingzoos_own_checks(settings):
    api_test(merge_v0.env(**SMALL, **settings), num_cycles=40)
    parallel_api_test(merge_v0.parallel_env(**SMALL, **settings), num_cycles=40)
    seed_test(lambda: merge_v0.env(**SMALL, **settings), num_cycles=40)
    parallel_seed_test(lambda: merge_v0.parallel_env(**SMALL, **settings), num_cycles=40)


@pytest.mark.parametrize("make", [partners.merge_driver, partners.merge_hmi])
def test_gymnasiums_own_check(make):
    env = make(**SMALL, **WEARIED)
    check_env(env, skip_render_check=True)
    assert env.action_space.n == (5 if env.seat == "driver" else 4)


def test_turns_at_once_vectors_and_both_worlds_are_the_same_episode():
    settings = {"driver": "average", "scene": Scene(vehicles=3), "duration": 4.0, **WEARIED}
    turns = merge_v0.raw_env(world="highway", **settings)
    at_once = merge_v0.parallel_env(world="batched", **settings)
    many = hmi_marl.make_vec(3, "team", world="batched", seed=7, threads=1, **settings)
    seed = int(team_seed(7, 1))
    turns.reset(seed=seed)
    at_once.reset(seed=seed)
    rng = np.random.default_rng(3)
    levels = []
    while at_once.agents:
        actions = np.stack([rng.integers(0, 5, 3), rng.integers(0, 4, 3)], axis=1)
        driver, alert = (int(action) for action in actions[1])
        turns.step(driver)
        turns.step(alert)
        _, rewards, ends, cuts, infos = at_once.step({"driver": driver, "vehicle_ai": alert})
        _, _, dones, extras = many.step(torch.from_numpy(actions))
        assert turns.rewards == pytest.approx(rewards, abs=1e-9)
        assert turns.terminations == ends
        for name in ("distracted", "accepted", "counter", "strength", "fatigue", "alert"):
            assert turns.infos["driver"][name] == infos["driver"][name]
        assert extras["rewards"]["driver"][1] == np.float32(rewards["driver"])
        over = ends["driver"] or cuts["driver"]
        assert bool(dones[1]) == over
        if not over:
            seen = many.get_observations()["critic"][1].numpy()
            np.testing.assert_array_equal(seen, at_once.state())
        levels.append(infos["driver"]["fatigue"])
    assert max(levels) == WEARY.levels


def test_team_k_is_the_same_alone_and_among_many():
    many = standing_teams(20, driver=TraitDistributions(), duration=6.0, **WEARIED)
    alone = standing_teams(1, driver=TraitDistributions(), duration=6.0, **WEARIED)
    many.reset(seeds(20))
    alone.reset(seeds(20)[13:14])
    for intents, alerts, result in play(many, np.random.default_rng(1)):
        alone.intend(intents[13:14])
        own = alone.step(alerts[13:14])
        assert {name: values[13] for name, values in result.terms.items()} == {
            name: values[0] for name, values in own.terms.items()
        }
        np.testing.assert_array_equal(many.state()[13], alone.state()[0])


def test_what_the_seats_see_are_strengths_and_the_share_of_the_levels():
    teams = standing_teams(1, driver="lisa", **WEARIED)
    teams.reset(seeds(1))
    seen = []
    for alert in (3, 1, 0, 2):
        teams.intend([1])
        teams.step([alert])
        layout, ai = teams.layouts["vehicle_ai"], teams.observe("vehicle_ai")
        names = ("alerted", "accepted", "counter", "fatigue")
        seen.append([float(layout.scalar(ai, name)[0]) for name in names])
        driver = teams.layouts["driver"].scalar(teams.observe("driver"), "alerted")
        assert float(driver[0]) == seen[-1][0]
        state = teams.state_layout.scalar(teams.state(), "fatigue")
        assert float(state[0]) == seen[-1][3]
    # Rises of 3 and ceil(0.6) = 1, a rest of 1, ceil(1.8) = 2: levels 3, 4, 3, 5 of 5.
    expected = [(1.0, 1.0, 0, 3), (0.2, 1.0, 1, 4), (0.0, 1.0, 2, 3), (0.6, 1.0, 3, 5)]
    wanted = [(a, i, c / 7, f / 5) for a, i, c, f in expected]
    np.testing.assert_allclose(seen, wanted, atol=1e-6)


def test_fatigue_is_one_more_part_where_attention_is_seen():
    plain, weary = TeamConfig(), TeamConfig(fatigue=WEARY)
    hidden = TeamConfig(fatigue=WEARY, ai_sees_attention=False)
    assert vehicle_ai_layout(weary).size == vehicle_ai_layout(plain).size + 1
    assert vehicle_ai_layout(weary)["fatigue"].start == vehicle_ai_layout(plain)["traits"].start
    assert "fatigue" not in vehicle_ai_layout(hidden)
    assert "fatigue" in state_layout(hidden)
    assert driver_layout(weary) == driver_layout(plain)
    assert vehicle_ai_layout(TeamConfig(**GRADED)) == vehicle_ai_layout(plain)


def test_rewards_of_graded_alerts_by_hand():
    teams = standing_teams(4, driver="marge", reward="attention", **GRADED)
    teams.reset(seeds(4))
    teams.intend([1] * 4)
    result = teams.step([0, 1, 2, 3])
    np.testing.assert_allclose(result.terms["alert"], [10.0, 8.0, 4.0, 0.0])
    # η = 1 and β = 0.2, so that every alert keeps Marge attentive.
    assert result.terms["distraction"][1:].tolist() == [0.0, 0.0, 0.0]
    assert result.terms["accept_alert"].tolist() == [0.0] * 4


def test_info_holds_the_strength_in_effect_and_the_level():
    env = merge_v0.parallel_env(driver="homer", **SMALL, **WEARIED)
    _, infos = env.reset(seed=2)
    assert (infos["driver"]["strength"], infos["driver"]["fatigue"]) == (0.0, 0)
    *_, infos = env.step({"driver": 1, "vehicle_ai": 2})
    info = infos["vehicle_ai"]
    assert (info["accepted"], info["strength"], info["fatigue"]) == (True, 0.6, 2)
    assert type(info["fatigue"]) is int


def test_an_alert_beyond_the_strongest_is_refused_everywhere():
    env = merge_v0.parallel_env(**SMALL, **GRADED)
    env.reset(seed=1)
    with pytest.raises(ValueError, match="action 4 of vehicle_ai is out of range: it is 0 to 3"):
        env.step({"driver": 1, "vehicle_ai": 4})
    many = hmi_marl.make_vec(2, "team", world="highway", **SMALL, **GRADED)
    assert many.action_sizes == (5, 4)
    with pytest.raises(ValueError, match="whole number from 0 to 3"):
        many.step(torch.tensor([[1, 0], [1, 4]]))
    teams = standing_teams(2, **GRADED)
    teams.reset(seeds(2))
    teams.intend([1, 1])
    with pytest.raises(ValueError, match="vehicle_ai action 4 is out of range: it is one of 0 to"):
        teams.step([0, 4])


def test_the_alert_of_an_ended_team_is_not_read():
    teams = standing_teams(2, duration=0.4, **GRADED)
    teams.reset(seeds(2))
    for alerts in ([1, 1], [1, 1]):
        teams.intend([1, 1])
        teams.step(alerts)
    teams.reset(seeds(2), np.array([False, True]))
    teams.intend([1, 1])
    result = teams.step([-77, 2])
    assert result.terms["alert"][0] == 0.0
    assert teams.alerted.tolist() == [1, 2]


def test_a_count_of_alerts_does_not_weigh_them():
    env = hmi_marl.make_vec(
        2, "team", world="highway", seed=1, **(SMALL | {"duration": 0.6}), **GRADED
    )
    for alerts in ([3, 0], [2, 0], [0, 1]):
        *_, extras = env.step(torch.tensor([[1, alert] for alert in alerts]))
    assert extras["log"]["Episode/alerts"].tolist() == [2.0, 1.0]


def test_gymnasium_make_takes_the_keywords():
    env = gymnasium.make("hmi_marl/MergeHMI-v0", partner="rule", **SMALL, **WEARIED)
    assert env.action_space.n == 4
    env.close()


def test_what_a_command_takes_becomes_the_teams_setting():
    team = TeamSettings(alert_strengths=(0.5, 1.0), fatigue=(4, 1, 0.25)).team("homer")
    assert team.alert_strengths == (0.5, 1.0)
    assert team.fatigue == Fatigue(4, 1, 0.25)
    assert TeamSettings().team("homer") == TeamConfig(driver="homer")


@pytest.mark.parametrize(
    ("settings", "error", "message"),
    [
        ({"alert_strengths": (1.0, 0.5)}, ValueError, "alert_strengths rise within"),
        ({"alert_strengths": 1.0}, TypeError, "alert_strengths is a tuple of numbers, not 1.0"),
        ({"fatigue": 0.5}, TypeError, "fatigue is a Fatigue, not 0.5"),
    ],
)
def test_bad_settings_are_refused_at_the_door(settings, error, message):
    for make in (TeamConfig, merge_v0.env, merge_v0.parallel_env, partners.merge_hmi):
        with pytest.raises(error, match=message):
            make(**settings)
