import hashlib
import json

import numpy as np
import pytest
import torch
from safetensors.torch import save

from hmi_marl.training.runs import checkpoint
from hmi_marl.training.runs.checkpoint import FORMAT, Checkpoint

ROWS = [{"phase": "driver", "steps": 80, "return": 0.1 + 0.2}]


def some():
    return Checkpoint(
        phase=1,
        iteration=3,
        steps=2**39,
        seconds=1.5,
        tensors={
            "driver": {"actor.mlp.0.weight": torch.randn(3, 2), "optimizer.0.step": torch.ones(())},
            "team": {"critic.mlp.0.bias": torch.full((2,), torch.nan)},
        },
        curve=ROWS,
    )


def header(path, content):
    path.write_bytes(save({"driver/x": torch.zeros(1)}, {"hmi_marl": json.dumps(content)}))
    return path


def test_everything_comes_back_to_the_bit(tmp_path):
    path, before = tmp_path / "checkpoint.safetensors", some()
    before.save(path)
    after = Checkpoint.load(path)
    for name in ("phase", "iteration", "steps", "seconds", "curve"):
        assert getattr(after, name) == getattr(before, name)
    assert set(after.tensors) == set(before.tensors)
    for learner, tensors in before.tensors.items():
        assert set(after.tensors[learner]) == set(tensors)
        for name, values in tensors.items():
            np.testing.assert_array_equal(after.tensors[learner][name].numpy(), values.numpy())


def test_a_run_that_has_not_begun_can_be_kept_too(tmp_path):
    Checkpoint().save(tmp_path / "checkpoint.safetensors")
    assert Checkpoint.load(tmp_path / "checkpoint.safetensors") == Checkpoint()


def test_views_into_larger_tensors_and_learned_ones_can_be_kept(tmp_path):
    path, wide = tmp_path / "checkpoint.safetensors", torch.arange(6.0).reshape(2, 3)
    tensors = {"driver": {"x": wide.T, "y": wide[:, 1], "z": torch.nn.Parameter(wide)}}
    Checkpoint(tensors=tensors).save(path)
    back = Checkpoint.load(path).tensors["driver"]
    assert torch.equal(back["x"], wide.T)
    assert torch.equal(back["y"], wide[:, 1])
    assert torch.equal(back["z"], wide)


@pytest.mark.parametrize("kept", [0, 5, 60, -1])
def test_a_file_cut_short_is_damaged(tmp_path, kept):
    path = tmp_path / "checkpoint.safetensors"
    some().save(path)
    path.write_bytes(path.read_bytes()[:kept])
    with pytest.raises(ValueError, match=r"checkpoint\.safetensors is a damaged checkpoint: "):
        Checkpoint.load(path)


def test_a_pickle_is_not_opened(tmp_path):
    path = tmp_path / "checkpoint.safetensors"
    torch.save({"phase": 1}, path)
    with pytest.raises(ValueError, match="is a damaged checkpoint"):
        Checkpoint.load(path)


@pytest.mark.parametrize(
    "content",
    [{}, {"format": "hmi-marl checkpoint 0"}, {"format": "hmi-marl policy 2"}, [FORMAT], 3],
    ids=str,
)
def test_files_of_others_are_told(tmp_path, content):
    with pytest.raises(ValueError, match="is not a checkpoint that can be read here"):
        Checkpoint.load(header(tmp_path / "checkpoint.safetensors", content))


def test_weights_without_a_header_are_no_checkpoint(tmp_path):
    path = tmp_path / "checkpoint.safetensors"
    path.write_bytes(save({"weight": torch.zeros(3)}))
    with pytest.raises(ValueError, match="is not a checkpoint that can be read here"):
        Checkpoint.load(path)


WHOLE = {
    "format": FORMAT,
    "sha256": "0" * 64,
    "settings": "",
    "phase": 0,
    "iteration": 0,
    "steps": 0,
    "seconds": 0.0,
    "curve": [],
}


def signed(path, content):
    """A checkpoint with any header, and the right checksum."""
    raw = header(path, content).read_bytes()
    at = raw.index(b"0" * 64)
    digest = hashlib.sha256(raw).hexdigest().encode()
    path.write_bytes(raw[:at] + digest + raw[at + 64 :])
    return path


def test_a_header_of_right_fields_is_taken(tmp_path):
    state = Checkpoint.load(signed(tmp_path / "checkpoint.safetensors", WHOLE))
    assert state.tensors == {"driver": {"x": torch.zeros(1)}}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"mood": "good"}, r"unknown fields: \['mood'\]"),
        ({"phase": -1}, "phase lies in 0 to 1000000, but got -1"),
        ({"phase": 1.0}, "phase is a whole number, not 1.0"),
        ({"iteration": True}, "iteration is a whole number, not True"),
        ({"steps": "many"}, "steps is a whole number, not 'many'"),
        ({"steps": 10**30}, "a whole number of more than 20 digits"),
        ({"seconds": -0.5}, "seconds lies in .0, 1e.09., but got -0.5"),
        ({"seconds": float("inf")}, "Infinity is no number in JSON"),
        ({"curve": {}}, "curve is a list, not {}"),
        ({"curve": [3]}, r"curve\[0\] is a mapping, not 3"),
        (
            {"curve": [{"loss": [1]}]},
            r"curve\[0\].loss is a whole number or .* null, not",
        ),
        ({"settings": None}, "settings is a text, not None"),
    ],
    ids=str,
)
def test_a_header_is_typed_and_ranged(tmp_path, change, message):
    path = signed(tmp_path / "checkpoint.safetensors", WHOLE | change)
    with pytest.raises(ValueError, match=f"is a damaged checkpoint: .*{message}"):
        Checkpoint.load(path)


def test_a_header_that_is_damaged_is_told(tmp_path):
    path = tmp_path / "checkpoint.safetensors"
    with pytest.raises(ValueError, match="is a damaged checkpoint: it lacks sha256, settings"):
        Checkpoint.load(header(path, {"format": FORMAT}))
    path.write_bytes(save({"driver/x": torch.zeros(1)}, {"hmi_marl": "{"}))
    with pytest.raises(ValueError, match="is a damaged checkpoint: Expecting"):
        Checkpoint.load(path)


def test_any_changed_bit_is_found(tmp_path):
    path = tmp_path / "checkpoint.safetensors"
    some().save(path)
    content = path.read_bytes()
    for at in range(len(content)):
        changed = bytearray(content)
        changed[at] ^= 1 << at % 8
        path.write_bytes(changed)
        with pytest.raises(ValueError, match=r"checkpoint\.safetensors is (a damaged|not a) check"):
            Checkpoint.load(path)


def test_the_checkpoint_of_another_run_is_refused(tmp_path):
    path = tmp_path / "checkpoint.safetensors"
    Checkpoint(settings="a" * 64, phase=2).save(path)
    assert Checkpoint.load(path, "a" * 64, 2).phase == 2
    with pytest.raises(ValueError, match=r"safetensors is the checkpoint of a run with other set"):
        Checkpoint.load(path, "b" * 64, 2)
    with pytest.raises(ValueError, match=r"is a damaged checkpoint: phase 2 of 1; remove its fol"):
        Checkpoint.load(path, "a" * 64, 1)


def test_numbers_that_json_does_not_have_are_not_written(tmp_path):
    path = tmp_path / "checkpoint.safetensors"
    with pytest.raises(ValueError, match="JSON compliant"):
        Checkpoint(curve=[{"loss": float("nan")}]).save(path)
    assert not path.exists()


def test_a_write_that_fails_leaves_the_old_one(tmp_path, monkeypatch):
    path = tmp_path / "checkpoint.safetensors"
    some().save(path)

    def fail(path, content):
        raise OSError("no space left")

    monkeypatch.setattr(checkpoint, "write_bytes", fail)
    with pytest.raises(OSError, match="no space left"):
        Checkpoint().save(path)
    assert Checkpoint.load(path).iteration == 3
