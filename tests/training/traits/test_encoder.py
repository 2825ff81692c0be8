import numpy as np
import pytest
import torch
from demonstrations import LAYOUT, made_up
from hypothesis import given
from hypothesis import strategies as st
from trait_models import SMALL

from hmi_marl.agents.learned.situations import ACTIONS, situations
from hmi_marl.agents.learned.trait_encoder import Encoder, behaviour
from hmi_marl.agents.learned.trait_model import TraitCard
from hmi_marl.training.traits.encoder import (
    FIRST_LOG_VARIANCE,
    FORGETTING,
    ContextEncoder,
    Posterior,
)
from hmi_marl.training.traits.episodes import Episodes
from hmi_marl.training.traits.windows import Batch, Windows

CARD = TraitCard(tuple((part.name, part.size) for part in LAYOUT.parts), latent=3, encoder=SMALL)
LENGTH = [3, 7, 2, 7, 5, 4]
OBSERVED = made_up(LENGTH, driver=[0, 1, 0, 1, 0, 1], names=("lisa", "bart")).observed
UNITS = Episodes.of(OBSERVED).units
WINDOWS = Windows(Episodes.of(OBSERVED), np.full(6, np.nan))
POOLS = np.array([[0, 2, 4], [1, 3, 5]])
BATCH = WINDOWS.batch(POOLS)
CLOSE = {"rtol": 1e-4, "atol": 1e-4}


def made() -> ContextEncoder:
    """An encoder whose weights make what it returns differ, with units."""
    encoder = ContextEncoder(CARD)
    generator = torch.Generator().manual_seed(0)
    with torch.no_grad():
        for weight in encoder.parameters():
            weight.copy_(0.7 * torch.randn(weight.shape, generator=generator))
    encoder.centre.copy_(torch.tensor([0.5, -1.0, 2.0]))
    encoder.scale.copy_(torch.tensor([0.3, 1.0, 4.0]))
    return encoder


@pytest.fixture
def encoder() -> ContextEncoder:
    return made()


def in_numpy(encoder: ContextEncoder) -> Encoder:
    units = {"state.centre": UNITS.centre, "state.scale": UNITS.scale}
    return Encoder(CARD.encoder, encoder.arrays() | units, CARD.latent)


def steps_of(batch: Batch, pool: int, window: int) -> Batch:
    """One window alone, without what comes after its end."""
    length = int(batch.length[pool, window])
    here = slice(pool, pool + 1), slice(window, window + 1)
    return Batch(
        batch.situations[here][:, :, :length],
        batch.actions[here][:, :, :length],
        batch.length[here],
    )


def test_numpy_encodes_as_torch_does(encoder: ContextEncoder) -> None:
    numpy = in_numpy(encoder)
    encoded = numpy.encode(OBSERVED.states, OBSERVED.actions, OBSERVED.alerts, OBSERVED.length)
    with torch.no_grad():
        sums = encoder.sums(BATCH)
        posterior = encoder(BATCH)
    np.testing.assert_allclose(encoded[POOLS], sums, **CLOSE)
    assert (encoded[:, :-1].std(axis=0) > 0).any()
    latent = numpy.latent(encoded[POOLS].sum(axis=1))
    np.testing.assert_allclose(latent.mean, posterior.mean, **CLOSE)
    np.testing.assert_allclose(latent.variance, posterior.log_variance.exp(), rtol=1e-3)


def test_the_weights_fit_the_card_and_are_copies(encoder: ContextEncoder) -> None:
    arrays = encoder.arrays()
    shapes = CARD.encoder.shapes(CARD.state_size, CARD.latent)
    assert {name: values.shape for name, values in arrays.items()} == shapes
    before = {name: values.copy() for name, values in arrays.items()}
    with torch.no_grad():
        for weight in encoder.parameters():
            weight.add_(1.0)
    for name, values in before.items():
        np.testing.assert_array_equal(arrays[name], values)


def test_torch_reads_what_numpy_reads(encoder: ContextEncoder) -> None:
    x, actions = BATCH.situations, BATCH.actions
    with torch.no_grad():
        read, log_average = encoder.behaviour(x, actions), encoder.log_average(x)
    for pool, window in np.ndindex(2, 3):
        here = pool, window, slice(0, int(BATCH.length[pool, window]))
        expected = behaviour(x[here].numpy(), actions[here].numpy(), log_average[here].numpy())
        np.testing.assert_allclose(read[here], expected, **CLOSE)


def test_a_window_is_the_same_alone(encoder: ContextEncoder) -> None:
    together = encoder.sums(BATCH)
    for pool, window in np.ndindex(2, 3):
        alone = encoder.sums(steps_of(BATCH, pool, window))[0, 0]
        torch.testing.assert_close(together[pool, window], alone)


@given(st.permutations(range(3)))
def test_the_order_of_windows_does_not_matter(order: list[int]) -> None:
    encoder = made()
    shuffled = Batch(*(values[:, list(order)] for values in BATCH))
    torch.testing.assert_close(encoder(shuffled).mean, encoder(BATCH).mean)


def test_pools_do_not_know_of_each_other(encoder: ContextEncoder) -> None:
    swapped = Batch(*(values.flip(0) for values in BATCH))
    torch.testing.assert_close(encoder(swapped).mean, encoder(BATCH).mean.flip(0))


def test_what_comes_after_a_windows_end_is_not_read(encoder: ContextEncoder) -> None:
    x, actions, length = BATCH
    over = torch.arange(x.shape[2]) >= length[..., None]
    assert over.any()
    other = Batch(
        torch.where(over[..., None], torch.randn(x.shape), x).requires_grad_(),
        torch.where(over, 3, actions),
        length,
    )
    sums = encoder.sums(other)
    torch.testing.assert_close(sums, encoder.sums(BATCH))
    sums.sum().backward()
    assert other.situations.grad is not None
    assert not other.situations.grad[over].any()
    assert other.situations.grad[~over].any()


def test_two_steps_of_one_action_differ_from_two_of_different_ones(
    encoder: ContextEncoder,
) -> None:
    # Only the inputs that say "repeated" are read: eleven columns, before the two of likelihood.
    with torch.no_grad():
        encoder.step_layer.weight[:, :-13] = 0.0
        encoder.step_layer.weight[:, -5:] = 0.0  # likelihoods and the state
    states, alerts = np.zeros((3, 2, LAYOUT.size), np.float32), np.zeros((3, 2), np.int64)
    actions = np.array([[1, 1], [4, 4], [1, 4]])
    x = torch.from_numpy(situations(states, actions, alerts))
    batch = Batch(x[:, None], torch.from_numpy(actions)[:, None], torch.full((3, 1), 2))
    read = encoder.sums(batch)
    torch.testing.assert_close(read[0], read[1])
    assert not torch.allclose(read[0], read[2])


def test_the_average_driver_learns_from_nothing_but_imitation(encoder: ContextEncoder) -> None:
    encoder(BATCH).mean.sum().backward()
    assert all(weight.grad is None for weight in encoder.average.parameters())
    learning = {id(weight) for weight in encoder.learning()}
    assert len(learning) == len(list(encoder.parameters())) - 4  # two layers
    assert not any(id(weight) in learning for weight in encoder.average.parameters())


def test_z_depends_on_its_mean_at_the_start() -> None:
    posterior = ContextEncoder(CARD)(BATCH)
    assert (posterior.log_variance - FIRST_LOG_VARIANCE).abs().max() < 1.5


def test_units_are_of_the_batch_and_running_averages_follow_slowly() -> None:
    encoder = made()
    encoder.centre.zero_()
    encoder.scale.fill_(1.0)
    sums = torch.rand(5, SMALL.features + 1) + 1.0
    raw = encoder.raw(sums).mean
    posterior = encoder.posterior(sums, *encoder.units(sums))
    torch.testing.assert_close(posterior.mean.mean(dim=0), torch.zeros(3), atol=1e-4, rtol=0)
    torch.testing.assert_close(posterior.mean.std(dim=0), torch.ones(3), atol=1e-2, rtol=0)
    # From centre 0 and scale 1, by a share of the way.
    torch.testing.assert_close(encoder.centre, FORGETTING * raw.mean(dim=0))
    expected = 1 + FORGETTING * (raw.std(dim=0) - 1)
    torch.testing.assert_close(encoder.scale, expected, atol=1e-5, rtol=0)
    assert not encoder.centre.requires_grad


def test_the_posterior_is_in_running_units(encoder: ContextEncoder) -> None:
    sums = encoder.sums(BATCH).sum(dim=1)
    mean, log_variance = encoder.raw(sums)
    posterior = encoder(BATCH)
    torch.testing.assert_close(posterior.mean, (mean - encoder.centre) / encoder.scale)
    torch.testing.assert_close(posterior.log_variance, log_variance)


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


def test_actions_are_as_many_as_logits(encoder: ContextEncoder) -> None:
    log_average = encoder.log_average(BATCH.situations)
    assert log_average.shape == (2, 3, 7, ACTIONS)
    torch.testing.assert_close(log_average.exp().sum(dim=-1), torch.ones(2, 3, 7))
