import numpy as np
import pytest
import torch
from evidence_models import untrained_evidence

from hmi_marl.agents.learned.policy import load_policy
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import DRIVERS, PAPER_DRIVERS, Traits, get_driver
from hmi_marl.training.evidence.conditioned import HMI_READS, Places, conditioned_hmi, strangers
from hmi_marl.training.ppo.run import train


def test_places_are_the_models():
    model = untrained_evidence(TeamConfig(ai_sees_attention=False))
    places = Places(model)
    assert places.size == 3
    traits = Traits.of(DRIVERS.values())
    found = places(torch.from_numpy(traits.as_array().astype(np.float32)))
    assert found.dtype == torch.float32
    np.testing.assert_allclose(found.numpy(), model.places(traits), rtol=1e-5, atol=1e-6)


def test_strangers_come_back_by_their_seed():
    one = strangers(20, 3)
    assert strangers(20, 3) == one
    assert strangers(12, 3) == one[:12]
    assert not set(strangers(20, 4)) & set(one)
    drivers = [get_driver(text) for text in one]
    assert [driver.name for driver in drivers[:2]] == ["stranger-0", "stranger-1"]
    assert len({driver.traits for driver in drivers}) == 20


def test_strangers_are_drawn_evenly():
    table = np.array([get_driver(text).traits for text in strangers(1000, 0)])
    middle, width = np.array([0.5, 0.5, 0.5, 5.0]), np.array([1.0, 1.0, 1.0, 8.0])
    assert (np.abs(table.mean(axis=0) - middle) < 4 * width / np.sqrt(12 * 1000)).all()
    assert (np.abs(table - middle) <= width / 2).all()


@pytest.mark.parametrize("others", [128, 40])
def test_the_types_drive_in_about_a_third_of_the_episodes(others):
    settings = conditioned_hmi("rule", 100, 8, 16, seed=1, others=others)
    known = [name for name in settings.drivers if name in PAPER_DRIVERS]
    assert known.count("lisa") == known.count("homer") == others // 8
    assert len(known) / len(settings.drivers) == pytest.approx(1 / 3, abs=0.01)
    assert settings.drivers[len(known) :] == strangers(others, 1)
    assert not settings.ai_sees_attention


def test_an_hmi_is_learned_that_is_conditioned_on_places(tmp_path):
    model = untrained_evidence(TeamConfig(ai_sees_attention=False))
    settings = conditioned_hmi("random", 1, 4, 16, seed=0, others=8)
    train(settings, tmp_path, context=Places(model), quiet=True)
    policy = load_policy(tmp_path, "vehicle_ai", TeamConfig(ai_sees_attention=False))
    assert policy.card.context == 3
    assert dict(policy.card.reads).keys() == set(HMI_READS)
    assert policy.card.network.rnn_hidden_dim == 4
