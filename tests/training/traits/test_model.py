import math

import numpy as np
import pytest
import torch
from demonstrations import LAYOUT, made_up
from hypothesis import given
from hypothesis import strategies as st

from hmi_marl.agents.learned.network import NetworkConfig
from hmi_marl.agents.learned.trait_model import (
    ACTIONS,
    EXTRA,
    TraitCard,
    TraitModel,
    encoder_inputs,
    situations,
)
from hmi_marl.training.traits.model import (
    FORGETTING,
    SMALLEST_UNIT,
    ContextEncoder,
    Discriminator,
    Posterior,
    Reward,
    log_likelihood,
    log_policy,
    make_policy,
    make_value,
    weights_of_model,
)
from hmi_marl.training.traits.windows import Batch, Units, Windows, transitions

CARD = TraitCard(
    tuple((part.name, part.size) for part in LAYOUT.parts),
    latent=3,
    encoder_units=6,
    gamma=0.9,
    reward=NetworkConfig((7, 5), "tanh"),
    potential=NetworkConfig((4,), "elu"),
    policy=NetworkConfig((8,)),
)
LENGTH = [3, 7, 2, 7, 5, 4]
OBSERVED = made_up(LENGTH, driver=[0, 1, 0, 1, 0, 1], names=("lisa", "bart")).observed
UNITS = Units.of(OBSERVED)
WINDOWS = Windows(OBSERVED, np.full(6, np.nan), UNITS)
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
def encoder() -> ContextEncoder:
    return loud(ContextEncoder(CARD))  # type: ignore[return-value]


@pytest.fixture
def learned() -> tuple[Discriminator, torch.nn.Module, TraitModel]:
    """A model in torch, whose encoder has units, and the same in NumPy."""
    discriminator, policy = loud(Discriminator(CARD)), make_policy(CARD)
    loud(policy.mlp, seed=1)
    discriminator.encoder.standardise_by(BATCH)
    discriminator.encoder.centre.copy_(torch.tensor([0.5, -1.0, 2.0]))
    discriminator.encoder.scale.copy_(torch.tensor([0.3, 1.0, 4.0]))
    return discriminator, policy, TraitModel(CARD, weights_of_model(discriminator, policy, UNITS))


def steps_of(batch: Batch, pool: int, window: int) -> Batch:
    """One window alone, without what comes after its end."""
    length = int(batch.length[pool, window])
    here = slice(pool, pool + 1), slice(window, window + 1)
    return Batch(
        batch.situations[here][:, :, :length],
        batch.actions[here][:, :, :length],
        batch.length[here],
    )


# The context encoder.


def test_a_pool_is_the_mean_of_its_windows_alone(encoder: ContextEncoder) -> None:
    together = encoder.read(*BATCH)
    assert together.shape == (2, 6)
    alone = [[encoder.read(*steps_of(BATCH, p, w))[0] for w in range(3)] for p in range(2)]
    expected = torch.stack([torch.stack(windows).mean(dim=0) for windows in alone])
    torch.testing.assert_close(together, expected)


def test_a_window_is_the_hidden_state_at_its_end(encoder: ContextEncoder) -> None:
    x, actions, _ = alone = steps_of(BATCH, 0, 1)  # of two steps
    read = encoder_inputs(x[0, 0].numpy(), actions[0, 0].numpy())
    hidden, _ = encoder.memory(torch.from_numpy(read).float()[None])
    torch.testing.assert_close(encoder.read(*alone)[0], hidden[0, 1])


def test_torch_reads_what_numpy_reads() -> None:
    read = ContextEncoder.inputs(BATCH.situations, BATCH.actions)
    for pool, window in np.ndindex(2, 3):
        x, actions, length = (values[0, 0].numpy() for values in steps_of(BATCH, pool, window))
        np.testing.assert_allclose(read[pool, window, :length], encoder_inputs(x, actions))


def test_inputs_are_in_units_of_the_steps_that_there_were(encoder: ContextEncoder) -> None:
    x, actions, length = BATCH
    over = torch.arange(x.shape[2]) >= length[..., None]
    far = Batch(torch.where(over[..., None], 1e3, x), actions, length)
    encoder.standardise_by(far)
    inputs = encoder.inputs(x, actions)[~over]
    torch.testing.assert_close(encoder.input_centre, inputs.mean(dim=0))
    expected = inputs.std(dim=0).clamp_min(SMALLEST_UNIT)  # of what hardly ever happens
    torch.testing.assert_close(encoder.input_scale, expected)
    hidden, _ = encoder.memory(((encoder.inputs(x, actions) - inputs.mean(dim=0)) / expected)[1])
    torch.testing.assert_close(encoder.read(*steps_of(BATCH, 1, 0))[0], hidden[0, length[1, 0] - 1])


@given(st.permutations(range(3)))
def test_the_order_of_windows_does_not_matter(order: list[int]) -> None:
    encoder = loud(ContextEncoder(CARD))
    shuffled = Batch(*(values[:, list(order)] for values in BATCH))
    torch.testing.assert_close(encoder.read(*shuffled), encoder.read(*BATCH))


def test_pools_do_not_know_of_each_other(encoder: ContextEncoder) -> None:
    swapped = Batch(*(values.flip(0) for values in BATCH))
    torch.testing.assert_close(encoder.read(*swapped), encoder.read(*BATCH).flip(0))


def test_what_comes_after_a_windows_end_is_not_read(encoder: ContextEncoder) -> None:
    x, actions, length = BATCH
    over = torch.arange(x.shape[2]) >= length[..., None]
    assert over.any()
    other = Batch(
        torch.where(over[..., None], torch.randn(x.shape), x).requires_grad_(),
        torch.where(over, 3, actions),
        length,
    )
    read = encoder.read(*other)
    torch.testing.assert_close(read, encoder.read(*BATCH))
    read.sum().backward()
    assert other.situations.grad is not None
    assert not other.situations.grad[over].any()
    assert other.situations.grad[~over].any(dim=1).all()


def test_two_steps_of_one_action_are_told_from_two_of_different_ones() -> None:
    # Only the inputs that say "repeated", the last, are read.
    encoder = loud(ContextEncoder(CARD))
    with torch.no_grad():
        encoder.memory.weight_ih_l0[:, : CARD.situation_size + ACTIONS] = 0.0
    states, alerts = np.zeros((3, 2, LAYOUT.size), np.float32), np.zeros((3, 2), np.int64)
    actions = np.array([[1, 1], [4, 4], [1, 4]])
    x = torch.from_numpy(situations(states, actions, alerts))
    read = encoder.read(x[:, None], torch.from_numpy(actions)[:, None], torch.full((3, 1), 2))
    torch.testing.assert_close(read[0], read[1])
    assert not torch.allclose(read[0], read[2])


def test_units_are_of_the_batch_and_running_averages_follow_slowly(encoder: ContextEncoder) -> None:
    hidden = torch.tensor(np.random.default_rng(0).standard_normal((5, 6)), dtype=torch.float32)
    raw = encoder.mean(hidden)
    centre, scale = encoder.units(hidden)
    posterior = encoder.posterior(hidden, centre, scale)
    torch.testing.assert_close(posterior.mean.mean(dim=0), torch.zeros(3), atol=1e-5, rtol=0)
    torch.testing.assert_close(posterior.mean.std(dim=0), torch.ones(3), atol=1e-3, rtol=0)
    # From centre 0 and scale 1, by a share of the way.
    torch.testing.assert_close(encoder.centre, FORGETTING * raw.mean(dim=0))
    expected = 1 + FORGETTING * (raw.std(dim=0) - 1)
    torch.testing.assert_close(encoder.scale, expected, atol=1e-5, rtol=0)
    assert not encoder.centre.requires_grad


def test_whose_driving_it_is_is_told_in_running_units(encoder: ContextEncoder) -> None:
    hidden = encoder.read(*BATCH)
    for _ in range(3):
        encoder.units(hidden)
    posterior = encoder(*BATCH)
    expected = (encoder.mean(hidden) - encoder.centre) / encoder.scale
    torch.testing.assert_close(posterior.mean, expected)
    torch.testing.assert_close(posterior.log_variance, encoder.log_variance(hidden))


def test_z_is_drawn_from_the_posterior_and_lets_gradients_pass() -> None:
    torch.manual_seed(0)
    mean = torch.tensor([[1.0, -2.0]]).repeat(40_000, 1).requires_grad_()
    log_variance = torch.tensor([[0.25, 4.0]]).log().repeat(40_000, 1).requires_grad_()
    z = Posterior(mean, log_variance).sample()
    # Standard errors: 2 / sqrt(40 000) = 0.01 of a mean, 0.7 % of a spread.
    torch.testing.assert_close(z.mean(dim=0), torch.tensor([1.0, -2.0]), atol=0.05, rtol=0)
    torch.testing.assert_close(z.std(dim=0), torch.tensor([0.5, 2.0]), atol=0, rtol=0.03)
    z.sum().backward()
    assert mean.grad is not None
    assert log_variance.grad is not None
    assert (mean.grad == 1).all()
    torch.testing.assert_close(log_variance.grad, (z - mean).detach() / 2)  # z = μ + ε e^{l/2}


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
    weights = weights_of_model(discriminator, policy, UNITS)
    assert {name: values.shape for name, values in weights.items()} == CARD.shapes
    assert {values.dtype for values in weights.values()} == {np.dtype(np.float32)}
    before = {name: values.copy() for name, values in weights.items()}
    loud(discriminator)
    loud(policy.mlp)
    for name, values in before.items():
        np.testing.assert_array_equal(weights[name], values)


def test_numpy_encodes_as_torch_does(learned) -> None:  # type: ignore[no-untyped-def]
    discriminator, _, model = learned
    encoded = model.encode(OBSERVED.states, OBSERVED.actions, OBSERVED.alerts, OBSERVED.length)
    alone = WINDOWS.batch(np.arange(6)[:, None])
    with torch.no_grad():
        np.testing.assert_allclose(encoded, discriminator.encoder.read(*alone), **CLOSE)
        posterior = discriminator.encoder(*BATCH)
    latent = model.latent(encoded[POOLS].mean(axis=1))
    np.testing.assert_allclose(latent.mean, posterior.mean, rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(latent.variance, posterior.log_variance.exp(), rtol=1e-4)


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
