import json

import pytest
from cited import missing

from hmi_marl.cli import main
from hmi_marl.experiments.attentive_drivers import CAUTIOUS, CONFIDENT, AttentiveDrivers, DriverRow
from hmi_marl.reporting.blocks import Verdicts
from hmi_marl.reporting.statistics import Estimate, share


def driving(who, speed, crashes, headway):
    """A row of 10,000 episodes; a confident driver's headway is 1 s."""
    return DriverRow(
        who.name,
        1_000_000,
        Estimate(speed, speed - 1, speed + 1, 0.5, 10_000),
        share(round(10_000 * crashes), 10_000),
        headway,
        Estimate(headway, headway - 0.02, headway + 0.02, 0.01 / headway, 10_000),
    )


def test_what_is_asked_of_trained_drivers_is_held_against_them():
    def judged(*rows):
        return [verdict.outcome for verdict in AttentiveDrivers(seeds=1).judge_of(list(rows))]

    good = judged(driving(CONFIDENT, 462, 0.03, 1.0), driving(CAUTIOUS, 407, 0.1, 1.24))
    assert good == ["supported"] * 4
    bad = judged(driving(CONFIDENT, 458, 0.05, 1.0), driving(CAUTIOUS, 403, 0.1, 1.16))
    assert bad == ["not supported"] * 4
    near = judged(driving(CONFIDENT, 460.5, 0.04, 1.0), driving(CAUTIOUS, 405.5, 0.1, 1.21))
    assert near == ["undetermined"] * 4


def test_every_number_is_where_its_source_says():
    rows = [driving(CONFIDENT, 462, 0.03, 1.0), driving(CAUTIOUS, 407, 0.1, 1.24)]
    assert not missing(AttentiveDrivers().blocks_of(rows), AttentiveDrivers().numbers_of(rows))


def test_missed_claims_are_told():
    rows = [driving(CONFIDENT, 458, 0.03, 1.0), driving(CAUTIOUS, 410, 0.1, 1.5)]
    text = Verdicts(AttentiveDrivers(seeds=1).judge_of(rows)).as_text()
    assert "not supported  confident: speed return of at least 460" in text
    assert "supported      cautious: keep 1.2 times the headway" in text
    assert "headway, times the confident driver's 1.50 [1.48, 1.52] (> 1.20?)" in text


@pytest.mark.usefixtures("trained_here")
def test_the_command_looks_at_drivers_on_the_way(tmp_path, capsys):
    size = ["--num-teams", "16", "--steps", "3200", "--snapshots", "2", "--episodes", "4"]
    size += ["--seeds", "1"]
    assert main(["reproduce", "driver", *size, "--out", str(tmp_path)]) == 0
    rows = json.loads((tmp_path / "driver.table.json").read_text())["rows"]
    assert [(row["driver"], row["steps"]) for row in rows] == [
        ("confident", 1600),
        ("cautious", 1600),
        ("confident", 3200),
        ("cautious", 3200),
    ]
    assert all(row["time_headway"] == pytest.approx(1.5, abs=1.4) for row in rows)
    assert "million steps" in capsys.readouterr().out
    assert json.loads((tmp_path / "driver.json").read_text())["seat"] == "driver"
