"""A whole sweep of tiny runs, and the same again."""

from __future__ import annotations

import json
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from cited import missing_in

from hmi_marl.experiments.episodes import play_named
from hmi_marl.experiments.experiment import Place, conduct
from hmi_marl.experiments.sweep import experiment as module
from hmi_marl.experiments.sweep.experiment import Sweep, plan_table
from hmi_marl.experiments.sweep.runs import RESULT, read_result
from hmi_marl.experiments.sweep.table import TABLE
from hmi_marl.reporting.report import Report
from hmi_marl.training.runs.folder import CHECKPOINT, read_curve

TINY = ("num_teams=8", "duration=1", "ppo.num_mini_batches=2", "ppo.num_learning_epochs=1")
SWEEP = Sweep(
    ("joint", "two-stage"),
    ("joint:ppo.gamma=0.5,0.9", "two-stage:hmi_steps=0", "two-stage:driver_steps=1", *TINY),
    seeds=2,
    episodes=3,
    drivers=("homer", "fast:0.1,0.5,0.01,1.5"),
)
SWEEP = replace(SWEEP, over=("joint:steps=1", *SWEEP.over))


@pytest.fixture(scope="module")
def report(tmp_path_factory, module_trained_here) -> tuple[Path, Report]:
    folder = tmp_path_factory.mktemp("sweep")
    return folder, conduct(SWEEP, Place(folder, folder, 1, "hmi-marl sweep"))


@pytest.fixture(scope="module")
def swept(report) -> Path:
    return report[0]


def test_every_number_is_where_its_source_says(report):
    assert not missing_in(report[1])


def trained(monkeypatch, sweep: Sweep, folder: Path) -> list[str]:
    """Names of the runs that a sweep would train or play."""
    asked: list[str] = []

    def instead(tasks, workers, cluster):
        asked.extend(task.folder.name for task in tasks)

    monkeypatch.setattr(module, "side_by_side", instead)
    with suppress(RuntimeError):  # since nothing was trained
        sweep.run(Place(folder, folder))
    return asked


def test_the_table_has_a_row_for_each_run_and_driver(swept):
    table = pq.read_table(swept / TABLE)
    rows = table.to_pylist()
    assert len(rows) == 6 * 3
    assert [row["driver"] for row in rows[:3]] == ["all", "homer", "fast"]
    assert {(row["protocol"], row["ppo.gamma"]) for row in rows} == {
        ("joint", 0.5),
        ("joint", 0.9),
        ("two-stage", None),
    }
    for everyone, *each in zip(*[iter(rows)] * 3, strict=True):
        mean = sum(row["team_return"] for row in each) / 2
        assert everyone["team_return"] == pytest.approx(mean)
        assert everyone["episodes"] == 6
        last = read_curve(swept / everyone["folder"])[-1]
        assert everyone["training_steps"] == last["steps"] == 40
        assert everyone["training_seconds"] == last["seconds"]
    about = json.loads(table.schema.metadata[b"hmi-marl"])
    assert about["command"] == "hmi-marl sweep"
    assert about["settings"]["seeds"] == 2


def test_a_row_is_what_the_run_played(swept):
    run = SWEEP.plan[0]
    folder = str(swept / run.name)
    episodes = play_named(run.settings.team(("homer",)), folder, folder, 3)
    row = next(r for r in pq.read_table(swept / TABLE).to_pylist() if r["driver"] == "homer")
    total = sum(values.sum() for values in episodes.returns.values())
    assert row["team_return"] == pytest.approx(total / 3)
    assert row["crashes"] == episodes.crashed.sum()


def test_a_run_without_an_hmi_plays_without_alerts(swept):
    run = next(run for run in SWEEP.plan if run.combination.protocol == "two-stage")
    result = read_result(run, SWEEP.evaluation, swept / run.name)
    assert result is not None
    assert result.by_driver["all"].metrics["alerts_per_minute"] == 0


def test_the_report_has_an_interval_for_each_combination(swept):
    numbers = json.loads((swept / "sweep.json").read_text())
    assert [each["options"].get("ppo.gamma") for each in numbers["combinations"]] == [
        0.5,
        0.9,
        None,
    ]
    for each in numbers["combinations"]:
        estimate = each["over_seeds"]["all"]["team_return"]
        assert estimate["low"] <= estimate["mean"] <= estimate["high"]
    text = (swept / "sweep.txt").read_text()
    assert "6 runs: 3 combinations, 2 seeds each, 240 environment steps" in text
    assert "num_teams = 8" in text
    assert (swept / "sweep.png").read_bytes().startswith(b"\x89PNG")
    assert "<table>" in (swept / "index.html").read_text()


def test_what_is_done_is_not_done_again(swept, monkeypatch):
    assert trained(monkeypatch, SWEEP, swept) == []
    assert set(SWEEP.states(swept)) == {"done"}


def test_more_values_and_seeds_train_the_new_runs_alone(swept, monkeypatch):
    over = tuple(each.replace("0.5,0.9", "0.5,0.7,0.9") for each in SWEEP.over)
    larger = replace(SWEEP, over=over, seeds=3)
    asked = trained(monkeypatch, larger, swept)
    assert len(asked) == 4 * 3 - 6
    assert not {run.name for run in SWEEP.plan} & set(asked)
    table = plan_table(larger, swept)
    assert [row[-1] for row in table.rows].count("done") == 6
    assert "12 runs of 480 environment steps, of which 240 are left to do" in table.note


def test_another_evaluation_or_other_weights_play_again(swept, monkeypatch):
    names = [run.name for run in SWEEP.plan]
    assert trained(monkeypatch, replace(SWEEP, episodes=4), swept) == names
    run = SWEEP.plan[0]
    weights = swept / run.name / "driver.safetensors"
    before = weights.read_bytes()
    try:
        weights.write_bytes(before + b"x")
        assert trained(monkeypatch, SWEEP, swept) == [run.name]
    finally:
        weights.write_bytes(before)


def test_a_damaged_result_says_what_to_do(swept):
    run = SWEEP.plan[1]
    path = swept / run.name / RESULT
    before = path.read_text()
    try:
        path.write_text(before.replace('"seconds"', '"hours"'))
        with pytest.raises(ValueError, match=r"result\.json is damaged .* remove it"):
            SWEEP.states(swept)
    finally:
        path.write_text(before)


def test_a_plan_makes_nothing(tmp_path):
    assert {row[-1] for row in plan_table(SWEEP, tmp_path / "nowhere").rows} == {"new"}
    run = SWEEP.plan[0]
    (tmp_path / run.name).mkdir()
    (tmp_path / run.name / CHECKPOINT).touch()
    assert SWEEP.states(tmp_path).count("begun") == 1
    assert not (tmp_path / "nowhere").exists()
