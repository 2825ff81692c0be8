"""``hmi-marl study``: from clips to verdicts, from the command line."""

import json
import re

import pytest
from cited import missing_in, reports_written
from people.study.studies import a_study

from hmi_marl.cli import main
from hmi_marl.people.study.folder import read_study
from hmi_marl.people.study.ratings import write_answers
from hmi_marl.people.study.settings import Plan
from hmi_marl.people.study.simulated import simulated_answers

pytest.importorskip("statsmodels")


@pytest.fixture(autouse=True)
def in_a_folder_of_its_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def test_make_renders_once_and_says_what_raters_are_to_see(tmp_path, capsys):
    words = "study make --format gif --drivers lisa bart --controls --policy rule --clips 2 "
    words += "--shown 1 --duration 0.4 --vehicles 1 2 --width 160 --out study"
    assert main(words.split()) == 0
    printed = capsys.readouterr()
    study = read_study(tmp_path / "study")
    assert f"the study {study.id}: 4 clips, and an attention check" in printed.out
    assert "distracted:bart>lisa: raters see bart as more distracted than lisa" in printed.out
    assert "4/4" in printed.err, "the bar ran to its end"
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "study/clips").iterdir()}
    (tmp_path / "study" / "consent.txt").write_text("Our words.")
    assert main(words.split()) == 0
    assert {path: path.stat().st_mtime_ns for path in before} == before
    assert read_study(tmp_path / "study").consent == "Our words."


def test_power_and_its_answers_are_marked_as_simulated_wherever_they_go(tmp_path, capsys):
    a_study(tmp_path / "study", clips=4)
    words = "study power study --raters 8 16 --studies 20 --plan.effect 2 --out power"
    with reports_written() as reports:
        assert main(words.split()) == 0
    assert [missing_in(report) for report in reports] == [[]]
    printed = capsys.readouterr().out
    assert printed.startswith("Simulated: SIMULATED raters")
    names = {path.name for path in (tmp_path / "power").iterdir()}
    assert names == {
        "power-simulated.json",
        "power-simulated.txt",
        "power-simulated.png",
        "answers-simulated.csv",
        "index.html",
    }
    content = json.loads((tmp_path / "power" / "power-simulated.json").read_text())
    assert content["simulated"] is True
    (contrast,) = content["contrasts"]
    assert contrast["name"] == "distracted:bart>lisa"
    assert contrast["power"][1]["mean"] > 0.8
    assert "SIMULATED" in (tmp_path / "power" / "index.html").read_text()

    words = "study analyse study power/answers-simulated.csv --out found"
    with reports_written() as reports:
        assert main(words.split()) == 0
    assert [missing_in(report) for report in reports] == [[]]
    printed = capsys.readouterr().out
    assert re.search(r"supported +raters see bart as more distracted than lisa", printed)
    names = {path.name for path in (tmp_path / "found").iterdir()}
    assert names == {
        "study-simulated.json",
        "study-simulated.txt",
        "ratings-simulated.png",
        "index.html",
    }
    content = json.loads((tmp_path / "found" / "study-simulated.json").read_text())
    assert content["simulated"] is True
    assert content["raters"] + content["left_out"]["failed"] == 16
    assert content["verdicts"][0]["outcome"] == "supported"
    assert "SIMULATED" in (tmp_path / "found" / "index.html").read_text()


def test_another_folder_than_the_one_that_was_served_is_refused(tmp_path, capsys):
    study = a_study(tmp_path / "study")
    other = a_study(tmp_path / "other", seed=4)
    write_answers(tmp_path / "answers.csv", simulated_answers(study, 4, Plan()))
    assert main(["study", "analyse", "other", "answers.csv"]) == 2
    assert f"no answers of the study {other.id}" in capsys.readouterr().err
    (tmp_path / "study" / "clips" / study.clips[0].name).write_bytes(b"other")
    assert main(["study", "analyse", "study", "answers.csv"]) == 2
    assert "is missing or differs from study.json" in capsys.readouterr().err
    assert not (tmp_path / "runs").exists()
