import math

import numpy as np
import pytest
import torch
from demonstrations import LAYOUT, made_up
from trait_models import SMALL

from hmi_marl.agents.learned.network import NetworkConfig
from hmi_marl.agents.learned.situations import ACTIONS, EXTRA, situations
from hmi_marl.agents.learned.trait_model import TraitCard, TraitModel
from hmi_marl.training.traits.episodes import Episodes
from hmi_marl.training.traits.model import (
    Discriminator,
    Reward,
    log_likelihood,
    log_policy,
    make_policy,
    make_value,
    weights_of_model,
)
from hmi_marl.training.traits.windows import Windows, transitions

CARD = TraitCard(
    tuple((part.name, part.size) for part in LAYOUT.parts),
    latent=3,
    encoder=SMALL,
    gamma=0.9,
    reward=NetworkConfig((7, 5), "tanh"),
    potential=NetworkConfig((4,), "elu"),
    policy=NetworkConfig((8,)),
)
LENGTH = [3, 7, 2, 7, 5, 4]
OBSERVED = made_up(LENGTH, driver=[0, 1, 0, 1, 0, 1], names=("lisa", "bart")).observed
UNITS = Episodes.of(OBSERVED).units
WINDOWS = Windows(Episodes.of(OBSERVED), np.full(6, np.nan))
POOLS = np.array([[0, 2, 4], [1, 3, 5]])
BATCH = WINDOWS.batch(POOLS)
X = situations(OBSERVED.states, OBSERVED.actions, OBSERVED.alerts)
CLOSE = {"rtol": 1e-4, "atol": 1e-5}


def loud(module: torch.nn.Module, seed: int = 0) -> torch.nn.Module:
    """The module with weights that make what it gives differ."""
    generator = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for weight in module.parameters():
            weight.copy_(0.7 * torch.randn(weight.shape, generator=generator))
    return module


@pytest.fixture
def learned() -> tuple[Discriminator, torch.nn.Module, TraitModel]:
    """A model in torch, and the same in NumPy."""
    discriminator, policy = loud(Discriminator(CARD)), make_policy(CARD)
    loud(policy.mlp, seed=1)
    return (
        discriminator,
        policy,
        TraitModel(
            CARD, weights_of_model(discriminator.encoder, discriminator.reward, policy, UNITS)
        ),
    )


# f and π.


def test_f_by_hand() -> None:
    # With no weights but the last biases, g = 3 and h = 2 everywhere: f = 3 + 0.9 · 2 − 2 = 2.8.
    reward = Reward(CARD)
    with torch.no_grad():
        for weight in reward.parameters():
            weight.zero_()
        reward.reward[-1].bias.fill_(3.0)
        reward.potential[-1].bias.fill_(2.0)
    before, actions, after, _ = transitions(BATCH)
    f = reward(before, actions, after, torch.randn(len(before), 3))
    torch.testing.assert_close(f, torch.full((len(before),), 2.8))


def test_the_potential_is_of_where_one_is_and_pays_along_a_drive() -> None:
    # Without g, f telescopes: Σ γ^t f_t = γ^T h(s_T) − h(s_0).
    reward = loud(Reward(CARD))
    with torch.no_grad():
        reward.reward[-1].weight.zero_()
        reward.reward[-1].bias.zero_()
    x, actions, length = BATCH.situations[1, 0], BATCH.actions[1, 0], int(BATCH.length[1, 0])
    z = torch.randn(1, 3).expand(length - 1, -1)
    f = reward(x[: length - 1], actions[: length - 1], x[1:length], z)
    total = (0.9 ** torch.arange(length - 1) * f).sum()
    first, last = (
        reward.potential(torch.cat([x[[t]], z[:1]], dim=1)).item() for t in (0, length - 1)
    )
    assert total.item() == pytest.approx(0.9 ** (length - 1) * last - first, abs=1e-4)


def test_f_depends_on_action_and_z() -> None:
    reward = loud(Reward(CARD))
    before, actions, after, pool = transitions(BATCH)
    z = torch.randn(2, 3)[pool]
    f = reward(before, actions, after, z)
    assert (reward(before, (actions + 1) % ACTIONS, after, z) != f).all()
    assert (reward(before, actions, after, z + 1) != f).all()


def test_the_log_likelihood_is_of_the_steps_that_there_were() -> None:
    policy = make_policy(CARD)
    loud(policy.mlp)
    z = torch.randn(2, 3)
    found = log_likelihood(policy, BATCH, z)
    expected = []
    for pool, window in np.ndindex(2, 3):
        for t in range(int(BATCH.length[pool, window])):
            probabilities = log_policy(policy, BATCH.situations[pool, window, t], z[pool]).exp()
            assert probabilities.sum().item() == pytest.approx(1.0, abs=1e-5)
            expected.append(math.log(probabilities[BATCH.actions[pool, window, t]].item()))
    np.testing.assert_allclose(found.detach(), expected, **CLOSE)


def test_policy_and_value_read_a_situation_and_z() -> None:
    inputs = LAYOUT.size + EXTRA + 3
    assert make_policy(CARD).mlp(torch.zeros(2, inputs)).shape == (2, ACTIONS)
    assert make_value(CARD).mlp(torch.zeros(2, inputs)).shape == (2, 1)


# The same in NumPy.


def test_the_weights_fit_the_card_and_are_copies() -> None:
    discriminator, policy = Discriminator(CARD), make_policy(CARD)
    weights = weights_of_model(discriminator.encoder, discriminator.reward, policy, UNITS)
    assert {name: values.shape for name, values in weights.items()} == CARD.shapes
    assert {values.dtype for values in weights.values()} == {np.dtype(np.float32)}
    before = {name: values.copy() for name, values in weights.items()}
    loud(discriminator)
    loud(policy.mlp)
    for name, values in before.items():
        np.testing.assert_array_equal(weights[name], values)


def test_numpy_drives_as_torch_does(learned) -> None:  # type: ignore[no-untyped-def]
    _, policy, model = learned
    z = np.random.default_rng(1).standard_normal((6, 3))
    x = torch.from_numpy(UNITS.standardise(X))
    with torch.no_grad():
        expected = log_policy(policy, x[:, 0], torch.from_numpy(z).float())
        shared = log_policy(policy, x[:, 0], torch.from_numpy(z[:1]).float().expand(6, -1))
    found = model.policy(X[:, 0], z)
    np.testing.assert_allclose(found, expected, **CLOSE)
    np.testing.assert_allclose(np.exp(found).sum(axis=1), 1.0)
    np.testing.assert_allclose(model.policy(X[:, 0], z[0]), shared, **CLOSE)


def test_numpy_rewards_as_torch_does(learned) -> None:  # type: ignore[no-untyped-def]
    discriminator, _, model = learned
    rng = np.random.default_rng(2)
    drives, t = np.array([1, 3, 4, 1]), np.array([0, 5, 3, 2])
    before, actions, after = X[drives, t], OBSERVED.actions[drives, t], X[drives, t + 1]
    z = rng.standard_normal((4, 3))
    x, later = (torch.from_numpy(UNITS.standardise(s)) for s in (before, after))
    done, given_z = torch.from_numpy(actions), torch.from_numpy(z).float()
    with torch.no_grad():
        f = discriminator.reward(x, done, later, given_z)
        g = discriminator.reward.reward(torch.cat([x, torch.eye(5)[done], given_z], 1))[:, 0]
    np.testing.assert_allclose(model.reward(before, actions, after, z), f, **CLOSE)
    np.testing.assert_allclose(model.base_reward(before, actions, z), g, **CLOSE)
