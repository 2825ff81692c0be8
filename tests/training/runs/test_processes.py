import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from hmi_marl.agents.learned.policy import read_policy
from hmi_marl.training.ppo.run import train
from hmi_marl.training.protocols.joint import Simultaneous
from hmi_marl.training.protocols.settings import PPOSettings
from hmi_marl.training.runs.processes import Processes, joined
from hmi_marl.training.runs.run import Checkpoint

SETTINGS = Simultaneous(
    steps=160,
    num_teams=4,  # in each of two processes: 40 steps a batch
    duration=1.0,
    vehicles=(1, 2),
    rnn_hidden_dim=3,
    ppo=PPOSettings(num_learning_epochs=1, num_mini_batches=2),
    device="cpu",
    threads=1,
    checkpoint_every=0.0,
)
SCRIPT = """
import hashlib, json, sys
from pathlib import Path
import torch
from hmi_marl.training.ppo import run
from hmi_marl.training.runs.processes import joined
from test_processes import SETTINGS

torch.set_num_threads(1)
seeds, learners = [], []

class Kept(run.PPOLearner):
    def __init__(self, *args):
        super().__init__(*args)
        learners.append(self)

def play_batch(env, learner, seed, play=run.play_batch):
    seeds.append(seed)
    return play(env, learner, seed)

run.PPOLearner, run.play_batch = Kept, play_batch
folder = Path(sys.argv[1])
for _ in range(2):  # one after the other; the second time the run is there already
    run.train(SETTINGS, folder / "run", quiet=True)
digest = hashlib.sha256()
for learner in learners:
    for name, values in sorted(learner.tensors().items()):
        digest.update(values.numpy().tobytes())
with joined() as processes:
    told = {
        "count": processes.count,
        "rank": processes.rank,
        "first": processes.is_first,
        "rsl_rl": processes.as_rsl_rl(),
        "mean": processes.mean({"a": 1.0 + processes.rank, "b": -3.0}),
        "seeds": seeds,
        "learned": digest.hexdigest(),
    }
    processes.wait()
(folder / f"{told['rank']}.json").write_text(json.dumps(told))
"""


def test_one_process_is_alone(monkeypatch):
    monkeypatch.delenv("WORLD_SIZE", raising=False)
    with joined() as processes:
        assert processes == Processes(1, 0, 0)
        assert processes.is_first
        assert processes.as_rsl_rl() is None
        assert processes.mean({"a": 2.0}) == {"a": 2.0}
        processes.wait()
    assert not torch.distributed.is_initialized()


def test_who_is_first_and_how_rsl_rl_is_told():
    second = Processes(count=4, rank=2, local_rank=1)
    assert not second.is_first
    assert second.as_rsl_rl() == {"global_rank": 2, "local_rank": 1, "world_size": 4}


def test_devices():
    assert Processes().device("cpu") == "cpu"
    with pytest.raises(ValueError, match="no device 'quantum': "):
        Processes().device("quantum")


def test_without_a_gpu_auto_is_the_cpu(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert Processes().device("auto") == "cpu"
    with pytest.raises(ValueError, match="device 'cuda:1' was asked for, but torch sees no GPU"):
        Processes().device("cuda:1")


def test_with_gpus_auto_is_the_processs_own(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch, "empty", lambda *size, device: None)
    assert Processes(count=4, rank=3, local_rank=1).device("auto") == "cuda:1"


@pytest.fixture(scope="module")
def two(tmp_path_factory):
    """The folder of a run that two processes learned together, and what each of them told."""
    folder = tmp_path_factory.mktemp("two")
    script = folder / "script.py"
    script.write_text(SCRIPT)
    command = [sys.executable, "-m", "torch.distributed.run", "--nproc-per-node=2", "--standalone"]
    path = os.pathsep.join([str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")])
    env = os.environ | {"PYTHONPATH": path, "OMP_NUM_THREADS": "1"}
    command += [str(script), str(folder)]
    done = subprocess.run(
        command, env=env, capture_output=True, text=True, check=False, timeout=240
    )
    assert done.returncode == 0, done.stderr
    return folder, [json.loads((folder / f"{rank}.json").read_text()) for rank in range(2)]


def test_two_processes_know_each_other_and_mean_is_over_both(two):
    _, (one, other) = two
    assert [told["rank"] for told in (one, other)] == [0, 1]
    assert [told["first"] for told in (one, other)] == [True, False]
    for told in (one, other):
        assert told["count"] == 2
        assert told["rsl_rl"]["world_size"] == 2
        assert told["mean"] == {"a": 1.5, "b": -3.0}


def test_two_processes_play_other_episodes_and_learn_the_same(two):
    _, (one, other) = two
    assert one["learned"] == other["learned"]
    assert len(one["seeds"]) == 4  # 160 steps, 40 a batch
    assert len({*one["seeds"], *other["seeds"]}) == 8


def test_two_processes_leave_one_run(two):
    folder = two[0] / "run"
    state = Checkpoint.load(folder / "checkpoint.safetensors")
    assert (state.phase, state.steps) == (1, 160)
    assert [row["steps"] for row in state.curve] == [40, 80, 120, 160]
    for row in state.curve:
        assert np.isfinite([v for v in row.values() if not isinstance(v, str)]).all()
    for seat in ("driver", "vehicle_ai"):
        card, weights = read_policy(folder / f"{seat}.json")
        assert card.training["processes"] == 2
        np.testing.assert_array_equal(
            weights["layer0.bias"], state.tensors[seat]["actor.mlp.0.bias"].numpy()
        )


def test_fewer_processes_do_not_go_on_with_it(two):
    with pytest.raises(ValueError, match="processes = 2, now 1"):
        train(SETTINGS, two[0] / "run", quiet=True)
