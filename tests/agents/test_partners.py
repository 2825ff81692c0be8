import warnings

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env

from hmi_marl import Scene, make_vec, merge_v0
from hmi_marl.agents import RandomAlert, RuleBasedDriver
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.single import MergeDriver, MergeHMI

FEW = {"scene": Scene(vehicles=4), "duration": 3.0}
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


class Partner:
    """A Policy that gives these answers, one after the other."""

    def __init__(self, *answers):
        self.answers = list(answers)

    def reset(self, seeds, which=None):
        pass

    def act(self, observations):
        answer = self.answers.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return answer


def begin(env):
    env.reset(seed=0)
    env.step(1)


BAD_ANSWERS = [
    np.array([0.9]),
    np.array([1, 0]),
    np.array([True]),
    np.array([9]),
    np.array([-1]),
    np.array(["1"]),
    1,
    None,
]
GOOD = np.array([1])


@pytest.mark.parametrize("answer", [*BAD_ANSWERS, OSError("no memory")], ids=str)
def test_after_a_bad_alert_the_driver_can_take_the_step_again(answer):
    failing = MergeDriver(Partner(GOOD, answer, GOOD), TeamConfig(**SMALL))
    sound = MergeDriver(Partner(GOOD, GOOD), TeamConfig(**SMALL))
    for env in (failing, sound):
        env.reset(seed=2)
        env.step(3)
    before = failing.team.teaming.state()
    with pytest.raises((ValueError, OSError), match=r"the seat of vehicle_ai answers|no memory"):
        failing.step(4)
    np.testing.assert_array_equal(failing.team.teaming.state(), before)
    assert failing.step(4)[1:] == sound.step(4)[1:]
    np.testing.assert_array_equal(failing.team.teaming.state(), sound.team.teaming.state())


@pytest.mark.parametrize("answer", BAD_ANSWERS, ids=str)
def test_after_a_bad_action_the_driver_is_asked_again(answer):
    failing = MergeHMI(Partner(GOOD, answer, GOOD, GOOD), TeamConfig(**SMALL))
    sound = MergeHMI(Partner(GOOD, GOOD, GOOD), TeamConfig(**SMALL))
    for env in (failing, sound):
        env.reset(seed=2)
    with pytest.raises(ValueError, match="the seat of driver answers with an integer, 0 to 4"):
        failing.step(1)
    sound.step(1)
    assert failing.step(0)[1:] == sound.step(0)[1:]
    np.testing.assert_array_equal(failing.team.teaming.state(), sound.team.teaming.state())


@pytest.mark.parametrize("answer", [0.9, [1, 0], 9, -1, None, "1"], ids=str)
@pytest.mark.parametrize("seat", SEATS)
def test_what_a_function_answers_is_not_made_to_fit(seat, answer):
    env = gymnasium.make(seat, partner=lambda _: answer, **SMALL).unwrapped
    with pytest.raises(ValueError, match=r"the partner in the seat of .* this one gave"):
        begin(env)


@pytest.mark.parametrize(
    "answer", [1, np.int64(1), np.array(1), np.array([1], np.uint8), [1], True]
)
def test_any_single_integer_is_an_answer(answer):
    env = gymnasium.make(SEATS[0], partner=lambda _: answer, **SMALL)
    env.reset(seed=0)
    assert env.step(1)[-1]["accepted"]


def test_a_policy_class_is_no_partner():
    for partner in (RandomAlert, RuleBasedDriver):
        with pytest.raises(TypeError, match="a name, a Policy object or a function, not <class"):
            gymnasium.make(SEATS[0], partner=partner)
        with pytest.raises(TypeError, match=r"a Policy object with reset\(\) and act\(\), not <c"):
            MergeDriver(partner, TeamConfig())


@pytest.mark.parametrize("seat", SEATS)
def test_a_typo_names_the_known_keywords(seat):
    message = r"got an unexpected keyword argument 'drvier'; did you mean driver\?"
    with pytest.raises(TypeError, match=message):
        gymnasium.make(seat, drvier="bart")


@pytest.mark.parametrize("seat", SEATS)
def test_gymnasium_collects_pictures_in_a_list(seat):
    env = gymnasium.make(seat, render_mode="rgb_array_list", **SMALL)
    env.reset(seed=0)
    env.step(1)
    pictures = env.render()
    assert len(pictures) == 2
    assert pictures[0].ndim == 3
    env.close()


@pytest.mark.parametrize("seat", SEATS)
def test_bad_partners_and_actions_are_refused(seat):
    with pytest.raises(ValueError, match=r"unknown .* 'hal'; .*hmi-marl --help"):
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


@pytest.mark.usefixtures("unmeasured")
@pytest.mark.parametrize("seat", ["driver", "vehicle_ai", "team"])
def test_the_batched_world_gives_what_highway_env_gives(seat):
    envs = [
        make_vec(4, seat, world=world, driver=["bart", "homer"], **FEW)
        for world in ("highway", "batched")
    ]
    rng = np.random.default_rng(0)
    ends = 0
    for _ in range(35):
        actions = torch.as_tensor(
            np.column_stack([rng.integers(0, size, 4) for size in envs[0].action_sizes])
        )
        (slow, slow_rewards, slow_dones, _), (fast, rewards, dones, _) = (
            env.step(actions) for env in envs
        )
        for group in ("driver", "vehicle_ai", "traits", "critic"):
            torch.testing.assert_close(fast[group], slow[group], rtol=0, atol=1e-6)
        torch.testing.assert_close(rewards, slow_rewards, rtol=0, atol=1e-5)
        assert torch.equal(dones, slow_dones)
        ends += int(dones.sum())
    assert ends >= 4


def test_a_thousand_teams_go_on_for_ever():
    env = make_vec(1000, "team", threads=1, driver="bart", **FEW)
    actions = torch.zeros(1000, 2, dtype=torch.int64)
    for _ in range(40):
        observations, rewards, dones, extras = env.step(actions)
        assert torch.isfinite(rewards).all()
        if dones.any():
            assert len(extras["final_teams"]) == int(dones.sum())
    assert observations["critic"].shape == (1000, env.layouts["critic"].size)
    with pytest.raises(ValueError, match="threads lies in"):
        make_vec(2, threads=10_000)


def test_any_team_can_be_seen_at_any_time():
    env = make_vec(30, "team", driver=["bart", "homer"], **FEW)
    first, other = env.picture(0), env.picture(29)
    assert first.dtype == np.uint8
    assert first.shape == other.shape
    assert (first != other).any()
    env.step(torch.tensor([[3, 1]] * 30))
    assert (env.picture(29) != other).any()
    for team in (-1, 30):
        with pytest.raises(ValueError, match="team lies in 0 to 29"):
            env.picture(team)
    env.close()
    env.close()
