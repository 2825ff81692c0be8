from pathlib import Path
from typing import Any

import pytest

from hmi_marl.cli import main
from hmi_marl.experiments.experiment import Agent
from hmi_marl.reporting.report import Report
from hmi_marl.reproduction.report import NUMBERS, PAGE, REPORT
from hmi_marl.reproduction.suite import full_suite, shared_driver


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[tuple[Any, ...]]:
    """What would be run, and the command that the report names."""
    calls: list[tuple[Any, ...]] = []

    def instead(
        suite: Any, folder: Path, driver_run: Path, *others: Any, cluster: Any
    ) -> list[Any]:
        assert cluster is None
        assert driver_run == shared_driver(suite, folder)
        calls.append((suite, folder, *others))
        return []

    def report(records: list[Any], command_line: str, timings: Any) -> Report:
        calls[-1] += (command_line,)
        assert timings == {}
        return Report("reproduce", "", [], {}, command_line, {})

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("hmi_marl.reproduction.suite.run_suite", instead)
    monkeypatch.setattr("hmi_marl.reproduction.report.full_report", report)
    return calls


@pytest.mark.parametrize("words", [["reproduce"], ["reproduce", "all"]])
def test_everything_is_reproduced_by_default(words, asked, capsys) -> None:
    assert main([*words, "--workers", "2"]) == 0
    command_line = " ".join(["hmi-marl", *words, "--workers", "2"])
    out = Path("runs/reproduce/all")
    assert asked == [(full_suite(), out, 2, command_line, "hmi-marl reproduce")]
    assert f"the page: {out.resolve().as_uri()}/report/index.html" in capsys.readouterr().out


def test_the_report_tells_nothing_that_does_not_change_results(asked, tmp_path: Path) -> None:
    words = ["reproduce", "--quick", "--seed", "3", "--workers", "1"]
    assert main([*words, "--out", str(tmp_path)]) == 0
    assert main(words) == 0
    (suite, out, _, _, again), (_, default, *_) = asked
    assert suite == full_suite(quick=True, seed=3)
    assert (out, default) == (tmp_path, Path("runs/reproduce/all-quick"))
    assert again == "hmi-marl reproduce --quick --seed 3"


def test_bad_settings_are_told_before_anything_is_done(asked, capsys) -> None:
    assert main(["reproduce", "--workers", "0"]) == 2
    assert main(["reproduce", "--seed", "-1"]) == 2
    told = capsys.readouterr().err.splitlines()
    assert "workers lies in 1 to 1024, but got 0" in told[0]
    assert "seed" in told[1]
    assert not asked


def test_only_a_finished_reproduction_is_shipped(tmp_path: Path, capsys) -> None:
    command = ["reproduce", "ship", "--run", str(tmp_path / "run"), "--out", str(tmp_path / "out")]
    assert main(command) == 2
    assert "stage table of" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_the_report_is_shipped_beside_the_agents(tmp_path: Path, monkeypatch, capsys) -> None:
    run, report = tmp_path / "run", tmp_path / "docs"
    (run / REPORT).mkdir(parents=True)
    pages = (PAGE, "table.html", NUMBERS, "reproduce.txt", "timings.json")
    for name in pages:
        (run / REPORT / name).write_text(name)
    copied = [Agent("homer", run / "vehicle_ai.json", "alerts homer")]
    monkeypatch.setattr("hmi_marl.reproduction.shipping.ship", lambda *given: copied)
    command = ["reproduce", "ship", "--run", str(run), "--out", str(tmp_path / "out")]
    assert main(command) == 0
    assert capsys.readouterr().out.split() == ["homer", "alerts", "homer"]
    assert not report.exists()
    for again in (False, True):
        assert main([*command, "--report", str(report)]) == 0
        names = {*pages, "notes.md"} if again else set(pages)
        assert {path.name: path.read_text() for path in report.iterdir()} == {n: n for n in names}
        for name in ("old.html", "notes.md"):  # a page of an earlier report, and another file
            (report / name).write_text(name)


def test_a_report_that_is_not_finished_is_not_shipped(tmp_path: Path, capsys) -> None:
    command = ["reproduce", "ship", "--run", str(tmp_path), "--out", str(tmp_path / "out")]
    assert main([*command, "--report", str(tmp_path / "docs")]) == 2
    assert "has no index.html; run hmi-marl reproduce to its end" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_agents_of_one_experiment_are_shipped_beside_the_others(
    tmp_path: Path, monkeypatch, capsys
) -> None:
    added = []
    monkeypatch.setattr(
        "hmi_marl.reproduction.shipping.ship_more", lambda agents, out: added.extend(agents)
    )
    command = ["reproduce", "ship", "--run", str(tmp_path), "--out", str(tmp_path / "trained")]
    assert main([*command, "--only", "traits"]) == 0
    assert [agent.name for agent in added] == [
        "traits-none",
        "traits-id",
        "traits-preference",
        "traits-self",
    ]
    assert added[3].card == tmp_path / "traits-self" / "traits.json"
    capsys.readouterr()
    for wrong, told in (
        (["--only", "traits", "--compare", str(tmp_path)], "--compare or --only, not both"),
        (["--only", "traits", "--report", str(tmp_path / "report")], "leave it out, or --only"),
        (["--only", "sweep"], "sweep has no agents to ship"),
        (["--only", "nope"], "unknown experiment 'nope'"),
    ):
        assert main([*command, *wrong]) == 2
        assert told in capsys.readouterr().err
    assert len(added) == 4


@pytest.mark.parametrize("more", [[], ["--report", "docs"]])
def test_only_a_finished_comparison_is_shipped(more, tmp_path: Path, monkeypatch, capsys) -> None:
    """``tests/reproduction/test_comparison.py`` ships one."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "compare").mkdir()
    command = ["reproduce", "ship", "--compare", "compare", "--out", "trained", *more]
    assert main(command) == 2
    assert "compare has no INDEX.json of a whole report; run its hmi" in capsys.readouterr().err
    assert [path.name for path in tmp_path.rglob("*")] == ["compare"]
