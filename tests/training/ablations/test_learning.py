"""Learning of an encoder alone: as a run of trait models does it, from the first strangers."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
import torch
from trait_models import SMALL

from hmi_marl.agents.learned.trait_model import load_traits
from hmi_marl.demonstrations.parquet import read_observed, write_demonstrations
from hmi_marl.demonstrations.recording import CollectSettings, collect
from hmi_marl.demonstrations.stored import OBSERVED, TRUTH
from hmi_marl.training.ablations.design import EncoderDesign
from hmi_marl.training.ablations.encoders import DesignedEncoder
from hmi_marl.training.ablations.learning import LearnedEncoder, learn_encoder, make_updates
from hmi_marl.training.protocols.settings import PPOSettings
from hmi_marl.training.traits import run
from hmi_marl.training.traits.settings import TraitSettings

TINY = TraitSettings(
    steps=20,
    imitation_updates=0,
    num_teams=4,
    pool=2,
    expert_pools=2,
    average_updates=2,
    encoder_updates=3,
    drivers_per_update=3,
    encoder=SMALL,
    ppo=PPOSettings(num_learning_epochs=1, num_mini_batches=2),
    device="cpu",
)
PEOPLE = CollectSettings(
    drivers=(), population=4, windows=4, duration=1.0, vehicles=(1, 2), num_teams=16
)


@pytest.fixture(scope="module")
def strangers(tmp_path_factory):
    """Four windows of five steps of each of four strangers."""
    folder = tmp_path_factory.mktemp("strangers")
    write_demonstrations(folder, collect(PEOPLE))
    return folder


def test_the_default_learns_what_a_run_of_trait_models_learns(strangers, tmp_path):
    run.learn_traits(TINY, strangers, tmp_path / "run", quiet=True)
    model = load_traits(tmp_path / "run")
    begun = run._Run(TINY, strangers, tmp_path / "other", None, quiet=True)
    encoder = DesignedEncoder(begun._card, EncoderDesign())
    first = begun._discriminator.model.encoder
    encoder.load_state_dict(first.state_dict())
    make_updates(encoder, begun._windows, TINY)
    moved = [not np.array_equal(first.arrays()[name], a) for name, a in encoder.arrays().items()]
    assert all(moved)
    for name, values in encoder.arrays().items():
        np.testing.assert_array_equal(model.weights[name], values)
    # And it encodes as the model does.
    observed = read_observed(strangers)
    learned = LearnedEncoder(encoder, begun._units)
    sums, pools = learned.encode(strangers), np.arange(16).reshape(4, 4)
    # Sums of up to ten numbers of size 1, which processors round differently.
    np.testing.assert_allclose(sums, model.encode(observed), rtol=1e-4, atol=1e-4)
    ours, theirs = learned.latents(sums, pools), model.latents(sums, pools)
    for one, other in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-4, atol=1e-4)


def test_it_learns_from_the_first_strangers_and_windows_alone(strangers, tmp_path):
    write_demonstrations(tmp_path, collect(replace(PEOPLE, population=3, windows=2)))
    calls = []

    def weights(dataset):
        learned = learn_encoder(EncoderDesign(), TINY, dataset, 3, 2, lambda: calls.append(None))
        return learned.encoder.state_dict()

    few, cut = weights(tmp_path), weights(strangers)
    for name, values in few.items():
        torch.testing.assert_close(cut[name], values, rtol=0, atol=0)
    assert len(calls) == 2 * (TINY.average_updates + TINY.encoder_updates)
    with pytest.raises(ValueError, match="holds no 3 strangers with 3 windows each"):
        learn_encoder(EncoderDesign(), TINY, tmp_path, 3, 3)


@pytest.mark.parametrize("loss", ["posteriors", "margin"])
def test_it_learns_and_encodes_where_the_truth_is_gone(loss, strangers, tmp_path):
    shutil.copy(strangers / OBSERVED, tmp_path)
    both = [learn_encoder(EncoderDesign(loss=loss), TINY, f, 4, 4) for f in (strangers, tmp_path)]
    for known, blind in zip(*(each.encoder.state_dict().items() for each in both), strict=True):
        assert known[0] == blind[0]
        torch.testing.assert_close(blind[1], known[1], rtol=0, atol=0)
    np.testing.assert_array_equal(both[0].encode(strangers), both[1].encode(tmp_path))
    assert not (tmp_path / TRUTH).exists()


def test_the_seed_decides(strangers):
    def weights(seed):
        settings = replace(TINY, seed=seed)
        return learn_encoder(EncoderDesign(loss="cosine"), settings, strangers, 4, 4).encoder

    one, again, other = (weights(seed).head[0].weight for seed in (0, 0, 1))
    assert torch.equal(one, again)
    assert not torch.equal(one, other)
