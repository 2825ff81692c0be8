import json
import math
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest
from cited import missing

from hmi_marl.cli import main
from hmi_marl.envs.drivers import DRIVERS, PAPER_DRIVERS, get_driver
from hmi_marl.experiments import experiment
from hmi_marl.experiments.experiment import spec
from hmi_marl.experiments.metrics_table import experiment as module
from hmi_marl.experiments.metrics_table.experiment import MetricsTable
from hmi_marl.experiments.metrics_table.paper_table import (
    ETA_1,
    PRINTED,
    PaperTable,
    exact_part,
    optimum_part,
    paper_compared,
    shortfall,
)
from hmi_marl.experiments.metrics_table.table import TableConfig, make_cell, play_cell
from hmi_marl.paper.printed import DISTRACTION_RETURNS, SPEED_RETURNS, mean_over_drivers
from hmi_marl.reporting.statistics import Estimate

TINY = ["--driver-steps", "1", "--hmi-steps", "1", "--episodes", "4", "--num-teams", "16"]
TINY += ["--seeds", "1"]


@pytest.fixture(scope="module")
def cell():
    config = TableConfig(drivers=("homer",), hmis=("own",), episodes=4, world="batched")
    return make_cell(config, "homer", "own", play_cell(config, "homer", "own", range(4)))


def with_distraction(cell, mean, low, high, exact):
    return replace(
        cell,
        distraction_return=Estimate(mean, low, high),
        exact_distraction_return_same_steps=exact,
    )


def test_the_averages_of_the_paper_are_those_of_its_text():
    distraction = {hmi: mean_over_drivers(row) for hmi, row in DISTRACTION_RETURNS.items()}
    assert distraction == pytest.approx({"own": -101.25, "AvgHMI": -283, "NoHMI": -470.75})
    speed = {hmi: mean_over_drivers(row) for hmi, row in SPEED_RETURNS.items()}
    assert speed == pytest.approx({"own": 448.25, "AvgHMI": 422.75, "NoHMI": 426.5})


def test_a_driver_can_be_told_on_the_command_line():
    for driver in (*DRIVERS.values(), *ETA_1.drivers):
        assert get_driver(spec(driver)) == driver


def test_equal_drivers_share_their_hmi_and_others_do_not():
    runs = {
        variant.name: [variant.hmi_run(d) for d in variant.drivers] for variant in (PRINTED, ETA_1)
    }
    assert runs["printed"] == ["hmi-lisa", "hmi-marge", "hmi-bart", "hmi-homer"]
    assert runs["eta-1"] == ["hmi-lisa-eta-1", "hmi-marge", "hmi-bart-eta-1", "hmi-homer"]


def test_one_driver_policy_learns_with_everybody_who_drives(tmp_path):
    settings = MetricsTable()
    job = settings.driver_job(tmp_path)
    assert {get_driver(name).traits for name in job.settings.drivers} == {
        *(driver.traits for driver in DRIVERS.values()),
        *(driver.traits for driver in ETA_1.drivers),
    }
    hmis = {job.folder.name: job.settings.hmi_for for job in settings.hmi_jobs(tmp_path)}
    assert len(hmis) == 7
    assert get_driver(hmis["hmi-lisa-eta-1"]).eta == 1.0
    assert get_driver(hmis["hmi-average"]) == DRIVERS["average"]


@pytest.mark.parametrize("name", ["driver_steps", "hmi_steps", "episodes"])
def test_a_reproduction_of_nothing_is_refused(name):
    with pytest.raises(ValueError, match=f"{name} lies in 1 to"):
        MetricsTable(**{name: 0})


@pytest.mark.parametrize(
    ("off", "outcome"),
    [(1.8, "supported"), (2.0, "undetermined"), (2.2, "not supported")],
)
def test_a_cell_is_exact_if_its_whole_interval_lies_within_two_percent(cell, off, outcome):
    for sign in (1.0, -1.0):
        found = replace(
            cell,
            exact_distraction_return_same_steps=-100.0,
            distraction_minus_exact=Estimate(sign * off, math.nan, math.nan, 0.05, 10_000),
        )
        assert exact_part("homer", "homer", found).outcome() == outcome


@pytest.mark.parametrize(
    ("missing", "outcome"),
    [(1.8, "supported"), (2.0, "undetermined"), (2.2, "not supported"), (-9.0, "supported")],
)
def test_an_own_hmi_reaches_the_optimum_or_not(cell, missing, outcome):
    found = replace(
        cell,
        optimal_attention_return_same_steps=-100.0,
        attention_minus_optimum=Estimate(-missing, math.nan, math.nan, 0.05, 10_000),
    )
    assert optimum_part("homer", found).outcome() == outcome


def test_both_tables_are_judged_with_every_cell(cell):
    cells = {
        (row, driver): cell
        for driver in PAPER_DRIVERS
        for row in (*PAPER_DRIVERS, "AvgHMI", "NoHMI")
    }
    judged = MetricsTable(seeds=1).judge_of([PaperTable(v, cells, cell) for v in (PRINTED, ETA_1)])
    assert [len(verdict.parts) for verdict in judged] == [24, 5, 24, 5]
    assert all("1 training seed" in verdict.basis for verdict in judged[1::2])


def test_ranges_and_exact_values_are_over_the_same_steps(cell):
    reach = cell.reachable_distraction_return_same_steps
    assert reach.least <= cell.exact_distraction_return_same_steps <= reach.most
    assert reach.least == pytest.approx(-8 * cell.steps.mean)


def test_the_shortfall_is_a_share_of_the_optimum_whatever_its_sign(cell):
    def with_attention(mean, best):
        return replace(
            cell,
            attention_return=Estimate(mean, mean, mean),
            optimal_attention_return_same_steps=best,
        )

    assert shortfall(with_attention(980.0, best=1000.0)) == pytest.approx(0.02)
    assert shortfall(with_attention(-102.0, best=-100.0)) == pytest.approx(0.02)
    assert shortfall(with_attention(-90.0, best=-100.0)) == pytest.approx(-0.1)


def test_the_verdict_on_the_paper_is_out_of_reach_agrees_or_differs(cell):
    bart = with_distraction(cell, -770, -775, -765, exact=-769)

    def verdict(cell, metric, printed):
        return paper_compared(cell, DRIVERS["bart"], metric, printed)

    assert verdict(bart, "distraction_return", -123.0).startswith("out of reach")
    assert verdict(bart, "distraction_return", -745.0) == "agrees"
    fast = replace(cell, speed_return=Estimate(440.0, 435.0, 445.0))
    assert verdict(fast, "speed_return", 443.0) == "agrees"
    assert verdict(fast, "speed_return", 428.0) == "agrees"  # within 3 %
    assert verdict(fast, "speed_return", 404.0) == "differs by +36"
    assert verdict(fast, "speed_return", 391.0) == "differs by +49"


def test_the_diagonal_is_the_papers_own_row():
    table = PaperTable(PRINTED, {})
    assert table.paper_row("lisa", "lisa") == "own"
    assert table.paper_row("lisa", "bart") is None
    assert table.paper_row("AvgHMI", "bart") == "AvgHMI"


@pytest.mark.usefixtures("trained_here")
def test_the_whole_reproduction_runs_and_runs_on(tmp_path: Path, capsys, monkeypatch):
    for owner, name in ((experiment, "TwoStage"), (module, "TwoStage"), (module, "TableConfig")):
        monkeypatch.setattr(owner, name, partial(getattr(owner, name), duration=2.0))
    shown, blocks = [], MetricsTable.blocks

    def kept(table, results):
        made = blocks(table, results)
        shown.extend(made)
        return made

    monkeypatch.setattr(MetricsTable, "blocks", kept)
    out = tmp_path / "table"
    command = ["reproduce", "table", *TINY, "--workers", "1", "--out", str(out)]
    assert main(command) == 0
    printed = capsys.readouterr().out
    for told in ("Distraction return, η as printed", "Speed return, η = 1", "paper *", "reachable"):
        assert told in printed
    content = json.loads((out / "table.json").read_text())
    assert {name: len(cells) for name, cells in content["tables"].items()} == {
        "printed": 24,
        "eta-1": 24,
    }
    bart = [c for c in content["tables"]["eta-1"] if c["hmi"] == c["driver"] == "bart"]
    assert bart[0]["paper"] == {"distraction_return": -123.0, "speed_return": 444.0}
    assert content["average_driver_with_own_hmi"]["printed"]["hmi"] == "AvgHMI"
    numbers = {name: content[name] for name in content if name not in ("command", "seconds")}
    assert str(tmp_path) not in json.dumps(numbers)
    assert "training hmi-bart-eta-1" in content["seconds"]
    differences = content["differences"]["printed"]
    for one, other in (("own", "AvgHMI"), ("own", "NoHMI")):
        whole = differences["between_rows"][f"{one} - {other}"]["speed_return"]["all"]
        assert whole["count"] == 4
        rows = (differences["rows"][row]["speed_return"]["mean"] for row in (one, other))
        assert whole["mean"] == pytest.approx(next(rows) - next(rows))
    shortfalls = content["attention_shortfall_of_own_hmis"]
    assert list(shortfalls["printed"]) == ["lisa", "marge", "bart", "homer", "average"]
    assert not missing(shown, content)
    page = (out / "index.html").read_text()
    assert "<img" in page
    assert "http" not in page.replace("http-equiv", "")
    weights = (out / "hmi-bart" / "vehicle_ai.safetensors").stat().st_mtime_ns
    assert main(command) == 0  # nothing is learned twice
    assert (out / "hmi-bart" / "vehicle_ai.safetensors").stat().st_mtime_ns == weights
