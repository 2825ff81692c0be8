"""Runs in several processes learn the same, byte for byte, as in one."""

import json
import os
import subprocess
import sys
from dataclasses import replace

import pytest
import together

from hmi_marl.agents.learned.network import NetworkConfig
from hmi_marl.envs.config import AGENTS
from hmi_marl.training.ppo.run import train
from hmi_marl.training.protocols.fine_tune import FineTune
from hmi_marl.training.protocols.joint import Joint, Simultaneous
from hmi_marl.training.protocols.settings import PPOSettings
from hmi_marl.training.protocols.two_stage import TwoStage
from hmi_marl.training.runs.checkpoint import Checkpoint
from hmi_marl.training.runs.folder import read_curve
from hmi_marl.training.runs.start import start_together

TINY = {
    "num_teams": 8,  # 2 in each shard
    "shards": 4,
    "duration": 1.0,
    "vehicles": (1, 3),
    "network": NetworkConfig((8,)),
    "ppo": PPOSettings(num_learning_epochs=2, num_mini_batches=2),
    "device": "cpu",
    "checkpoint_every": 0.0,
}
PROTOCOLS = {
    "two-stage": TwoStage(driver_steps=80, hmi_steps=80, **TINY),
    "joint": Joint(steps=80, **TINY),
    "simultaneous": Simultaneous(steps=80, **TINY),
    "joint, recurrent": Joint(steps=80, ai_sees_attention=False, rnn_hidden_dim=4, **TINY),
    "anchored": Joint(steps=80, anchor="trained:driver", anchor_kl=0.5, **TINY),
    "fine-tune": FineTune(
        driver_steps=40,
        hmi_steps=40,
        together_steps=80,
        anchor="first-stage",
        anchor_kl=0.5,
        **TINY,
    ),
    "recurrent": TwoStage(
        driver_steps=40,
        hmi_steps=80,
        ai_sees_attention=False,
        rnn_hidden_dim=4,
        condition="hidden",
        critic="own",
        **TINY,
    ),
    "mixture": TwoStage(hmi_steps=80, driver_policy="mixture:trained:driver,rule,random", **TINY),
}
TIMED = {"seconds", "steps_per_second", "share_of_time_learning", "share_of_time_waiting"}


def learned(folder):
    """Everything learned: weights, optimizer's state, curve without times, and policies' files."""
    state = Checkpoint.load(folder / "checkpoint.safetensors")
    tensors = {
        f"{learner}/{name}": values.numpy().tobytes()
        for learner, named in state.tensors.items()
        for name, values in named.items()
    }
    assert any("optimizer" in name for name in tensors)
    curve = [{name: row[name] for name in row.keys() - TIMED} for row in state.curve]
    names = [f"{seat}.{suffix}" for seat in AGENTS for suffix in ("json", "safetensors")]
    files = {name: (folder / name) for name in names if (folder / name).is_file()}
    assert "vehicle_ai.safetensors" in files  # a driver that was mixed is not saved again
    return tensors, curve, {name: path.read_bytes() for name, path in files.items()}


@pytest.fixture(scope="module")
def alone(tmp_path_factory):
    """Folders of the runs that one process learned."""
    folder = tmp_path_factory.mktemp("alone")
    for name, settings in PROTOCOLS.items():
        train(settings, folder / name, quiet=True)
    return folder


@pytest.mark.parametrize("count", [2, pytest.param(4, marks=pytest.mark.slow)])
def test_processes_know_each_other_and_learn_the_same_whatever_their_number(count, alone, tmp_path):
    """Weights, optimizers and curves, after they spoke by memory and by torch."""
    tasks = [(settings, tmp_path / name) for name, settings in PROTOCOLS.items()]
    start_together(count, together.know_each_other_and_learn, tmp_path, tasks, threads=2)
    for name in PROTOCOLS:
        assert learned(tmp_path / name) == learned(alone / name), name
    curve = read_curve(tmp_path / "joint")
    assert all(0 < row["share_of_time_waiting"] < 1 for row in curve)
    known = [json.loads((tmp_path / f"{rank}.json").read_text()) for rank in range(count)]
    assert len({each["pid"] for each in known}) == count
    for rank, each in enumerate(known):
        assert each["threads"] == "2"
        for way in ("memory", "torch"):
            assert each[way] == {
                "place": [count, rank, rank],
                "first": rank == 0,
                "gathered": [[1.5 + other, 0.0 - other] for other in range(count)],
                "waited": True,
            }


@pytest.mark.slow
def test_a_killed_process_ends_the_run_which_goes_on_with_another_number(alone, tmp_path):
    settings, folder = PROTOCOLS["two-stage"], tmp_path / "run"
    with pytest.raises(ChildProcessError, match=r"process 0 .* ended by SIGKILL; the same command"):
        start_together(2, together.learn_until_killed, settings, folder, 3)
    state = Checkpoint.load(folder / "checkpoint.safetensors")
    assert (state.phase, state.iteration) == (1, 0)
    train(settings, folder, quiet=True)
    assert learned(folder) == learned(alone / "two-stage")


@pytest.mark.slow
def test_train_starts_processes_which_go_on_with_what_one_learned(alone, tmp_path, monkeypatch):
    settings, folder = PROTOCOLS["two-stage"], tmp_path / "run"
    save = Checkpoint.save

    def cut_off(self, path):
        save(self, path)
        if len(self.curve) == 1:
            raise InterruptedError

    monkeypatch.setattr(Checkpoint, "save", cut_off)
    with pytest.raises(InterruptedError):
        train(settings, folder, quiet=True)
    monkeypatch.undo()
    train(settings, folder, quiet=True, processes=2)
    assert learned(folder) == learned(alone / "two-stage")
    about = json.loads((folder / "run.json").read_text())
    assert "processes" not in about


def test_fewer_shards_are_other_weights(alone, tmp_path):
    settings = replace(PROTOCOLS["joint"], shards=2)
    train(settings, tmp_path, quiet=True)
    assert learned(tmp_path)[0] != learned(alone / "joint")[0]
    with pytest.raises(ValueError, match="shards = 4, now 2"):
        train(settings, alone / "joint", quiet=True)


@pytest.mark.slow
def test_torchrun_learns_the_same(alone, tmp_path):
    settings = ["--steps", "80", "--num-teams", "8", "--duration", "1", "--vehicles", "1", "3"]
    settings += ["--network.hidden-dims", "8", "--ppo.num-learning-epochs", "2"]
    settings += [
        "--shards",
        "4",
        "--ppo.num-mini-batches",
        "2",
        "--device",
        "cpu",
        "--checkpoint-every",
        "0",
    ]
    command = [sys.executable, "-m", "torch.distributed.run", "--nproc-per-node=2", "--standalone"]
    command += ["-m", "hmi_marl", "train", "joint", *settings, "--out", str(tmp_path / "run")]
    env = os.environ | {"OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        command, env=env, capture_output=True, text=True, check=False, timeout=240
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("learned: ") == 1
    assert learned(tmp_path / "run")[:2] == learned(alone / "joint")[:2]
