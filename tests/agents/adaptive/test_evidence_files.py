from dataclasses import replace

import numpy as np
import pytest
from evidence_models import HIDDEN, SMALL, evidence_weights, trait_model, untrained_evidence
from model_cards import card_bytes, with_card, with_weights
from safetensors.numpy import save as save_tensors

from hmi_marl.agents.adaptive.evidence_model import EvidenceCard, load_evidence, save_evidence
from hmi_marl.envs.drivers import DRIVERS, Traits

CARD = EvidenceCard.for_team(
    HIDDEN,
    trait_model(),
    training={"seed": 3, "settings": {"hmis": ["never"], "place": None}},
    **SMALL,
)


def saved(folder, card=CARD, seed=0):
    return save_evidence(folder, card, evidence_weights(card, seed))


def test_a_model_comes_back_as_it_was(tmp_path):
    path = saved(tmp_path)
    assert path == tmp_path / "evidence.json"
    for place in (tmp_path, path, str(tmp_path)):
        back = load_evidence(place)
        assert back.card == CARD
        for name, values in evidence_weights(CARD).items():
            assert back.weights[name].dtype == np.float32
            np.testing.assert_array_equal(back.weights[name], values)
    whole = untrained_evidence()
    traits = Traits.of(DRIVERS.values())
    np.testing.assert_array_equal(back.places(traits), whole.places(traits))


def test_the_same_model_makes_the_same_bytes(tmp_path):
    for folder in ("one", "two"):
        saved(tmp_path / folder)
    for name in ("evidence.json", "evidence.safetensors"):
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()


def test_weights_that_do_not_fit_are_not_written(tmp_path):
    weights = evidence_weights(CARD) | {"place.layer0.bias": np.full(5, np.nan, np.float32)}
    with pytest.raises(ValueError, match=r"place\.layer0\.bias is not finite everywhere"):
        save_evidence(tmp_path, CARD, weights)
    assert list(tmp_path.iterdir()) == []


def test_what_is_not_there_is_reported(tmp_path):
    for place in (tmp_path, tmp_path / "nowhere", tmp_path / "evidence.json"):
        with pytest.raises(
            FileNotFoundError, match=r"no evidence model at .*hmi-marl reproduce ad"
        ):
            load_evidence(place)
    with pytest.raises(ValueError, match=r"unknown trained agent 'trained:nobody'"):
        load_evidence("trained:nobody")
    with pytest.raises(ValueError, match=r"trained:homer is of kind vehicle_ai .*not evidence"):
        load_evidence("trained:homer")


@pytest.mark.parametrize("place", [0, 9, 200, -1])
def test_a_changed_byte_is_noticed(tmp_path, place):
    weights = saved(tmp_path).with_suffix(".safetensors")
    content = bytearray(weights.read_bytes())
    content[place] ^= 1
    weights.write_bytes(content)
    with pytest.raises(ValueError, match=r"is not the file that evidence\.json was written with"):
        load_evidence(tmp_path)


def test_weights_that_are_gone_are_reported(tmp_path):
    saved(tmp_path).with_suffix(".safetensors").unlink()
    with pytest.raises(FileNotFoundError, match=r"has lost its weights, evidence\.safetensors"):
        load_evidence(tmp_path)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "is no JSON file"),
        (b"\xff\xfe{}", "is no JSON file"),
        (b'{"format": "hmi-marl evidence 3"}', "is no evidence model .* 'hmi-marl evidence 3'"),
        (b'{"format": "hmi-marl policy 1"}', "is no evidence model .* 'hmi-marl policy 1'"),
        (b"[]", "format None"),
        (
            card_bytes({"format": "hmi-marl evidence 4"}),
            "is a damaged evidence model card: it lacks reads",
        ),
        (
            b'{"format": "hmi-marl evidence 4"}',
            "is a damaged evidence model card: it has no checksum; copy",
        ),
    ],
    ids=str,
)
def test_other_files_are_no_evidence_models(tmp_path, content, message):
    path = tmp_path / "evidence.json"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=message):
        load_evidence(path)


@pytest.mark.parametrize(
    "changed",
    [
        {"reads": 5},
        {"reads": [["speed"]]},
        {"reads": []},
        {"latent": 0},
        {"latent": "two"},
        {"encoder": None},
        {"features": 0},
        {"context": "eight"},
        {"reader": {"hidden_dims": [64], "depth": 2}},
        {"place": {"hidden_dims": [64], "rnn_hidden_dim": 3}},
        {"place": {"hidden_dims": [64], "activation": "__import__"}},
        {"weights_sha256": None},
    ],
    ids=str,
)
def test_a_damaged_card_is_reported(tmp_path, changed):
    with_card(saved(tmp_path), **changed)
    with pytest.raises(ValueError, match=r"evidence\.json is a damaged evidence model card: "):
        load_evidence(tmp_path)


def test_the_weights_of_another_model_are_refused(tmp_path):
    path = saved(tmp_path)
    content = save_tensors(evidence_weights(replace(CARD, latent=4)))
    with_weights(path, content)
    with pytest.raises(ValueError, match=r"evidence\.safetensors: reader\.layer1\.weight has sh"):
        load_evidence(tmp_path)
