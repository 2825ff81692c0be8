import io
import json
import pickle
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from demonstrations import LAYOUT
from model_cards import card_bytes, with_card, with_weights
from safetensors.numpy import save as save_tensors
from trait_models import SMALL

from hmi_marl.agents.learned import cards as weight_files
from hmi_marl.agents.learned.network import NetworkConfig
from hmi_marl.agents.learned.trait_model import (
    FORMAT,
    TraitCard,
    TraitModel,
    load_traits,
    save_traits,
)

READS = tuple((part.name, part.size) for part in LAYOUT.parts)
CARD = TraitCard(
    READS,
    latent=3,
    encoder=SMALL,
    pool=5,
    gamma=0.9,
    reward=NetworkConfig((4, 3), "tanh"),
    potential=NetworkConfig((2,)),
    policy=NetworkConfig((5,)),
    training={"settings": {"supervision": "id", "held_out": 0.2}, "preferences": None},
)


def weights_for(card: TraitCard, seed: int = 0) -> dict[str, Any]:
    rng = np.random.default_rng(seed)
    return {n: rng.standard_normal(shape).astype(np.float32) for n, shape in card.shapes.items()}


def saved(folder: Path, card: TraitCard = CARD, seed: int = 0) -> Path:
    return save_traits(folder, card, weights_for(card, seed))


@pytest.mark.parametrize("card", [CARD, TraitCard((("speed", 1),))], ids=["all set", "defaults"])
def test_a_trait_model_comes_back_as_it_was(tmp_path: Path, card: TraitCard) -> None:
    path = saved(tmp_path / "run", card)
    assert path == tmp_path / "run" / "traits.json"
    for place in (tmp_path / "run", str(tmp_path / "run"), path):
        back = load_traits(place)
        assert back.card == card
        expected = weights_for(card)
        assert set(back.weights) == set(expected)
        for name, values in expected.items():
            assert back.weights[name].dtype == np.float32
            np.testing.assert_array_equal(back.weights[name], values)


def test_what_comes_back_does_the_same(tmp_path: Path) -> None:
    weights, back = weights_for(CARD), load_traits(saved(tmp_path))
    pooled = np.random.default_rng(1).uniform(1.0, 9.0, size=(6, 6))
    for one, other in zip(
        TraitModel(CARD, weights).encoder.latent(pooled),
        back.encoder.latent(pooled),
        strict=True,
    ):
        np.testing.assert_array_equal(one, other)


def test_the_same_model_makes_the_same_bytes(tmp_path: Path) -> None:
    saved(tmp_path / "one")
    weights = weights_for(CARD)
    save_traits(tmp_path / "two", CARD, dict(reversed(weights.items())))
    for name in ("traits.json", "traits.safetensors"):
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()


def test_weights_that_do_not_fit_are_not_written(tmp_path: Path) -> None:
    weights = weights_for(CARD)
    for change, message in (
        (
            {"encoder.step_layer.bias": np.full(4, np.nan, np.float32)},
            r"encoder\.step_layer\.bias is not finite everywhere",
        ),
        (
            {"encoder.step_layer.bias": np.zeros(2, np.float32)},
            r"encoder\.step_layer\.bias has shape \(2,\), but the card",
        ),
        ({"extra": np.zeros(2, np.float32)}, "do not fit the trait model's card: extra"),
    ):
        with pytest.raises(ValueError, match=message):
            save_traits(tmp_path, CARD, weights | change)
    assert list(tmp_path.iterdir()) == []


def test_a_model_that_is_not_there_is_reported(tmp_path: Path) -> None:
    for place in (tmp_path, tmp_path / "nowhere", tmp_path / "traits.json"):
        with pytest.raises(
            FileNotFoundError, match=r"no trait model at .*; learn one with hmi-marl"
        ):
            load_traits(place)


@pytest.mark.parametrize("place", [0, 9, 200, -1])
def test_a_changed_byte_is_noticed(tmp_path: Path, place: int) -> None:
    weights = saved(tmp_path).with_suffix(".safetensors")
    content = bytearray(weights.read_bytes())
    content[place] ^= 1
    weights.write_bytes(content)
    with pytest.raises(ValueError, match=r"is not the file that traits\.json was written with"):
        load_traits(tmp_path)


@pytest.mark.parametrize("kept", [0, 4, 100, -1])
def test_a_file_cut_short_is_noticed(tmp_path: Path, kept: int) -> None:
    path = saved(tmp_path)
    content = path.with_suffix(".safetensors").read_bytes()[:kept]
    path.with_suffix(".safetensors").write_bytes(content)
    with pytest.raises(ValueError, match="is not the file"):
        load_traits(tmp_path)
    with pytest.raises(ValueError, match=r"traits\.safetensors is no safetensors file"):
        load_traits(with_weights(path, content))


def test_weights_that_are_gone_are_reported(tmp_path: Path) -> None:
    saved(tmp_path).with_suffix(".safetensors").unlink()
    with pytest.raises(FileNotFoundError, match=r"has lost its weights, traits\.safetensors"):
        load_traits(tmp_path)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "is no JSON file"),
        (b"\xff\xfe{}", "is no JSON file"),
        (b'{"format": "hmi-marl traits 4"', "is no JSON file"),
        (b"[1, 2]", "is no trait model that can be read here: format None"),
        (b'{"format": "hmi-marl policy 1"}', "is no trait model .* 'hmi-marl policy 1'"),
        (b'{"format": "hmi-marl traits 2"}', "is no trait model .* 'hmi-marl traits 2'"),
        (
            card_bytes({"format": "hmi-marl traits 4"}),
            "is a damaged trait model card: it lacks reads",
        ),
        (
            b'{"format": "hmi-marl traits 4"}',
            "is a damaged trait model card: it has no checksum; copy",
        ),
    ],
    ids=str,
)
def test_other_files_are_no_trait_models(tmp_path: Path, content: bytes, message: str) -> None:
    (tmp_path / "traits.json").write_bytes(content)
    with pytest.raises(ValueError, match=rf"traits\.json {message}"):
        load_traits(tmp_path)


@pytest.mark.parametrize(
    "changed",
    [
        {"reads": 5},
        {"reads": []},
        {"reads": [["speed"]]},
        {"reads": [["speed", "wide"]]},
        {"reads": [["speed", 0]]},
        {"latent": 0},
        {"latent": None},
        {"latent": "two"},
        {"pool": 0},
        {"encoder": {"span": -1}},
        {"encoder": {"units": 5}},
        {"gamma": 1.5},
        {"policy": None},
        {"policy": {"hidden_dims": [64], "depth": 2}},
        {"reward": {"hidden": "64"}},
        {"potential": {"hidden_dims": [64], "activation": "__import__"}},
        {"policy": {"hidden_dims": [64], "rnn_hidden_dim": 3}},
    ],
    ids=str,
)
def test_a_damaged_card_is_reported(tmp_path: Path, changed: dict[str, Any]) -> None:
    path = with_card(saved(tmp_path), **changed)
    with pytest.raises(ValueError, match=r"traits\.json is a damaged trait model card: "):
        load_traits(path)


def test_the_weights_of_another_model_are_refused(tmp_path: Path) -> None:
    path = saved(tmp_path)
    for other, message in (
        (
            replace(CARD, latent=2),
            r"head\.layer1\.weight has shape \(4, 4\), but the card says \(6, 4\)",
        ),
        (replace(CARD, policy=NetworkConfig((5, 5))), r"trait model's card: policy\.layer2\."),
    ):
        with_weights(path, save_tensors(weights_for(other)))
        with pytest.raises(ValueError, match=rf"traits\.safetensors: .*{message}"):
            load_traits(path)


def test_weights_missing_or_not_finite_are_refused(tmp_path: Path) -> None:
    path, weights = saved(tmp_path), weights_for(CARD)
    with_weights(
        path, save_tensors(weights | {"encoder.step_layer.bias": np.full(4, np.inf, np.float32)})
    )
    with pytest.raises(ValueError, match=r"encoder\.step_layer\.bias is not finite everywhere"):
        load_traits(path)
    del weights["encoder.span_layer.bias"]
    with_weights(path, save_tensors(weights))
    with pytest.raises(ValueError, match=r"trait model's card: encoder\.span_layer\.bias"):
        load_traits(path)


class Burglar:
    """Says so if it is ever unpickled."""

    opened = False

    def __reduce__(self) -> Any:
        return setattr, (Burglar, "opened", True)


def zipped_pickle() -> bytes:
    """As torch.save lays it out."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        archive.writestr("archive/data.pkl", pickle.dumps(Burglar()))
    return stream.getvalue()


@pytest.mark.parametrize("content", [pickle.dumps(Burglar()), zipped_pickle()], ids=["pkl", "pt"])
def test_nothing_is_ever_unpickled(tmp_path: Path, content: bytes) -> None:
    path = with_weights(saved(tmp_path), content)
    with pytest.raises(ValueError, match="is no safetensors file"):
        load_traits(path)
    path.write_bytes(content)
    with pytest.raises(ValueError, match="is no JSON file"):
        load_traits(path)
    assert not Burglar.opened
    pickle.loads(pickle.dumps(Burglar()))
    assert Burglar.opened  # it would have been noticed
    Burglar.opened = False


def test_a_kill_between_the_two_files_is_noticed_and_mended_by_the_next_write(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    saved(tmp_path)
    with monkeypatch.context() as patched:

        def killed(path: Path, content: Any) -> None:
            raise KeyboardInterrupt

        patched.setattr(weight_files, "write_json", killed)
        with pytest.raises(KeyboardInterrupt):
            saved(tmp_path, seed=1)
    with pytest.raises(ValueError, match="is not the file that"):
        load_traits(tmp_path)
    saved(tmp_path, seed=1)
    expected = weights_for(CARD, 1)["encoder.step_layer.bias"]
    np.testing.assert_array_equal(
        load_traits(tmp_path).weights["encoder.step_layer.bias"], expected
    )


def test_the_card_holds_its_format_and_how_it_was_made(tmp_path: Path) -> None:
    content = json.loads(saved(tmp_path).read_text("utf-8"))
    assert content["format"] == FORMAT.name
    assert content["training"] == CARD.training
