import numpy as np
import pytest
import torch
from standing_world import CrashingWorld, StandingWorld

from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.rewards import ATTENTION_TERMS, TERMS
from hmi_marl.envs.streams import team_seed
from hmi_marl.envs.teaming import Teaming
from hmi_marl.envs.vector import TeamVecEnv
from hmi_marl.training.ppo.learner import play_batch

SETTINGS = {"driver": ["bart", "homer"], "duration": 2.0, "reward": "individual"}


class Scripted:
    """Acts as it was told, and keeps what it was shown."""

    def __init__(self, actions):
        self.actions = actions
        self.seen, self.recorded = [], []

    def act(self, observations):
        self.seen.append(observations)
        return self.actions[len(self.seen) - 1]

    def record(self, rewards, dones, extras):
        self.recorded.append((rewards, dones, extras))


def teams(count, world=CrashingWorld, **settings):
    config = TeamConfig(**SETTINGS | settings)
    return Teaming(config, count, world(config.scene, count))


def script(count, horizon, seed=0):
    return torch.from_numpy(np.random.default_rng(seed).integers(0, (5, 2), (horizon, count, 2)))


def by_hand(teaming, actions, seed):
    """Sums of one episode of each team; those that are over stay so, and get zeros."""
    count = teaming.num_teams
    teaming.reset(team_seed(seed, np.arange(count)))
    sums = dict.fromkeys((*TERMS, "return", "length", "alerts", "crash_rate"), 0.0)
    for step in actions.numpy():
        active = ~teaming.over
        teaming.intend(step[:, 0])
        result = teaming.step(step[:, 1])
        for name in TERMS:
            sums[name] += result.terms[name].sum()
        sums["return"] += sum(rewards.sum() for rewards in result.rewards.values())
        sums["length"] += active.sum()
        sums["alerts"] += step[active, 1].sum()
        sums["crash_rate"] += result.terminated.sum()
    assert teaming.over.all()
    return {name: value / count for name, value in sums.items()}


@pytest.mark.parametrize("world", [CrashingWorld, StandingWorld])
def test_a_batch_says_what_following_the_first_episodes_says(world):
    count = 40
    env = TeamVecEnv(teams(count, world))
    learner = Scripted(script(count, env.max_episode_length))
    row = play_batch(env, learner, seed=7)
    expected = by_hand(teams(count, world), learner.actions, 7)
    expected["team_return"] = sum(expected[name] for name in TERMS)
    expected["attention_return"] = sum(expected[name] for name in ATTENTION_TERMS)
    assert set(row) == set(expected)
    for name, value in expected.items():
        assert row[name] == pytest.approx(value, rel=1e-5), name
    later = sum(int(dones.sum()) for _, dones, _ in learner.recorded)
    if world is CrashingWorld:
        assert 0.5 < row["crash_rate"] < 1
        assert later > count  # second episodes ended too, and were not counted
    else:
        assert row["crash_rate"] == 0
        assert row["length"] == 10


def test_a_batch_is_one_whole_episode_long_and_in_order():
    env = TeamVecEnv(teams(3))
    learner = Scripted(script(3, 10))
    play_batch(env, learner, seed=7)
    assert len(learner.seen) == len(learner.recorded) == 10
    other = TeamVecEnv(teams(3), seed=7)
    seen = other.get_observations()
    for step in range(10):
        assert (learner.seen[step] == seen).all()
        seen, rewards, dones, _ = other.step(learner.actions[step])
        assert (learner.recorded[step][0] == rewards).all()
        assert (learner.recorded[step][1] == dones).all()
    assert (env.get_observations() == seen).all()


def test_every_batch_begins_anew_whatever_was_before():
    env = TeamVecEnv(teams(5), seed=3)
    rows = [play_batch(env, Scripted(script(5, 10)), seed) for seed in (7, 8, 7)]
    assert rows[0] == rows[2] != rows[1]
    assert rows[0] == play_batch(TeamVecEnv(teams(5)), Scripted(script(5, 10)), 7)


def test_nothing_of_it_is_differentiated():
    env = TeamVecEnv(teams(2))

    class Watching(Scripted):
        def act(self, observations):
            assert torch.is_inference_mode_enabled()
            return super().act(observations)

    play_batch(env, Watching(script(2, 10)), 0)
    assert not torch.is_inference_mode_enabled()
