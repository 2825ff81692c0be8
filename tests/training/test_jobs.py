import os
from dataclasses import replace

import pytest

from hmi_marl.training.cluster.cluster import Cluster
from hmi_marl.training.cluster.parcels import put, read_by_others, state_in
from hmi_marl.training.jobs import Job, train_all
from hmi_marl.training.ppo.run import train
from hmi_marl.training.protocols.joint import Joint
from hmi_marl.training.protocols.settings import PPOSettings
from hmi_marl.training.protocols.two_stage import TwoStage
from hmi_marl.training.runs.folder import CHECKPOINT, CURVE, read_curve

TINY = {"num_teams": 16, "duration": 1.0}


@pytest.mark.slow
def test_weights_are_those_of_one_process_however_many_workers_there_are(tmp_path):
    jobs = [Job(Joint(steps=1, seed=seed, **TINY), tmp_path / f"{seed}") for seed in (0, 1)]
    train_all(jobs, 2, quiet=True)
    weights = [(job.folder / "driver.safetensors").read_bytes() for job in jobs]
    for job, found in zip(jobs, weights, strict=True):
        alone = tmp_path / "alone" / job.folder.name
        train(replace(job.settings, threads=1), alone, quiet=True)
        assert (alone / "driver.safetensors").read_bytes() == found
    assert weights[0] != weights[1]


@pytest.mark.slow
def test_spare_workers_join_a_run_and_change_neither_weights_nor_this_process(
    tmp_path, monkeypatch
):
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    ppo = PPOSettings(num_learning_epochs=1, num_mini_batches=2)
    settings = Joint(steps=1, num_teams=8, duration=1.0, ppo=ppo, device="cpu")
    train_all([Job(settings, tmp_path / "two")], 2, quiet=True)
    assert os.environ["OMP_NUM_THREADS"] == "7"
    assert "OPENBLAS_NUM_THREADS" not in os.environ
    train(replace(settings, threads=1), tmp_path / "one", quiet=True)
    weights = [(tmp_path / each / "driver.safetensors").read_bytes() for each in ("one", "two")]
    assert weights[0] == weights[1]
    waited = [read_curve(tmp_path / each)[0]["share_of_time_waiting"] for each in ("one", "two")]
    assert waited[0] == 0 < waited[1]


@pytest.mark.slow
def test_what_a_worker_raises_is_raised_and_this_process_is_left_as_it_was(tmp_path, monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    lost = TwoStage(driver_policy=str(tmp_path / "nowhere"), hmi_steps=1, **TINY)
    with pytest.raises(FileNotFoundError, match="no policy for the seat of driver"):
        train_all([Job(lost, tmp_path / "run")], 1, quiet=True)
    assert os.environ["OMP_NUM_THREADS"] == "7"
    assert "OPENBLAS_NUM_THREADS" not in os.environ


class Elsewhere(Cluster):
    """Runs the tasks in this process, with folders of the same names at another place."""

    def __init__(self, place):
        super().__init__()
        object.__setattr__(self, "place", place)

    def learn(self, tasks, quiet=False):
        for task in tasks:
            reads = []
            for number, path in enumerate(task.reads):
                there = self.place / f"read-{number}"
                put(there, read_by_others(path))
                reads.append(there / path.name)
            folder = self.place / "run" / task.folder.name
            replace(task, folder=folder, reads=tuple(reads)).go()
            put(task.folder, state_in(folder))


FEW = {
    "num_teams": 8,
    "duration": 1.0,
    "ppo": PPOSettings(num_learning_epochs=1, num_mini_batches=2),
}


@pytest.mark.parametrize(
    "settings",
    [
        TwoStage(driver_policy="./driver", hmi_steps=1, **FEW),
        TwoStage(driver_policy="mixture:rule,./driver,trained:driver", hmi_steps=1, **FEW),
        Joint(anchor="./driver", anchor_kl=0.5, steps=1, **FEW),
    ],
    ids=["partner", "mixture", "anchor"],
)
def test_a_run_on_another_machine_finds_its_driver_policies_there(settings, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    driver = TwoStage(driver_steps=1, hmi_steps=0, **FEW)
    train(replace(driver, threads=1), tmp_path / "driver", quiet=True)
    train(replace(settings, threads=1), tmp_path / "here", quiet=True)
    job = Job(settings, tmp_path / "there" / "here")
    train_all([job], 2, quiet=True, cluster=Elsewhere(tmp_path / "node"))
    files = state_in(tmp_path / "here")
    assert set(files) == set(state_in(job.folder))
    for name in set(files) - {CHECKPOINT, CURVE}:
        assert (job.folder / name).read_bytes() == files[name], name


def test_a_job_reads_only_policies_that_are_files(tmp_path):
    (tmp_path / "driver").mkdir()
    own = str(tmp_path / "driver")
    reads = {
        name: Job(TwoStage(driver_policy=name), tmp_path).reads
        for name in (None, "rule", "trained:driver", own)
    }
    assert reads == {None: (), "rule": (), "trained:driver": (), own: (tmp_path / "driver",)}
    assert Job(Joint(), tmp_path).reads == ()


def test_a_cluster_learns_on_a_gpu_only_where_it_is_asked_for(tmp_path, monkeypatch):
    asked = []

    class Asked(Cluster):
        def learn(self, tasks, quiet=False):
            asked.extend((task.gpu, task.arguments[3]) for task in tasks)

    monkeypatch.setattr("hmi_marl.training.runs.start.learns_on_gpu", None)  # is not asked here
    jobs = [Job(Joint(device=device), tmp_path) for device in ("auto", "cpu", "cuda")]
    train_all(jobs, 8, cluster=Asked())
    assert asked == [(False, 1), (False, 1), (True, 1)]
