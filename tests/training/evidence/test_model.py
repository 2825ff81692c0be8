import numpy as np
import pytest
import torch
from evidence_models import (
    HIDDEN,
    SMALL,
    any_alerts,
    any_intents,
    seeds,
    trait_model,
    turns,
)
from standing_world import standing_teams

from hmi_marl.agents.adaptive.evidence_model import (
    EvidenceCard,
    EvidenceModel,
    LearnedEvidence,
    Turns,
)
from hmi_marl.agents.adaptive.trip_encoder import TripEncoder
from hmi_marl.agents.learned.network import NetworkConfig
from hmi_marl.envs.drivers import DRIVERS, Traits
from hmi_marl.envs.observations import traits_part
from hmi_marl.training.evidence.model import LOSS_EVERY, EvidenceNetwork

FIVE = list(DRIVERS.values())


def small_card(**sizes):
    return EvidenceCard.for_team(HIDDEN, trait_model(), **(SMALL | sizes))


def random_module(card, seed=0):
    """Weights as torch draws them, units that are none of 0 and 1."""
    torch.manual_seed(seed)
    module = EvidenceNetwork(card)
    module.centre.normal_()
    module.scale.uniform_(0.5, 2.0)
    return module


@pytest.mark.parametrize(
    "sizes",
    [
        {},
        {"reader": NetworkConfig((7, 5), "elu")},
        {"place": NetworkConfig((6, 6), "relu"), "latent": 8},
    ],
    ids=["small", "two layers", "larger vectors"],
)
def test_it_is_the_function_that_acts(sizes):
    module = random_module(small_card(**sizes))
    model = EvidenceModel(module.card, module.weights())
    teams = standing_teams(5, driver="bart", ai_sees_attention=False, duration=4.0)
    teams.reset(seeds(5))
    evidence = LearnedEvidence(model, trait_model(), FIVE, HIDDEN)
    reader = Turns([n for n, _ in module.card.reads], teams.layouts["vehicle_ai"])
    evidence.reset(5)
    reader.reset(5)
    encoder = TripEncoder(trait_model(), HIDDEN)
    encoder.reset(5)
    every, read, gains = np.ones(5, np.bool_), [], []
    for seen in turns(teams, any_intents(20, 5), any_alerts(20, 5)):
        features = encoder.observe(seen, every).astype(np.float32)
        read.append(np.concatenate([features, reader.read(seen, every)], axis=1))
        gains.append(evidence.observe(seen, every))
    shown = torch.from_numpy(traits_part(Traits.of(FIVE)).astype(np.float32))
    with torch.no_grad():
        told = module(torch.from_numpy(np.stack(read, axis=1)), shown).numpy()
    assert told.shape == (5, 20, 5)
    np.testing.assert_allclose(told, np.cumsum(gains, axis=0).transpose(1, 0, 2), atol=1e-4)
    np.testing.assert_allclose(
        np.diff(told, axis=1), np.array(gains).transpose(1, 0, 2)[:, 1:], atol=1e-5
    )
    assert np.abs(told).max() > 0.1


def test_evidence_may_be_asked_for_in_some_turns_alone():
    module = random_module(small_card())
    read, shown = torch.randn(2, 20, module.card.inputs), torch.rand(3, 4)
    with torch.no_grad():
        every, fourth = module(read, shown), module(read, shown, 4)
    assert every.shape == (2, 20, 3)
    # Products of other shapes round in another way on some processors.
    np.testing.assert_allclose(fourth, every[:, [3, 7, 11, 15, 19]], rtol=1e-5, atol=1e-6)


def test_the_loss_by_hand():
    module = random_module(small_card())
    read, shown = torch.randn(3, 20, module.card.inputs), torch.rand(3, 4)
    lengths = (20, 14, 6)
    driving = torch.arange(20) < torch.tensor(lengths)[:, None]
    with torch.no_grad():
        told = module(read, shown).numpy().astype(np.float64)
        loss = module.loss(read, driving, shown).item()
    each = [
        np.log(np.exp(told[b, t]).sum()) - told[b, t, b]
        for b, length in enumerate(lengths)
        for t in range(LOSS_EVERY - 1, length, LOSS_EVERY)
    ]
    assert len(each) > 3
    assert loss == pytest.approx(np.mean(each), rel=1e-5)


def test_settling_scales_evidence_for_one_driver_over_another_and_nothing_else():
    module = random_module(small_card())
    read, shown = torch.randn(2, 20, module.card.inputs), torch.rand(5, 4)
    with torch.no_grad():
        before = module(read, shown)
        module.settle(0.3, shown)
        after, places = module(read, shown), module.place(shown)
    over_another = [told[..., 1:] - told[..., :1] for told in (before, after)]
    assert over_another[0].abs().max() > 0.1
    np.testing.assert_allclose(over_another[1], 0.3 * over_another[0], rtol=1e-3, atol=1e-4)
    np.testing.assert_allclose(places.mean(dim=0), 0.0, atol=1e-5)
    np.testing.assert_allclose(places.std(dim=0), 1.0, atol=1e-4)


def test_the_loss_of_whole_drives_by_hand():
    module = random_module(small_card())
    read, shown = torch.randn(3, 20, module.card.inputs), torch.rand(3, 4)
    lengths = (20, 14, 1)
    driving = torch.arange(20) < torch.tensor(lengths)[:, None]
    with torch.no_grad():
        told = module(read, shown).numpy().astype(np.float64)
        losses = module.loss_at_end(read, driving, shown, torch.tensor([0.5, 1.0]))
    for temperature, loss in zip((0.5, 1.0), losses, strict=True):
        each = []
        for b, length in enumerate(lengths):
            last = temperature * told[b, length - 1]
            each.append(np.log(np.exp(last).sum()) - last[b])
        assert loss.item() == pytest.approx(np.mean(each), rel=1e-4)


def test_turns_that_there_were_not_are_not_learned_from():
    module = random_module(small_card())
    read = torch.randn(3, 20, module.card.inputs)
    driving = torch.arange(20) < torch.tensor([[20], [9], [13]])
    shown = torch.rand(3, 4)
    other = torch.where(driving[..., None], read, torch.randn_like(read))
    losses = [module.loss(each, driving, shown) for each in (read, other)]
    assert losses[0].item() == pytest.approx(losses[1].item(), rel=1e-6)
    assert module.loss(other, torch.ones_like(driving), shown).item() != losses[0].item()


def test_the_expected_z_is_learned_by_its_squared_error():
    module = random_module(small_card())
    z, shown = torch.randn(6, module.card.context), torch.rand(6, 4)
    with torch.no_grad():
        found, loss = module.expected(shown), module.expected_loss(z, shown)
    assert loss.item() == pytest.approx(np.square((found - z).numpy()).mean(), rel=1e-5)
    before = {name: values.clone() for name, values in module.place.state_dict().items()}
    descent = torch.optim.Adam(module.parameters(), 0.02)
    for _ in range(300):
        descent.zero_grad()
        module.expected_loss(z, shown).backward()
        descent.step()
    assert module.expected_loss(z, shown) < 0.5 * loss
    for name, values in module.place.state_dict().items():
        np.testing.assert_array_equal(values, before[name])


def test_weights_are_those_of_the_card():
    card = small_card()
    weights = random_module(card).weights()
    assert {name: values.shape for name, values in weights.items()} == card.shapes
