import json

import numpy as np
import pytest
import torch
from rsl_rl.modules.distribution import Distribution
from rsl_rl.runners import OnPolicyRunner
from rsl_rl.utils.log_writer import LogWriter
from standing_world import CrashingWorld, StandingWorld, standing_teams

from hmi_marl import Driver, Scene, TraitDistributions, merge_v0
from hmi_marl.agents.catalogue import make_driver_policy, make_hmi
from hmi_marl.agents.partners import make_vec
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import Traits
from hmi_marl.envs.rewards import TERMS
from hmi_marl.envs.seats import parts_read
from hmi_marl.envs.streams import episode_seed, team_seed
from hmi_marl.envs.teaming import Teaming
from hmi_marl.envs.vector import TeamVecEnv
from hmi_marl.envs.worlds.batched.kernels import TRACED
from hmi_marl.files import json_value

ATTENTIVE = Driver("attentive", beta=0.0, alpha=1.0, eta=0.0, inflation=1.0)
SEATS = ("driver", "vehicle_ai", "team")
GROUPS = ("driver", "vehicle_ai", "critic")
SMALL = {"scene": Scene(vehicles=2), "duration": 2.0, "driver": ["bart", "homer", "marge"]}


def standing(num_teams, seat="team", partner=None, seed=0, world=StandingWorld, **settings):
    """A vector of cars that do not move, in an episode of five steps by default."""
    config = TeamConfig(**({"duration": 1.0} | settings))
    teaming = Teaming(config, num_teams, world(config.scene, num_teams))
    return TeamVecEnv(teaming, seat, partner, seed)


def partner_for(seat, config):
    """One who draws at random, so that being asked once too often would show."""
    if seat == "team":
        return None
    return (
        make_hmi("random:0.4", config) if seat == "driver" else make_driver_policy("random", config)
    )


def random_actions(env, steps, seed=0):
    rng = np.random.default_rng(seed)
    return torch.from_numpy(
        rng.integers(0, env.action_sizes, (steps, env.num_envs, env.num_actions))
    )


def alone(seed, seat, actions, world, **settings):
    """The same series in merge_v0: (before, reward, terminated, truncated, after) of each step."""
    if seat == "team":
        yield from alone_at_once(seed, actions, world, **settings)
        return
    env = merge_v0.raw_env(world=world, **settings)
    partner = partner_for(seat, env.config)

    def seen():
        return {agent: env.observe(agent) for agent in env.possible_agents} | {
            "critic": env.state()
        }

    for action in actions:
        if not env.agents or env.terminations[seat] or env.truncations[seat]:
            env.reset(seed=None if env.agents else seed)
            partner.reset(env.team.teaming.seeds)
        if seat == "driver":
            before = seen()
            env.step(int(action[0]))
            env.step(partner.act(env.observe("vehicle_ai")[None])[0])
        else:
            env.step(partner.act(env.observe("driver")[None])[0])
            before = seen()
            env.step(int(action[0]))
        yield before, env.rewards[seat], env.terminations[seat], env.truncations[seat], seen()


def alone_at_once(seed, actions, world, **settings):
    env = merge_v0.parallel_env(world=world, **settings)
    after = None
    for driver, alert in actions.tolist():
        if not env.agents:
            seen, _ = env.reset(seed=seed if after is None else None)
            after = seen | {"critic": env.state()}
        before = after
        seen, rewards, ends, cuts, _ = env.step({"driver": driver, "vehicle_ai": alert})
        after = seen | {"critic": env.state()}
        individual = settings.get("reward") == "individual"
        reward = sum(rewards.values()) if individual else rewards["driver"]
        yield before, reward, ends["driver"], cuts["driver"], after


def check_against_merge_v0(env, actions, world, **settings):
    """Every team of ``env`` against an environment of its own: numbers of crashes and time-outs."""
    singles = [
        alone(
            int(team_seed(env.cfg["seed"], team)), env.seat, actions[:, team], world(), **settings
        )
        for team in range(env.num_envs)
    ]
    seen = env.get_observations()
    crashes = time_outs = 0
    for step in actions:
        references = [next(single) for single in singles]
        for team, (before, *_) in enumerate(references):
            for group in GROUPS:
                np.testing.assert_array_equal(seen[group][team].numpy(), before[group])
        seen, rewards, dones, extras = env.step(step)
        _, reward, terminated, truncated, after = zip(*references, strict=True)
        np.testing.assert_array_equal(rewards.numpy(), np.array(reward, np.float32))
        ended = np.array(terminated) | np.array(truncated)
        assert dones.tolist() == ended.astype(int).tolist()
        assert extras["time_outs"].tolist() == list(truncated)
        assert ("final_observation" in extras) == ("log" in extras) == bool(ended.any())
        if ended.any():
            assert extras["final_teams"].tolist() == np.flatnonzero(ended).tolist()
            assert extras["final_observation"].batch_size == (ended.sum(),)
            for row, team in enumerate(extras["final_teams"].tolist()):
                for group in GROUPS:
                    last = extras["final_observation"][group][row].numpy()
                    np.testing.assert_array_equal(last, after[team][group])
        crashes, time_outs = crashes + sum(terminated), time_outs + sum(truncated)
    return crashes, time_outs


@pytest.mark.parametrize("seat", SEATS)
def test_highway_episodes_are_those_of_merge_v0_across_autoresets(seat):
    settings = SMALL | {"reward": "individual"}
    config = TeamConfig(**settings)
    env = TeamVecEnv(Teaming(config, 3, "highway"), seat, partner_for(seat, config), seed=5)
    actions = random_actions(env, 25)
    crashes, time_outs = check_against_merge_v0(env, actions, lambda: "highway", **settings)
    assert crashes + time_outs >= 6


@pytest.mark.parametrize("seat", SEATS)
@pytest.mark.parametrize("end_at_crash", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_episodes_that_crash_are_those_of_merge_v0_too(seat, end_at_crash):
    settings = {"driver": TraitDistributions(), "duration": 1.0, "end_at_crash": end_at_crash}
    config = TeamConfig(**settings)
    env = standing(20, seat, partner_for(seat, config), seed=7, world=CrashingWorld, **settings)
    crashes, time_outs = check_against_merge_v0(
        env, random_actions(env, 17), lambda: CrashingWorld(config.scene, 1), **settings
    )
    assert time_outs > 10
    assert (crashes > 10) == end_at_crash


@pytest.mark.parametrize("seat", SEATS)
def test_a_team_is_the_same_alone_and_among_many(seat):
    settings = {"driver": TraitDistributions(), "world": CrashingWorld}
    partner = partner_for(seat, TeamConfig())
    many = standing(64, seat, partner, seed=100, **settings)
    actions = random_actions(many, 23)
    kept = [(many.get_observations(), *many.step(step)) for step in actions]
    for team in (0, 17, 63):
        one = standing(1, seat, partner_for(seat, TeamConfig()), **settings)
        one.reset(100, first_team=team)
        for step, (before, after, rewards, dones, extras) in zip(actions, kept, strict=True):
            assert (one.get_observations() == before[team : team + 1]).all()
            own_after, own_rewards, own_dones, own_extras = one.step(step[team : team + 1])
            assert (own_after == after[team : team + 1]).all()
            assert own_rewards == rewards[team]
            assert own_dones == dones[team]
            assert own_extras["time_outs"] == extras["time_outs"][team]


def test_what_was_handed_out_stays_as_it_was():
    env = standing(8, "vehicle_ai", make_driver_policy("random", TeamConfig()), world=CrashingWorld)
    given, copies = [], []
    for step in random_actions(env, 12):
        *tensors, extras = env.step(step)
        tensors += [extras["time_outs"], extras.get("final_observation", env.get_observations())]
        given.append(tensors)
        copies.append([tensor.clone() for tensor in tensors])
    for tensors, clones in zip(given, copies, strict=True):
        assert all((one == two).all() for one, two in zip(tensors, clones, strict=True))


def test_shapes_types_and_names():
    env = standing(4096, "team", driver=["lisa", "homer"])
    assert (env.num_envs, env.num_actions, env.action_sizes) == (4096, 2, (5, 2))
    assert env.max_episode_length == env.teaming.config.horizon == 5
    assert env.unwrapped is env
    seen, extras = env.reset()
    assert extras == {}
    assert seen.batch_size == (4096,)
    assert set(seen.keys()) == set(env.layouts) == {"driver", "vehicle_ai", "traits", "critic"}
    for group, layout in env.layouts.items():
        assert seen[group].shape == (4096, layout.size)
        assert seen[group].dtype == torch.float32
    seen, rewards, dones, extras = env.step(torch.zeros(4096, 2))
    assert (rewards.shape, rewards.dtype) == ((4096,), torch.float32)
    assert (dones.shape, dones.dtype) == ((4096,), torch.int64)
    assert set(extras) == {"time_outs", "rewards"}
    assert set(extras["rewards"]) == {"driver", "vehicle_ai"}
    for given in extras["rewards"].values():
        assert (given.shape, given.dtype) == ((4096,), torch.float32)
    assert (extras["time_outs"].shape, extras["time_outs"].dtype) == ((4096,), torch.bool)
    assert env.layouts["traits"]["inflation"] == slice(3, 4)
    assert set(env.get_observations()["traits"][:, 3].tolist()) == {3.0, 9.0}
    env.close()


def test_the_ai_sees_this_a_h_in_its_seat_and_the_last_one_in_the_team():
    class Counting:
        """A driver who plays 0, 1, 2, ... in every episode."""

        def reset(self, seeds, which=None):
            now = np.zeros(len(seeds), np.int64) if which is None else self.next
            self.next = np.where(True if which is None else which, 0, now)

        def act(self, observations):
            self.next = self.next + 1
            return self.next - 1

    def shown(env):
        seen = env.get_observations()["vehicle_ai"].numpy()
        return env.layouts["vehicle_ai"].chosen(seen, "intended_action").tolist()

    env = standing(2, "vehicle_ai", Counting(), duration=0.6)
    intended = [shown(env)]
    for _ in range(3):
        env.step(torch.zeros(2, 1))
        intended.append(shown(env))
    assert intended == [[0, 0], [1, 1], [2, 2], [0, 0]]

    env = standing(2, "team", duration=0.6)
    intended = [shown(env)]
    for action in (4, 3, 2):
        env.step(torch.tensor([[action, 0], [action, 1]]))
        intended.append(shown(env))
    assert intended == [[-1, -1], [4, 4], [3, 3], [-1, -1]]


def test_the_partner_is_asked_once_a_step_for_all_teams():
    class Recording:
        def __init__(self):
            self.asked, self.reset_with = [], []

        def reset(self, seeds, which=None):
            self.reset_with.append(None if which is None else which.tolist())

        def act(self, observations):
            self.asked.append(observations.shape)
            return np.zeros(len(observations), np.int64)

    for seat, other, before_the_first in (("driver", "vehicle_ai", 0), ("vehicle_ai", "driver", 1)):
        partner = Recording()
        env = standing(3, seat, partner, duration=0.6)
        env.teaming.world.crash_next[1] = True
        for _ in range(3):
            env.step(torch.zeros(3, 1))
        assert partner.asked == [(3, env.layouts[other].size)] * (3 + before_the_first)
        crashed = [False, True, False]
        assert partner.reset_with == [None, crashed, crashed, [True, True, True]]


def test_time_outs_are_distinguished_from_crashes_even_in_the_last_step():
    env = standing(3, duration=0.4)
    env.teaming.world.crash_next[0] = True
    stay = torch.tensor([[1, 0]] * 3)
    _, _, dones, extras = env.step(stay)
    assert dones.tolist() == [1, 0, 0]
    assert extras["time_outs"].tolist() == [False, False, False]
    env.teaming.world.crash_next[:] = [False, True, False]
    _, _, dones, extras = env.step(stay)
    assert dones.tolist() == [0, 1, 1]
    assert extras["time_outs"].tolist() == [False, False, True]
    assert extras["log"]["Episode/crash_rate"].tolist() == [1.0, 0.0]


def test_a_crash_that_does_not_end_the_episode_ends_in_a_time_out_and_is_counted():
    env = standing(2, duration=0.6, end_at_crash=False)
    env.teaming.world.crash_next[0] = True
    for _ in range(3):
        _, _, dones, extras = env.step(torch.tensor([[1, 0]] * 2))
    assert dones.tolist() == [1, 1]
    assert extras["time_outs"].tolist() == [True, True]
    assert extras["log"]["Episode/crash_rate"].tolist() == [1.0, 0.0]
    assert extras["log"]["Episode/collision"].tolist() == [-15.0, 0.0]


def test_statistics_by_hand():
    env = standing(2, driver=ATTENTIVE, duration=0.6)
    world, step = env.teaming.world, 2.5 + 0.1 - 0.025  # speed, right lane, merging
    _, _, _, extras = env.step(torch.tensor([[1, 0], [1, 0]]))
    assert "log" not in extras
    world.crash_next[0] = True
    _, _, _, extras = env.step(torch.tensor([[0, 1], [1, 0]]))  # a lane change, an alert in vain
    log = {name: value.tolist() for name, value in extras["log"].items()}
    assert set(log) == {
        *(f"Episode/{term}" for term in TERMS),
        *(f"Episode/{name}" for name in ("return", "length", "crash_rate", "alerts")),
    }
    expected = {
        "collision": -5.0,
        "speed_reward": 5.0,
        "right_lane": 0.2,
        "merging": -0.05,
        "lane_change": -0.1,
        "distraction": 0.0,
        "alert": 10.0,
        "accept_alert": 0.0,
        "return": 2 * step - 5.0 - 0.1 + 10.0,
        "length": 2.0,
        "crash_rate": 1.0,
        "alerts": 1.0,
    }
    for name, value in expected.items():
        assert log[f"Episode/{name}"] == pytest.approx([value]), name
    world.crash_next[0] = False
    _, _, _, extras = env.step(torch.tensor([[1, 0], [1, 0]]))
    assert extras["final_teams"].tolist() == [1]
    assert extras["log"]["Episode/length"].tolist() == [3.0]
    assert extras["log"]["Episode/return"].tolist() == pytest.approx([3 * step + 30.0])
    env.step(torch.tensor([[1, 1], [1, 0]]))
    _, _, _, extras = env.step(torch.tensor([[1, 1], [1, 0]]))
    assert extras["final_teams"].tolist() == [0]  # nothing of the first episode is left in it
    assert extras["log"]["Episode/length"].tolist() == [3.0]
    assert extras["log"]["Episode/alerts"].tolist() == [2.0]
    assert extras["log"]["Episode/return"].tolist() == pytest.approx([3 * step + 10.0])


@pytest.mark.parametrize("reward", ["team", "individual", "driving", "attention"])
def test_each_seat_gets_its_own_reward_and_the_team_all_of_it(reward):
    config = TeamConfig(reward=reward, driver=ATTENTIVE)
    rewards = {}
    for seat in SEATS:
        partner = None
        if seat == "driver":
            partner = make_hmi("never", config)
        elif seat == "vehicle_ai":
            partner = make_driver_policy("rule", config)
        env = standing(1, seat, partner, reward=reward, driver=ATTENTIVE)
        actions = {"driver": [[3]], "vehicle_ai": [[0]], "team": [[3, 0]]}[seat]
        rewards[seat] = float(env.step(torch.tensor(actions))[1])
    driving = 2.5 + 0.1 - 0.025
    expected = {
        "team": (driving + 10.0,) * 3,
        "individual": (driving, 10.0, driving + 10.0),
        "driving": (driving,) * 3,
        "attention": (10.0,) * 3,
    }[reward]
    assert tuple(rewards[seat] for seat in SEATS) == pytest.approx(expected)


def test_with_both_seats_the_extras_hold_the_rewards_of_each_agent():
    env = standing(1, "team", reward="individual", driver=ATTENTIVE)
    _, reward, _, extras = env.step(torch.tensor([[3, 0]]))
    driving = 2.5 + 0.1 - 0.025
    assert extras["rewards"]["driver"].item() == pytest.approx(driving)
    assert extras["rewards"]["vehicle_ai"].item() == pytest.approx(10.0)
    assert reward.item() == pytest.approx(driving + 10.0)


def test_every_episode_has_its_own_seed_and_driver():
    population = TraitDistributions()
    env = standing(50, seed=2**64 - 20, driver=population, duration=0.4)
    first = team_seed(2**64 - 20, np.arange(50))
    for episode in range(3):
        seeds = episode_seed(first, episode)
        np.testing.assert_array_equal(env.teaming.seeds, seeds)
        traits = population.draw(seeds).as_array().astype(np.float32)
        np.testing.assert_array_equal(env.get_observations()["traits"].numpy(), traits)
        env.step(torch.ones(50, 2))
        _, _, dones, extras = env.step(torch.ones(50, 2))
        assert dones.all()
        np.testing.assert_array_equal(extras["final_observation"]["traits"].numpy(), traits)


def test_reset_goes_on_in_the_series_or_starts_it_anew():
    env = standing(4, seed=3, driver=TraitDistributions())
    first = team_seed(3, np.arange(4))
    env.get_observations()
    env.reset()  # the first one: nothing was played yet
    np.testing.assert_array_equal(env.teaming.seeds, first)
    env.step(torch.ones(4, 2))
    seen, _ = env.reset()
    np.testing.assert_array_equal(env.teaming.seeds, episode_seed(first, 1))
    assert env.episode_length_buf.tolist() == [0, 0, 0, 0]
    assert (seen == env.get_observations()).all()
    env.reset()
    np.testing.assert_array_equal(env.teaming.seeds, episode_seed(first, 2))
    env.reset(seed=9)
    np.testing.assert_array_equal(env.teaming.seeds, team_seed(9, np.arange(4)))
    with pytest.raises(ValueError, match="seed"):
        env.reset(seed=-1)


def test_a_reset_in_mid_episode_forgets_its_statistics():
    env = standing(1, duration=0.4)
    env.step(torch.ones(1, 2))
    env.reset()
    env.step(torch.ones(1, 2))
    extras = env.step(torch.ones(1, 2))[3]
    assert extras["log"]["Episode/length"].tolist() == [2.0]


def test_assigning_episode_lengths_spreads_the_ends():
    env = standing(5, duration=1.0)
    assert env.episode_length_buf.tolist() == [0] * 5
    assert env.episode_length_buf.dtype == torch.int64
    env.episode_length_buf[:] = 3  # a copy: only assigning the whole of it counts
    assert env.episode_length_buf.tolist() == [0] * 5
    env.episode_length_buf = torch.arange(5)
    time = env.layouts["critic"].get(env.get_observations()["critic"].numpy(), "time")
    assert time.ravel().tolist() == pytest.approx([0.0, 0.2, 0.4, 0.6, 0.8])
    ends, lengths = [], []
    for _ in range(5):
        _, _, dones, extras = env.step(torch.ones(5, 2))
        ends.append(dones.argmax().item())
        assert dones.sum() == 1
        assert (extras["time_outs"] == (dones == 1)).all()
        lengths += extras["log"]["Episode/length"].tolist()
    assert ends == [4, 3, 2, 1, 0]
    assert lengths == [1.0, 2.0, 3.0, 4.0, 5.0]  # steps really taken
    np.testing.assert_array_equal(env.teaming.seeds, episode_seed(team_seed(0, np.arange(5)), 1))
    for wrong in ([0, 1], [0, 1, 2, 3, 5], [-1, 0, 0, 0, 0]):
        with pytest.raises(ValueError, match="episode lengths"):
            env.episode_length_buf = torch.tensor(wrong)


def test_whole_numbers_of_any_type_are_actions():
    outcomes = []
    for dtype in (
        torch.int64,
        torch.int32,
        torch.uint8,
        torch.float32,
        torch.float16,
        torch.bfloat16,
    ):
        env = standing(2)
        env.step(torch.tensor([[4, 1], [0, 0]], dtype=dtype))
        outcomes.append((env.teaming.intended.tolist(), env.teaming.alerted.tolist()))
    assert outcomes == [([4, 0], [1, 0])] * 6


@pytest.mark.parametrize(
    ("actions", "message"),
    [
        (torch.zeros(2), r"shape \(2, 2\), a column each for driver and vehicle_ai.*\(2,\)"),
        (torch.zeros(2, 1), r"got \(2, 1\)"),
        (torch.zeros(3, 2), r"got \(3, 2\)"),
        (torch.tensor([[0, 0], [5, 0]]), "action 5 of driver in team 1 .* 0 to 4"),
        (torch.tensor([[0, -1], [0, 0]]), "action -1 of vehicle_ai in team 0 .* 0 to 1"),
        (torch.tensor([[0.0, 0.5], [0.0, 0.0]]), "action 0.5 of vehicle_ai"),
        (torch.tensor([[0.0, 0.0], [float("nan"), 0.0]]), "action nan of driver in team 1"),
        (torch.tensor([[0.0, float("inf")], [0.0, 0.0]]), "action inf of vehicle_ai"),
        (torch.full((2, 2), 1e30), "action 1.*e\\+30 of driver"),
        (torch.zeros(2, 2, dtype=torch.bool), "whole numbers, but got torch.bool"),
        (torch.zeros(2, 2, dtype=torch.complex64), "whole numbers, but got torch.complex64"),
    ],
)
def test_bad_actions_are_refused_before_anything_moves(actions, message):
    env = standing(2)
    with pytest.raises(ValueError, match=message):
        env.step(actions)
    assert env.episode_length_buf.tolist() == [0, 0]
    env.step(torch.zeros(2, 2))  # and the step can still be taken
    assert env.episode_length_buf.tolist() == [1, 1]


def test_bad_actions_of_one_seat():
    env = standing(2, "vehicle_ai", make_driver_policy("rule", TeamConfig()))
    with pytest.raises(ValueError, match=r"action 2 of vehicle_ai in team 1 .* 0 to 1"):
        env.step(torch.tensor([[0], [2]]))
    with pytest.raises(TypeError, match="torch tensor, not list"):
        env.step([[0], [0]])


def test_seats_and_partners_that_do_not_fit():
    teams, hmi = standing_teams(1), make_hmi("never", TeamConfig())
    with pytest.raises(ValueError, match="one of driver, vehicle_ai, team, not 'passenger'"):
        TeamVecEnv(teams, "passenger")
    with pytest.raises(ValueError, match="needs a partner"):
        TeamVecEnv(teams, "driver")
    with pytest.raises(ValueError, match="no partner"):
        TeamVecEnv(teams, "team", hmi)
    with pytest.raises(TypeError, match="is a Policy"):
        TeamVecEnv(teams, "driver", "never")
    with pytest.raises(TypeError, match="a seed is an integer"):
        TeamVecEnv(teams, "team", seed=1.5)


def test_the_configuration_is_fit_for_json():
    env = standing(
        2, "driver", make_hmi("never", TeamConfig()), seed=4, driver=TraitDistributions()
    )
    described = json.loads(json.dumps(env.cfg))
    assert (described["seat"], described["num_teams"], described["seed"]) == ("driver", 2, 4)
    assert (described["partner"], described["world"]) == ("RandomAlert", "StandingWorld")
    assert described["team"]["driver"]["beta"] == {"low": 0.0, "high": 1.0}
    assert described["team"]["scene"]["vehicles"] == [1, 20]
    assert described["team"]["weights"]["distraction"] == -10.0
    assert json_value({1: np.float64(2.5), "x": (None, True, int)}) == {
        "1": 2.5,
        "x": [None, True, "<class 'int'>"],
    }


def test_make_vec_takes_partners_by_name():
    small = {"world": "highway", "scene": Scene(vehicles=1), "duration": 1.0}
    names = [(seat, make_vec(1, seat, **small).cfg["partner"]) for seat in SEATS]
    assert names == [("driver", "never"), ("vehicle_ai", "rule"), ("team", None)]
    env = make_vec(2, "driver", "optimal", seed=6, driver="bart", **small)
    assert (env.cfg["partner"], env.cfg["world"], env.cfg["seed"]) == ("optimal", "highway", 6)
    assert env.step(torch.ones(2, 1))[1].shape == (2,)
    config = TeamConfig()
    policy = make_hmi("always", config)
    env = make_vec(3, "driver", policy, world=StandingWorld(config.scene, 3))
    assert env.partner is policy
    assert (env.cfg["partner"], env.cfg["world"]) == ("RandomAlert", "StandingWorld")
    with pytest.raises(ValueError, match="unknown HMI 'rule'"):
        make_vec(1, "driver", "rule", **small)
    with pytest.raises(ValueError, match="unknown driver policy 'never'"):
        make_vec(1, "vehicle_ai", "never", **small)
    with pytest.raises(ValueError, match="has no partner"):
        make_vec(1, "team", "never", **small)
    with pytest.raises(ValueError, match="seat= is one of"):
        make_vec(1, "passenger", **small)
    with pytest.raises(ValueError, match="num_teams lies in"):
        make_vec(0, **small)


class Categorical(Distribution):
    """A categorical head for each column of actions."""

    def __init__(self, output_dim, sizes):
        super().__init__(output_dim)
        assert len(sizes) == output_dim
        self.sizes = list(sizes)

    def update(self, mlp_output):
        self._log_probs = self._split(mlp_output)

    def _split(self, logits):
        return [head.log_softmax(-1) for head in logits.split(self.sizes, dim=-1)]

    def sample(self):
        draws = [log_probs.exp().multinomial(1) for log_probs in self._log_probs]
        return torch.cat(draws, dim=-1).float()

    def deterministic_output(self, mlp_output):
        best = [head.argmax(-1, keepdim=True) for head in mlp_output.split(self.sizes, dim=-1)]
        return torch.cat(best, dim=-1).float()

    @property
    def input_dim(self):
        return sum(self.sizes)

    @property
    def std(self):
        probabilities = self.params[0].exp()
        return (probabilities * (1 - probabilities)).sqrt()

    @property
    def entropy(self):
        return -(self.params[0].exp() * self.params[0]).sum(-1)

    @property
    def params(self):
        return (torch.cat(self._log_probs, dim=-1),)

    def log_prob(self, outputs):
        chosen = outputs.long().unsqueeze(-1).unbind(-2)
        heads = zip(self._log_probs, chosen, strict=True)
        return sum(log_probs.gather(-1, index) for log_probs, index in heads).squeeze(-1)

    def kl_divergence(self, old_params, new_params):
        return (old_params[0].exp() * (old_params[0] - new_params[0])).sum(-1)


class Kept(LogWriter):
    """Keeps what rsl_rl logs."""

    scalars = ()
    config = None

    def __init__(self, log_dir):
        Kept.scalars = []

    def add_scalar(self, tag, scalar_value, global_step):
        Kept.scalars.append((tag, float(scalar_value)))

    def store_config(self, env_cfg, train_cfg):
        Kept.config = env_cfg


@pytest.mark.parametrize("seat", SEATS)
def test_rsl_rls_ppo_learns_on_it(seat, tmp_path):
    torch.manual_seed(0)
    env = standing(
        16, seat, partner_for(seat, TeamConfig()), world=CrashingWorld, driver=["bart", "lisa"]
    )
    network = {"class_name": "MLPModel", "hidden_dims": [16], "activation": "relu"}
    head = {"class_name": Categorical, "sizes": env.action_sizes}
    settings = {
        "algorithm": {"class_name": "PPO", "num_learning_epochs": 2, "num_mini_batches": 2},
        "actor": network | {"distribution_cfg": head, "obs_normalization": True},
        "critic": network,
        "obs_groups": {"actor": list(env.agents), "critic": ["critic", "traits"]},
        "num_steps_per_env": 8,
        "save_interval": 100,
        "logger": {"class_name": Kept},
    }
    runner = OnPolicyRunner(env, settings, log_dir=str(tmp_path))
    runner.logger.git_status_repos = []  # it would write down this repository's diff
    before = [parameter.clone() for parameter in runner.alg.actor.parameters()]
    lengths = []
    step = env.step

    def watched(actions):
        answer = step(actions)
        lengths.extend(answer[3].get("log", {}).get("Episode/length", torch.zeros(0)).tolist())
        return answer

    env.step = watched
    runner.learn(1, init_at_random_ep_len=True)
    logged = dict(Kept.scalars)
    assert logged["Episode/length"] == pytest.approx(np.mean(lengths))  # every episode alike
    assert logged["Train/mean_episode_length"] == pytest.approx(np.mean(lengths))
    assert logged["Train/mean_reward"] == pytest.approx(logged["Episode/return"], rel=1e-5)
    assert {f"Episode/{term}" for term in TERMS} <= set(logged)
    assert Kept.config is env.cfg
    runner.learn(1)
    after = list(runner.alg.actor.parameters())
    assert any(not torch.equal(one, two) for one, two in zip(before, after, strict=True))
    assert all(parameter.isfinite().all() for parameter in after)


def lidars_read(env):
    """Which lidars of the batched world were traced since it last moved: true, perceived."""
    arrays = env.teaming.world.arrays()
    news = arrays.true_news, arrays.perceived_news
    return tuple(bool((each == TRACED).any()) for each in news)


@pytest.mark.parametrize(
    ("seat", "partner", "groups", "expected"),
    [
        ("driver", "never", ("driver",), (False, True)),
        ("driver", "never", ("traits",), (False, False)),
        ("driver", "when-distracted", ("driver",), (False, True)),
        ("driver", "never", ("driver", "critic"), (True, True)),
        ("vehicle_ai", "random", ("vehicle_ai",), (True, False)),
        ("vehicle_ai", "rule", ("vehicle_ai",), (True, True)),
        ("team", None, ("vehicle_ai", "traits"), (True, False)),
    ],
)
def test_only_lidars_that_somebody_reads_are_traced(seat, partner, groups, expected):
    full, lean = (make_vec(6, seat, partner, seed=4, **SMALL) for _ in range(2))
    lean.groups = groups
    assert lean.groups == groups
    first, _ = full.reset()
    lean.reset()
    assert set(first.keys()) == {"driver", "vehicle_ai", "traits", "critic"}
    for actions in random_actions(full, 25):
        whole, part = full.step(actions), lean.step(actions)
        assert lidars_read(lean) == expected
        assert tuple(part[0].keys()) == groups
        for group in groups:
            assert torch.equal(part[0][group], whole[0][group])
        assert torch.equal(part[1], whole[1])
        assert part[3].get("final_teams", torch.tensor([])).tolist() == (
            whole[3].get("final_teams", torch.tensor([])).tolist()
        )
        if "final_teams" in part[3]:
            for group in groups:
                last = whole[3]["final_observation"][group]
                assert torch.equal(part[3]["final_observation"][group], last)


def test_a_group_that_was_not_computed_can_be_read_later():
    full, lean = (make_vec(3, "driver", "never", seed=1, **SMALL) for _ in range(2))
    lean.groups = ["driver"]
    full.reset()
    lean.reset()
    for actions in random_actions(full, 12):  # an episode ends in between
        observations, *_ = full.step(actions)
        seen, *_ = lean.step(actions)
        with pytest.raises(KeyError):
            seen["critic"]
        for group in ("critic", "vehicle_ai", "traits", "driver"):
            assert torch.equal(lean.read(group), observations[group])
    lean.groups = ("critic", "driver")
    assert lean.groups == ("driver", "critic")
    assert torch.equal(lean.get_observations()["critic"], full.get_observations()["critic"])
    for wrong in ((), "driver", ("driver", "lidar")):
        with pytest.raises(ValueError, match="groups="):
            lean.groups = wrong
    with pytest.raises(ValueError, match="group="):
        lean.read("lidar")


def test_what_an_episode_logged_stays_and_can_be_read_by_name():
    env = standing(1)
    env.reset()
    for _ in range(5):
        _, _, _, extras = env.step(torch.tensor([[1, 0]]))
    log = extras["log"]
    assert len(log) == len(set(log)) == 12
    before = {name: value.clone() for name, value in log.items()}
    for _ in range(5):
        env.step(torch.tensor([[1, 1]]))
    assert all(torch.equal(log[name], before[name]) for name in before)
    with pytest.raises(KeyError):
        log["Episode/none"]


def test_only_a_policys_own_parts_are_left_out():
    config = TeamConfig(driver="homer")

    class Nosy(type(make_driver_policy("rule", config))):
        def act(self, observations):
            self.seen = observations
            return super().act(observations)

    class Slower(type(make_driver_policy("rule", config))):
        """With another gap, but the same act."""

    for kind, all_of_it in ((Nosy, True), (Slower, False)):
        partner = kind(config)
        env = make_vec(2, "vehicle_ai", partner, driver="homer")
        env.reset()
        whole = env.teaming.observe("driver")
        assert parts_read(partner) == (None if all_of_it else partner.reads)
        if all_of_it:
            np.testing.assert_array_equal(partner.seen, whole)


def test_traits_follow_a_change_of_drivers():
    env = make_vec(2, "team", driver="homer")
    env.reset()
    env.teaming.hand_over(Traits.from_array(np.tile([0.25, 0.5, 0.75, 2.0], (2, 1))))
    assert env.read("traits")[0].tolist() == [0.25, 0.5, 0.75, 2.0]
    observations, *_ = env.step(torch.ones(2, 2, dtype=torch.int64))
    assert observations["traits"][1].tolist() == [0.25, 0.5, 0.75, 2.0]
    shown = env.layouts["critic"]["traits"]
    assert observations["critic"][1, shown][:3].tolist() == [0.25, 0.5, 0.75]


def test_a_partner_may_drive_at_the_same_time():
    # The same as both seats give, if the same policy drives: the vehicle AI sees a^H_{t-1}.
    config = TeamConfig(driver="homer", duration=1.0, scene=Scene(vehicles=(1, 3)))
    env = make_vec(6, "vehicle_ai", "rule", threads=1, sequential=False, **vars(config))
    both = make_vec(6, "team", threads=1, **vars(config))
    policy = make_driver_policy("rule", config)
    draw = torch.Generator().manual_seed(0)
    seen, known = env.reset(3)[0], both.reset(3)[0]
    policy.reset(both.teaming.seeds)
    for _ in range(12):  # a second episode and some more
        assert torch.equal(seen["vehicle_ai"], known["vehicle_ai"])
        assert torch.equal(seen["critic"], known["critic"])
        alerts = torch.randint(2, (6, 1), generator=draw)
        intents = torch.from_numpy(policy.act(known["driver"].numpy())).unsqueeze(-1)
        seen, rewards, dones, extras = env.step(alerts)
        known, _, known_dones, known_extras = both.step(torch.cat([intents, alerts], dim=1))
        assert torch.equal(rewards, known_extras["rewards"]["vehicle_ai"])
        assert torch.equal(dones, known_dones)
        if "final_teams" in extras:
            last, known_last = (
                each["final_observation"]["vehicle_ai"] for each in (extras, known_extras)
            )
            assert torch.equal(last, known_last)
            policy.reset(both.teaming.seeds, dones.numpy().astype(bool))
        now = both.layouts["vehicle_ai"].chosen(known["vehicle_ai"].numpy(), "intended_action")
        assert (now == intents[:, 0].numpy())[dones.numpy() == 0].all()
    first = make_vec(6, "vehicle_ai", "rule", threads=1, **vars(config))
    assert not torch.equal(first.reset(3)[0]["vehicle_ai"], env.reset(3)[0]["vehicle_ai"])


@pytest.mark.parametrize(("seat", "partner"), [("driver", "never"), ("team", None)])
def test_only_a_partner_who_drives_is_told_when(seat, partner):
    with pytest.raises(ValueError, match=r"sequential=False is for seat='vehicle_ai'"):
        make_vec(2, seat, partner, sequential=False)
    with pytest.raises(TypeError, match="sequential is True or False"):
        make_vec(2, "vehicle_ai", sequential=1)
