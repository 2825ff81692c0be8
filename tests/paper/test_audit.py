import json
import math
from pathlib import Path
from typing import Any

import pytest

from hmi_marl.envs.drivers import DRIVERS
from hmi_marl.exact import oracle
from hmi_marl.files import json_value, write_json
from hmi_marl.paper.audit import (
    DISTRACTION_RETURNS,
    HORIZONS,
    AuditedCell,
    audit,
    reachable_in_the_paper,
)

Cells = dict[tuple[str, str], AuditedCell]


@pytest.fixture(scope="module")
def audited() -> list[AuditedCell]:
    return audit(window=7)


@pytest.fixture(scope="module")
def cells(audited: list[AuditedCell]) -> Cells:
    return {(cell.hmi, cell.driver): cell for cell in audited}


def test_the_papers_table_is_audited_row_by_row(audited: list[AuditedCell]) -> None:
    assert [(cell.hmi, cell.driver, cell.paper) for cell in audited] == [
        ("own", "lisa", -85.0),
        ("own", "marge", -80.0),
        ("own", "bart", -123.0),
        ("own", "homer", -117.0),
        ("AvgHMI", "lisa", -181.0),
        ("AvgHMI", "marge", -45.0),
        ("AvgHMI", "bart", -744.0),
        ("AvgHMI", "homer", -162.0),
        ("NoHMI", "lisa", -192.0),
        ("NoHMI", "marge", -176.0),
        ("NoHMI", "bart", -745.0),
        ("NoHMI", "homer", -770.0),
    ]


def test_lisas_and_barts_own_hmis_are_out_of_reach(cells: Cells) -> None:
    assert not cells["own", "lisa"].reachable
    assert not cells["own", "bart"].reachable


@pytest.mark.parametrize("driver", ["marge", "homer"])
def test_marges_and_homers_own_hmis_are_reachable(cells: Cells, driver: str) -> None:
    assert cells["own", driver].reachable


@pytest.mark.parametrize("hmi", ["AvgHMI", "NoHMI"])
@pytest.mark.parametrize("driver", ["lisa", "marge", "bart", "homer"])
def test_the_other_rows_are_reachable(cells: Cells, hmi: str, driver: str) -> None:
    assert cells[hmi, driver].reachable


def test_too_bad_is_as_far_out_of_reach_as_too_good(monkeypatch: pytest.MonkeyPatch) -> None:
    printed = {"lisa": -201.0, "marge": -199.0, "bart": -742.0, "homer": -801.0}
    monkeypatch.setattr("hmi_marl.paper.audit.DISTRACTION_RETURNS", {"new": printed})
    verdicts = {cell.driver: cell.reachable for cell in audit()}
    assert verdicts == {"lisa": False, "marge": True, "bart": False, "homer": False}


def test_the_ends_of_what_is_reachable_worked_by_hand(cells: Cells) -> None:
    # η = 0.01 moves Lisa's p(d = 1) from 0.2 to 0.19 and Bart's from 0.8 to 0.79, and no more
    assert cells["own", "lisa"].least == pytest.approx(-10 * 0.2 * 100)
    assert cells["own", "lisa"].most == pytest.approx(-10 * 0.19 * 94)
    assert cells["own", "bart"].least == pytest.approx(-10 * 0.8 * 100)
    assert cells["own", "bart"].most == pytest.approx(-10 * 0.79 * 94)
    # η = 1: who is alerted in every step never is distracted
    assert cells["own", "homer"].most == 0.0


@pytest.mark.parametrize("driver", ["lisa", "bart"])
def test_with_eta_1_the_optimum_takes_in_what_the_paper_prints(cells: Cells, driver: str) -> None:
    cell = cells["own", driver]
    low, high = cell.optimum_if_eta_1
    assert low <= cell.paper <= high
    assert not cell.optimum[0] <= cell.paper <= cell.optimum[1]


@pytest.mark.parametrize(("driver", "twin"), [("lisa", "marge"), ("bart", "homer")])
def test_with_eta_1_the_drivers_are_their_twins(cells: Cells, driver: str, twin: str) -> None:
    # they differ by η, and by inflation, which attention knows nothing of
    assert cells["own", driver].optimum_if_eta_1 == cells["own", twin].optimum
    assert cells["own", twin].optimum_if_eta_1 == cells["own", twin].optimum


def test_the_optimum_lies_within_what_is_reachable(audited: list[AuditedCell]) -> None:
    for cell in audited:
        assert cell.least <= cell.optimum[0] < cell.optimum[1] <= cell.most


def test_the_ranges_are_over_all_horizons(cells: Cells) -> None:
    assert list(HORIZONS) == [94, 95, 96, 97, 98, 99, 100]
    ends = [oracle.solve_alerts("homer", 7, horizon).distraction_return for horizon in (94, 100)]
    assert cells["own", "homer"].optimum == (ends[1], ends[0])


def test_a_row_does_not_change_what_is_exact(cells: Cells) -> None:
    for driver in DISTRACTION_RETURNS["own"]:
        own, none = cells["own", driver], cells["NoHMI", driver]
        assert (own.least, own.most, own.optimum) == (none.least, none.most, none.optimum)


def test_the_window_matters_to_the_audit(cells: Cells, monkeypatch: pytest.MonkeyPatch) -> None:
    own = {"own": DISTRACTION_RETURNS["own"]}
    monkeypatch.setattr("hmi_marl.paper.audit.DISTRACTION_RETURNS", own)
    homer = audit(window=1)[3]
    best = oracle.solve_alerts("homer", window=1, horizon=94).distraction_return
    assert homer.optimum[1] == best < cells["own", "homer"].optimum[1]


def test_the_audit_goes_through_json(tmp_path: Path, audited: list[AuditedCell]) -> None:
    write_json(tmp_path / "audit.json", json_value(audited))
    content = json.loads((tmp_path / "audit.json").read_text())
    assert len(content) == 12
    assert content[0]["driver"] == "lisa"
    assert content[0]["reachable"] is False
    assert content[1]["reachable"] is True
    for cell, known in zip(content, audited, strict=True):
        assert cell["paper"] == known.paper
        assert tuple(cell["optimum"]) == known.optimum
        assert math.isfinite(cell["least"])


def test_each_driver_is_solved_once(monkeypatch: pytest.MonkeyPatch) -> None:
    solved = []
    solve = oracle.solve_alerts

    def counted(*settings: Any) -> oracle.AlertSolution:
        solved.append(settings)
        return solve(*settings)

    monkeypatch.setattr(oracle, "solve_alerts", counted)
    assert len(audit(window=5)) == len(audit(window=5)) == 12
    # Every driver as printed and with η = 1.
    assert len(solved) == len(set(solved)) + 2 * len(HORIZONS) == 8 * len(HORIZONS)


def test_the_range_of_the_paper_is_over_all_its_horizons() -> None:
    least, most = reachable_in_the_paper(DRIVERS["bart"])
    each = [oracle.reachable("bart", 7, steps) for steps in HORIZONS]
    assert (least, most) == (min(r.least for r in each), max(r.most for r in each))
