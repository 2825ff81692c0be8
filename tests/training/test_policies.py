"""Driver policies that settings name, found at other places."""

from dataclasses import replace
from pathlib import Path

import pytest

from hmi_marl.experiments.sweep import runs
from hmi_marl.experiments.sweep.plan import plan_runs
from hmi_marl.training.evidence.settings import EvidenceSettings
from hmi_marl.training.policies import models_read, policies_read, reading, with_models
from hmi_marl.training.protocols.joint import Joint, Simultaneous
from hmi_marl.training.protocols.two_stage import TwoStage
from hmi_marl.training.run_tasks import RunTask

HERE, THERE = Path("/runs/a"), Path("/node/read-0/a")


@pytest.mark.parametrize(
    ("settings", "reads", "there"),
    [
        (Joint(), (), {}),
        (TwoStage(driver_policy="rule"), (), {"driver_policy": "rule"}),
        (TwoStage(driver_policy="trained:driver"), (), {"driver_policy": "trained:driver"}),
        (TwoStage(driver_policy="/runs/a"), (HERE,), {"driver_policy": "/node/read-0/a"}),
        (Simultaneous(anchor="/runs/a", anchor_kl=0.1), (HERE,), {"anchor": "/node/read-0/a"}),
        (EvidenceSettings(driver_policy="/runs/a"), (HERE,), {"driver_policy": "/node/read-0/a"}),
        (
            TwoStage(driver_policy="mixture:rule,/runs/a,trained:driver,/runs/b"),
            (HERE, Path("/runs/b")),
            {"driver_policy": "mixture:rule,/node/read-0/a,trained:driver,/node/read-1/b"},
        ),
    ],
)
def test_every_policy_that_is_a_file_is_read_where_it_is_now(settings, reads, there):
    assert policies_read(settings) == reads
    places = (THERE, Path("/node/read-1/b"))[: len(reads)]
    assert reading(settings, places) == replace(settings, **there)
    assert reading(settings, reads) == settings


def test_a_trait_model_that_is_a_file_is_read_where_it_is_now():
    shipped, own = EvidenceSettings(), EvidenceSettings(traits="/runs/traits-self")
    assert models_read(shipped) == ()
    assert with_models(shipped, [THERE]) == (shipped, (THERE,))
    assert models_read(own) == (Path("/runs/traits-self"),)
    moved = replace(own, traits="/node/read-0/traits-self")
    assert with_models(own, [Path("/node/read-0/traits-self"), THERE]) == (moved, (THERE,))


def test_a_run_of_a_sweep_finds_all_of_its_policies(tmp_path, monkeypatch):
    given = []

    class StopError(Exception):
        pass

    def stop(settings, *_):
        given.append(settings)
        raise StopError

    monkeypatch.setattr(runs, "train_in", stop)
    for over, names in {
        "simultaneous:anchor=/runs/a": {"anchor": "/node/read-0/a"},
        "two-stage:driver_policy=/runs/a": {"driver_policy": "/node/read-0/a"},
    }.items():
        protocol = over.partition(":")[0]
        (run,) = plan_runs((protocol,), (over,), 1, 0)
        task = runs.task(run, runs.Evaluation(), tmp_path, "", 1)
        assert isinstance(task, RunTask)
        assert task.reads == (HERE,)
        with pytest.raises(StopError):
            replace(task, reads=(THERE,)).go()
        assert given[-1] == replace(run.settings, **names)
