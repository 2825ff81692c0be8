import os

import pytest

from hmi_marl.training.jobs import Job, train_all
from hmi_marl.training.protocols.joint import Joint
from hmi_marl.training.protocols.two_stage import TwoStage

TINY = {"num_teams": 16, "duration": 1.0}


@pytest.mark.usefixtures("unmeasured")
def test_the_number_of_workers_does_not_change_the_weights(tmp_path):
    weights = []
    for workers in (1, 2):
        jobs = [
            Job(Joint(steps=1, seed=seed, **TINY), tmp_path / f"{workers}-{seed}")
            for seed in (0, 1)
        ]
        train_all(jobs, workers, quiet=True)
        weights.append([(job.folder / "driver.safetensors").read_bytes() for job in jobs])
    assert weights[0] == weights[1]
    assert weights[0][0] != weights[0][1]


@pytest.mark.usefixtures("unmeasured")
def test_the_environment_of_this_process_is_left_as_it_was(tmp_path, monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    lost = TwoStage(driver_policy=str(tmp_path / "nowhere"), hmi_steps=1, **TINY)
    with pytest.raises(FileNotFoundError, match="no policy for the seat of driver"):
        train_all([Job(lost, tmp_path / "run")], 1, quiet=True)
    assert os.environ["OMP_NUM_THREADS"] == "7"
    assert "OPENBLAS_NUM_THREADS" not in os.environ
