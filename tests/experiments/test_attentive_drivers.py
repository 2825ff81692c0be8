import json

import pytest

from hmi_marl.cli import main
from hmi_marl.experiments.attentive_drivers import CAUTIOUS, CONFIDENT, AttentiveDrivers, DriverRow
from hmi_marl.reporting.blocks import Verdicts
from hmi_marl.reporting.statistics import Estimate


def driving(who, speed, crashes, headway):
    return DriverRow(
        who.name,
        1_000_000,
        Estimate(speed, speed - 1, speed + 1),
        Estimate(crashes, crashes / 2, 2 * crashes),
        headway,
    )


def test_what_is_asked_of_trained_drivers_is_held_against_them():
    def holds(*rows):
        return [verdict.holds for verdict in AttentiveDrivers().judge(list(rows))]

    good = holds(driving(CONFIDENT, 461, 0.03, 1.0), driving(CAUTIOUS, 406, 0.1, 1.2))
    assert good == [True, True, True, True]
    bad = holds(driving(CONFIDENT, 459, 0.04, 1.0), driving(CAUTIOUS, 404, 0.1, 1.19))
    assert bad == [False, False, False, False]


def test_missed_claims_are_told():
    rows = [driving(CONFIDENT, 459, 0.03, 1.0), driving(CAUTIOUS, 410, 0.1, 1.5)]
    text = Verdicts(AttentiveDrivers().judge(rows)).as_text()
    assert "not supported  confident: speed return of at least 460" in text
    assert "supported      cautious: keep 1.2 times the headway (1.50 times)" in text


@pytest.mark.usefixtures("trained_here")
def test_the_command_looks_at_drivers_on_the_way(tmp_path, capsys):
    size = ["--num-teams", "16", "--steps", "3200", "--snapshots", "2", "--episodes", "4"]
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
