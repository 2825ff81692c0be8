import numpy as np
import pytest
import torch

import hmi_marl
from hmi_marl import Scene

SMALL = {"scene": Scene(vehicles=4), "duration": 3.0}


@pytest.mark.parametrize("seat", ["driver", "vehicle_ai", "team"])
def test_the_batched_world_gives_what_highway_env_gives(seat):
    envs = [
        hmi_marl.make_vec(4, seat, world=world, driver=["bart", "homer"], **SMALL)
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
    env = hmi_marl.make_vec(1000, "team", threads=1, driver="bart", **SMALL)
    actions = torch.zeros(1000, 2, dtype=torch.int64)
    for _ in range(40):
        observations, rewards, dones, extras = env.step(actions)
        assert torch.isfinite(rewards).all()
        if dones.any():
            assert len(extras["final_teams"]) == int(dones.sum())
    assert observations["critic"].shape == (1000, env.layouts["critic"].size)
    with pytest.raises(ValueError, match="threads lies in"):
        hmi_marl.make_vec(2, threads=10_000)


def test_any_team_can_be_seen_at_any_time():
    env = hmi_marl.make_vec(30, "team", driver=["bart", "homer"], **SMALL)
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
