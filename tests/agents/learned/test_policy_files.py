import io
import json
import pickle
import zipfile
from dataclasses import replace

import numpy as np
import pytest
from model_cards import card_bytes, with_card, with_weights
from safetensors.numpy import save as save_tensors

from hmi_marl.agents.catalogue import make_driver_policy, make_hmi
from hmi_marl.agents.learned import cards as weight_files
from hmi_marl.agents.learned.network import NetworkConfig
from hmi_marl.agents.learned.policy import (
    PolicyCard,
    find_policy,
    load_policy,
    make_card,
    read_policy,
    save_policy,
)
from hmi_marl.envs.config import TeamConfig
from hmi_marl.files import without_checksum

CONFIG = TeamConfig()
CARD = make_card(
    "vehicle_ai", CONFIG, NetworkConfig((4, 3), "tanh", rnn_hidden_dim=2), True, context=2
)


def weights_for(card, seed=0):
    rng = np.random.default_rng(seed)
    return {n: rng.standard_normal(shape).astype(np.float32) for n, shape in card.shapes.items()}


def saved(folder, card=CARD, seed=0):
    return save_policy(folder, card, weights_for(card, seed))


class Burglar:
    """Says so if it is ever unpickled."""

    opened = False

    def __reduce__(self):
        return setattr, (Burglar, "opened", True)


@pytest.mark.parametrize(
    "card",
    [
        CARD,
        make_card("driver", CONFIG, NetworkConfig(), knows_traits=False),
        make_card("vehicle_ai", CONFIG, NetworkConfig(), True, by_intent=True, sequential=False),
        replace(CARD, training={"seed": 3, "settings": {"drivers": ["bart"], "memory": None}}),
    ],
    ids=["memory and context", "driver", "by intent", "training"],
)
def test_a_policy_comes_back_as_it_was(tmp_path, card):
    path = saved(tmp_path, card)
    assert path == tmp_path / f"{card.seat}.json"
    back, weights = read_policy(path)
    assert back == card
    expected = weights_for(card)
    assert set(weights) == set(expected)
    for name, values in expected.items():
        assert weights[name].dtype == np.float32
        np.testing.assert_array_equal(weights[name], values)


def test_the_same_policy_makes_the_same_bytes(tmp_path):
    for folder in ("one", "two"):
        saved(tmp_path / folder)
    for name in ("vehicle_ai.json", "vehicle_ai.safetensors"):
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()


def test_weights_that_do_not_fit_are_not_written(tmp_path):
    weights = weights_for(CARD) | {"layer0.bias": np.full(4, np.nan, np.float32)}
    with pytest.raises(ValueError, match=r"layer0\.bias is not finite everywhere"):
        save_policy(tmp_path, CARD, weights)
    assert list(tmp_path.iterdir()) == []


def test_a_policy_is_found_by_folder_card_or_weights(tmp_path):
    path = saved(tmp_path)
    for place in (tmp_path, path, path.with_suffix(".safetensors")):
        assert find_policy(place, "vehicle_ai") == path


def test_a_policy_that_is_not_there_is_reported_with_what_is(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"no policy for the seat of driver at .*[^v]$"):
        find_policy(tmp_path, "driver")
    with pytest.raises(FileNotFoundError, match=r"no policy for the seat of driver at .*nowhere"):
        load_policy(tmp_path / "nowhere", "driver", CONFIG)
    saved(tmp_path)
    with pytest.raises(
        FileNotFoundError, match=r"seat of driver at .*; it holds one for vehicle_ai"
    ):
        find_policy(tmp_path, "driver")


def test_names_of_the_catalogue_lead_here(tmp_path):
    cards = {
        seat: make_card(seat, CONFIG, NetworkConfig((3,)), True)
        for seat in ("driver", "vehicle_ai")
    }
    for card in cards.values():
        saved(tmp_path, card)
    assert make_hmi(str(tmp_path), CONFIG).card == cards["vehicle_ai"]
    assert make_driver_policy(str(tmp_path), CONFIG).card == cards["driver"]
    assert make_driver_policy(str(tmp_path / "driver.json"), CONFIG).greedy
    with pytest.raises(ValueError, match=r"driver\.json is a policy for the seat of driver, not o"):
        make_hmi(str(tmp_path / "driver.json"), CONFIG)
    with pytest.raises(FileNotFoundError, match="no policy for the seat of vehicle_ai"):
        make_hmi("runs/that/never/were", CONFIG)


def test_a_policy_that_cannot_sit_there_is_reported_with_its_file(tmp_path):
    path = saved(tmp_path)
    blind = TeamConfig(ai_sees_attention=False)
    with pytest.raises(ValueError, match=r"vehicle_ai\.json: this vehicle_ai policy reads 'distr"):
        load_policy(path, "vehicle_ai", blind)


@pytest.mark.parametrize("place", [0, 9, 200, -1])
def test_a_changed_byte_is_noticed(tmp_path, place):
    path = saved(tmp_path)
    weights = path.with_suffix(".safetensors")
    content = bytearray(weights.read_bytes())
    content[place] ^= 1
    weights.write_bytes(content)
    with pytest.raises(ValueError, match=r"is not the file that vehicle_ai\.json was written with"):
        read_policy(path)


@pytest.mark.parametrize("kept", [0, 4, 100, -1])
def test_a_file_cut_short_is_noticed(tmp_path, kept):
    path = saved(tmp_path)
    content = path.with_suffix(".safetensors").read_bytes()[:kept]
    path.with_suffix(".safetensors").write_bytes(content)
    with pytest.raises(ValueError, match="is not the file"):
        read_policy(path)
    with pytest.raises(ValueError, match=r"vehicle_ai\.safetensors is no safetensors file"):
        read_policy(with_weights(path, content))


def test_weights_that_are_gone_are_reported(tmp_path):
    path = saved(tmp_path)
    path.with_suffix(".safetensors").unlink()
    with pytest.raises(FileNotFoundError, match=r"has lost its weights, vehicle_ai\.safetensors"):
        read_policy(path)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "is no JSON file"),
        (b"\xff\xfe{}", "is no JSON file"),
        (b'{"format": "hmi-marl policy 3"', "is no JSON file"),
        (b"[1, 2]", "is no policy that can be read here: format None"),
        (b'{"format": "hmi-marl policy 2"}', "is no policy .* format 'hmi-marl policy 2'"),
        (b'{"layers": 3}', "is no policy that can be read here: format None"),
        (card_bytes({"format": "hmi-marl policy 3"}), "is a damaged policy card: it lacks seat"),
        (b'{"format": "hmi-marl policy 3"}', "is a damaged policy card: it has no checksum; copy"),
    ],
    ids=str,
)
def test_other_files_are_no_policies(tmp_path, content, message):
    path = tmp_path / "driver.json"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=rf"driver\.json {message}"):
        load_policy(path, "driver", CONFIG)


@pytest.mark.parametrize(
    "changed",
    [
        {"seat": "passenger"},
        {"seat": None},
        {"reads": 5},
        {"reads": [["speed"]]},
        {"reads": []},
        {"reads": [["speed", "wide"]]},
        {"network": None},
        {"network": {"hidden_dims": [64], "depth": 2}},
        {"network": {"hidden": "64"}},
        {"network": {"hidden_dims": [64], "activation": "__import__"}},
        {"context": "two"},
        {"context": -2},
        {"by_intent": True},  # it reads intended_action
    ],
    ids=str,
)
def test_a_damaged_card_is_reported(tmp_path, changed):
    path = with_card(saved(tmp_path), **changed)
    with pytest.raises(ValueError, match=r"vehicle_ai\.json is a damaged policy card: "):
        read_policy(path)


def test_the_weights_of_another_policy_are_refused(tmp_path):
    card = PolicyCard("driver", (("speed", 1),), NetworkConfig((3,)))
    path = saved(tmp_path, card)
    for other, message in (
        (replace(card, reads=(("traits", 4),)), r"layer0\.weight has shape \(3, 4\), but"),
        (replace(card, network=NetworkConfig((3, 3))), r"do not fit the policy's card: layer2\."),
    ):
        with_weights(path, save_tensors(weights_for(other)))
        with pytest.raises(ValueError, match=rf"driver\.safetensors: .*{message}"):
            read_policy(path)


def test_weights_missing_or_not_finite_are_refused(tmp_path):
    path, weights = saved(tmp_path), weights_for(CARD)
    with_weights(path, save_tensors(weights | {"layer0.bias": np.full(4, np.nan, np.float32)}))
    with pytest.raises(ValueError, match=r"layer0\.bias is not finite everywhere"):
        read_policy(path)
    del weights["memory.hidden_bias"]
    with_weights(path, save_tensors(weights))
    with pytest.raises(ValueError, match=r"policy's card: memory\.hidden_bias"):
        read_policy(path)
    with_weights(path, save_tensors({"embedding": np.zeros((3, 3), np.float32)}))
    with pytest.raises(ValueError, match="do not fit the policy's card: embedding, layer0"):
        read_policy(path)


def test_weights_of_a_type_that_numpy_does_not_know_are_refused(tmp_path):
    header = {"layer0.bias": {"dtype": "BF16", "shape": [4], "data_offsets": [0, 8]}}
    head = json.dumps(header).encode()
    path = with_weights(saved(tmp_path), len(head).to_bytes(8, "little") + head + bytes(8))
    with pytest.raises(ValueError, match=r"is no safetensors file: 'BF16'"):
        read_policy(path)


def zipped_pickle():
    """As torch.save lays it out."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        archive.writestr("archive/data.pkl", pickle.dumps(Burglar()))
    return stream.getvalue()


@pytest.mark.parametrize("content", [pickle.dumps(Burglar()), zipped_pickle()], ids=["pkl", "pt"])
def test_nothing_is_ever_unpickled(tmp_path, content):
    path = with_weights(saved(tmp_path), content)
    with pytest.raises(ValueError, match="is no safetensors file"):
        read_policy(path)
    path.write_bytes(content)
    with pytest.raises(ValueError, match="is no JSON file"):
        read_policy(path)
    assert not Burglar.opened
    pickle.loads(pickle.dumps(Burglar()))
    assert Burglar.opened  # it would have been noticed
    Burglar.opened = False


def test_a_write_that_fails_leaves_the_old_policy(tmp_path, monkeypatch):
    path = saved(tmp_path)

    def fail(path, content):
        raise OSError("no space left")

    monkeypatch.setattr(weight_files, "write_bytes", fail)
    with pytest.raises(OSError, match="no space left"):
        saved(tmp_path, seed=1)
    _, weights = read_policy(path)
    np.testing.assert_array_equal(weights["layer0.bias"], weights_for(CARD)["layer0.bias"])
    assert {file.name for file in tmp_path.iterdir()} == {
        "vehicle_ai.json",
        "vehicle_ai.safetensors",
    }


def test_a_kill_between_the_two_files_is_noticed_and_mended_by_the_next_write(
    tmp_path, monkeypatch
):
    path = saved(tmp_path)
    with monkeypatch.context() as patched:

        def killed(path, content):
            raise KeyboardInterrupt

        patched.setattr(weight_files, "write_json", killed)
        with pytest.raises(KeyboardInterrupt):
            saved(tmp_path, seed=1)
    with pytest.raises(ValueError, match="is not the file that"):
        read_policy(path)
    saved(tmp_path, seed=1)
    _, weights = read_policy(path)
    np.testing.assert_array_equal(weights["layer0.bias"], weights_for(CARD, 1)["layer0.bias"])


def test_a_card_without_alert_strengths_is_refused(tmp_path):
    path = saved(tmp_path)
    content = without_checksum(json.loads(path.read_text("utf-8")))
    assert content.pop("alert_strengths") == [1.0]
    path.write_bytes(card_bytes(content))
    with pytest.raises(ValueError, match="is a damaged policy card: it lacks alert_strengths"):
        read_policy(path)


def test_a_card_holds_the_strengths_of_its_alerts(tmp_path):
    config = TeamConfig(alert_strengths=(0.25, 0.5, 1.0))
    card = make_card("vehicle_ai", config, NetworkConfig((4,)), True)
    assert read_policy(saved(tmp_path, card))[0] == card
    assert load_policy(tmp_path, "vehicle_ai", config).card.actions == 4
    with pytest.raises(ValueError, match=r"vehicle_ai\.json: .*alerts of strengths \(0\.25, 0\.5,"):
        load_policy(tmp_path, "vehicle_ai", CONFIG)
    with pytest.raises(ValueError, match="damaged policy card: alert_strengths rise"):
        read_policy(with_card(tmp_path / "vehicle_ai.json", alert_strengths=[1.0, 0.5]))
