import os
from dataclasses import replace

import pytest

from hmi_marl.training.jobs import Job, train_all
from hmi_marl.training.ppo.run import train
from hmi_marl.training.protocols.joint import Joint
from hmi_marl.training.protocols.settings import PPOSettings
from hmi_marl.training.protocols.two_stage import TwoStage
from hmi_marl.training.runs.folder import read_curve

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
