from dataclasses import replace

import numpy as np
import pytest
import torch

from hmi_marl.agents.learned.network import NetworkConfig
from hmi_marl.demonstrations.dataset import observed_layout
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.scene import Scene
from hmi_marl.training.protocols.settings import PPOSettings
from hmi_marl.training.traits.episodes import Units
from hmi_marl.training.traits.generator import Generator
from hmi_marl.training.traits.model import log_policy
from hmi_marl.training.traits.settings import TraitSettings

CONFIG = TeamConfig(duration=1.0, end_at_crash=False, scene=Scene(vehicles=(1, 2)))
SETTINGS = TraitSettings(
    num_teams=8,
    pool=4,
    latent=2,
    policy=NetworkConfig((8,)),
    ppo=PPOSettings(num_mini_batches=2, num_learning_epochs=2),
)
CARD = SETTINGS.card(observed_layout(CONFIG))
SIZE = observed_layout(CONFIG).size
UNITS = Units(np.full(SIZE, 0.5, np.float32), np.full(SIZE, 2.0, np.float32))
Z = torch.tensor([[1.0, 0.0], [0.0, -1.0]])
SEEDS = np.arange(8, dtype=np.uint64)


def generator(settings=SETTINGS):
    torch.manual_seed(0)
    one = Generator(CARD, settings, CONFIG, 0.3, UNITS, "cpu")
    one.begin(0.0)
    return one


def test_pools_of_cars_drive_with_one_z_in_standard_units():
    one = generator()
    torch.manual_seed(1)
    drives, batch = one.drive(Z, SEEDS)
    assert batch.situations.shape == (2, 4, 5, CARD.situation_size)
    assert (batch.length == 5).all()
    raw = torch.from_numpy(drives.situations).reshape(batch.situations.shape)
    torch.testing.assert_close(batch.situations[..., :SIZE], (raw[..., :SIZE] - 0.5) / 2)
    torch.testing.assert_close(batch.situations[..., SIZE:], raw[..., SIZE:])
    seen = one.learner.shards[0].rollout.actor  # (T - 1, N, D + Z)
    expected = batch.situations[:, :, :-1].reshape(8, 4, -1).transpose(0, 1)
    torch.testing.assert_close(seen[..., :-2], expected)
    torch.testing.assert_close(seen[0, :, -2:], Z.repeat_interleave(4, dim=0))


def test_it_learns_for_f_less_log_pi():
    one = generator()
    torch.manual_seed(1)
    _, batch = one.drive(Z, SEEDS)
    f = torch.arange(2 * 4 * 4, dtype=torch.float32).reshape(2, 4, 4)
    with torch.no_grad():
        given = Z[:, None, None].expand(2, 4, 5, 2)
        every = log_policy(one.policy, batch.situations, given)
    log_pi = every.gather(3, batch.actions[..., None]).squeeze(3)[:, :, :-1]
    storage = one.learner.shards[0].rollout
    assert not storage.rewards.any()
    given, learn = [], one.learner.learn
    one.learner.learn = lambda seen, rewards: given.append(rewards) or learn(seen, rewards)
    row = one.learn(batch, Z, f)
    expected = (f - log_pi).reshape(8, 4).T
    torch.testing.assert_close(given[0], expected)
    torch.testing.assert_close(storage.rewards, SETTINGS.ppo.reward_scale * expected)
    assert row["return"] == pytest.approx((f - log_pi).sum(dim=2).mean().item(), rel=1e-5)


def test_it_learns_what_pays():
    one = generator(replace(SETTINGS, ppo=replace(SETTINGS.ppo, learning_rate=1e-2)))
    shares = []
    for number in range(30):
        torch.manual_seed(number)
        one.begin(0.0)
        _, batch = one.drive(Z, SEEDS + 8 * number)
        paid = (batch.actions[:, :, :-1] == 1).float()
        shares.append(paid.mean().item())
        one.learn(batch, Z, 5.0 * paid)
    assert np.mean(shares[-5:]) > np.mean(shares[:5]) + 0.3


def test_what_was_not_learned_from_is_forgotten():
    one = generator()
    for number in range(2):  # a full storage would raise
        drives, _ = one.drive(Z, SEEDS + number)
    assert drives.actions.shape == (8, 5)
