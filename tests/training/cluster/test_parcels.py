import os

import pytest

from hmi_marl.training.cluster.parcels import Changes, put, read_by_others, state_in
from hmi_marl.training.runs.folder import CHECKPOINT


def test_the_state_of_a_run_is_its_own_files_without_locks_and_folders(tmp_path):
    (tmp_path / "tensorboard").mkdir()
    for name in ("run.json", CHECKPOINT, ".owner", ".curve-1.part.json", "tensorboard/events"):
        (tmp_path / name).write_text(name)
    assert state_in(tmp_path) == {each: each.encode() for each in (CHECKPOINT, "run.json")}
    assert state_in(tmp_path / "nowhere") == {}


def test_others_get_a_folder_without_its_checkpoint_or_a_policy_with_its_weights(tmp_path):
    folder = tmp_path / "driver"
    folder.mkdir()
    for name in ("driver.json", "driver.safetensors", "vehicle_ai.json", CHECKPOINT):
        (folder / name).write_text(name)
    assert set(read_by_others(folder)) == {
        "driver/driver.json",
        "driver/driver.safetensors",
        "driver/vehicle_ai.json",
    }
    assert set(read_by_others(folder / "driver.json")) == {"driver.json", "driver.safetensors"}


def test_only_what_changed_is_taken(tmp_path):
    put(tmp_path, {"run.json": b"1", "curve.json": b"1"})
    changes = Changes(tmp_path, {"run.json": b"", "curve.json": b""})
    assert changes.take() == {}
    put(tmp_path, {"curve.json": b"2", "snapshots/10/driver.json": b"3"})
    assert changes.take() == {"curve.json": b"2", "snapshots/10/driver.json": b"3"}
    assert changes.take() == {}


def test_the_checkpoint_is_written_last(tmp_path, monkeypatch):
    written = []
    monkeypatch.setattr(
        "hmi_marl.training.cluster.parcels.write_bytes", lambda path, _: written.append(path.name)
    )
    put(tmp_path, dict.fromkeys((CHECKPOINT, "vehicle_ai.json", "run.json"), b""))
    assert written == ["run.json", "vehicle_ai.json", CHECKPOINT]


@pytest.mark.parametrize("name", ["../other", "/etc/x", "a/../../b", "", "a\\b"])
def test_no_file_leaves_the_folder(tmp_path, name):
    with pytest.raises(ValueError, match="no path within"):
        put(tmp_path / "run", {name: b""})
    assert not os.listdir(tmp_path)
