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
        steps=2**40,
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


def test_a_header_that_is_damaged_is_told(tmp_path):
    path = header(tmp_path / "checkpoint.safetensors", {"format": FORMAT, "mood": "good"})
    with pytest.raises(ValueError, match=r"is a damaged checkpoint: .*mood"):
        Checkpoint.load(path)
    path.write_bytes(save({"driver/x": torch.zeros(1)}, {"hmi_marl": "{"}))
    with pytest.raises(ValueError, match="is a damaged checkpoint: Expecting"):
        Checkpoint.load(path)


def test_a_write_that_fails_leaves_the_old_one(tmp_path, monkeypatch):
    path = tmp_path / "checkpoint.safetensors"
    some().save(path)

    def fail(path, content):
        raise OSError("no space left")

    monkeypatch.setattr(checkpoint, "write_bytes", fail)
    with pytest.raises(OSError, match="no space left"):
        Checkpoint().save(path)
    assert Checkpoint.load(path).iteration == 3
