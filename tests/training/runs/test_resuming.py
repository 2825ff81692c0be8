"""A run takes no state but its own; test_checkpoint.py tests the file."""

import json
import shutil
from dataclasses import dataclass
from pathlib import Path

import pytest
import torch

from hmi_marl.training.runs.checkpoint import Checkpoint
from hmi_marl.training.runs.folder import CHECKPOINT, SETTINGS
from hmi_marl.training.runs.run import Run


@dataclass(frozen=True)
class Settings:
    seed: int = 0
    checkpoint_every: float = 0.0


class Counts(Run):
    """Learns to count to four, and may be cut off on the way."""

    phases = 1

    def __init__(self, folder: Path, seed: int = 0, until: int = 4) -> None:
        super().__init__(Settings(seed), folder, {"protocol": "counts"}, quiet=True)
        self.count_of, self.until = torch.zeros(1), until

    def learn(self) -> None:
        while self.state.iteration < 4:
            if self.state.iteration == self.until:
                return
            self.count_of += 1 + self._seed
            self.state.iteration += 1
            self.save()
        self.finish_phase()

    def tensors(self):
        return {"counter": {"count": self.count_of}}

    def save_lost(self):
        pass

    def restore(self, tensors):
        self.count_of = tensors["counter"]["count"]


def counted(folder: Path, **settings: int) -> float:
    run = Counts(folder, **settings)
    run.go()
    return float(run.count_of)


def test_a_run_goes_on_where_it_was(tmp_path):
    assert counted(tmp_path, until=2) == 2
    assert counted(tmp_path) == 4
    assert counted(tmp_path) == 4  # it is finished


def test_the_checkpoint_of_another_seed_beside_its_settings_is_refused(tmp_path):
    counted(tmp_path / "one", until=2)
    counted(tmp_path / "other", seed=1, until=3)
    shutil.copy(tmp_path / "other" / CHECKPOINT, tmp_path / "one" / CHECKPOINT)
    with pytest.raises(ValueError, match=r"one/checkpoint\.safetensors is the checkpoint of a run"):
        counted(tmp_path / "one")


def test_a_phase_that_there_is_not_does_not_mean_learned(tmp_path):
    counted(tmp_path, until=2)
    state = Checkpoint.load(tmp_path / CHECKPOINT, Counts(tmp_path).state.settings)
    state.phase = 99
    state.save(tmp_path / CHECKPOINT)
    with pytest.raises(ValueError, match=r"checkpoint\.safetensors is a damaged .* phase 99 of 1"):
        counted(tmp_path)


def test_the_state_of_other_learners_is_refused(tmp_path):
    counted(tmp_path, until=2)
    state = Checkpoint.load(tmp_path / CHECKPOINT, Counts(tmp_path).state.settings)
    state.tensors = {"speller": state.tensors["counter"]}
    state.save(tmp_path / CHECKPOINT)
    with pytest.raises(ValueError, match=r"safetensors is a damaged .* does not fit .*'counter'"):
        counted(tmp_path)


def test_settings_of_the_machine_may_differ(tmp_path):
    counted(tmp_path, until=2)
    about = json.loads((tmp_path / SETTINGS).read_text())
    about["settings"]["checkpoint_every"] = 60.0
    (tmp_path / SETTINGS).write_text(json.dumps(about))
    assert counted(tmp_path) == 4


def test_any_flipped_bit_stops_the_run(tmp_path):
    counted(tmp_path, until=2)
    content = (tmp_path / CHECKPOINT).read_bytes()
    for at in range(0, len(content), 23):
        changed = bytearray(content)
        changed[at] ^= 0x04
        (tmp_path / CHECKPOINT).write_bytes(changed)
        with pytest.raises(ValueError, match=r"checkpoint\.safetensors is"):
            counted(tmp_path)
