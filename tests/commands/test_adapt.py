import json
import shlex
from pathlib import Path

import pytest
from evidence_models import save_trained, small_evaluation

from hmi_marl.agents.adaptive.hmis import Trained
from hmi_marl.cli import main, parse
from hmi_marl.experiments.adaptation.evaluation import AdaptSettings

TINY = ["--drivers", "2", "--population", "2", "--repeats", "1", "--candidates", "1"]
TINY += ["--changes", "2", "--driver-policy", "random", "--workers", "1"]


@pytest.fixture(autouse=True)
def in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def made_of(trained: Trained) -> list[str]:
    parts = "evidence", "conditioned", "hidden"
    return [word for name in parts for word in (f"--{name}", getattr(trained, name))]


def test_the_defaults_are_those_of_python() -> None:
    command = parse(["adapt"])
    assert command.size == AdaptSettings()
    assert command.trained == Trained()
    assert (command.out, command.quick, command.clip) == (None, False, True)


def test_settings_reach_the_evaluation() -> None:
    command = parse(["adapt", "--caution", "1", "--seed", "3", "--conditioned", "runs/z"])
    assert command.size == AdaptSettings(caution=1.0, seed=3)
    assert command.trained == Trained(conditioned="runs/z")


def test_too_few_drivers_are_refused_before_anything_is_played(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(SystemExit) as stop:
        main(["adapt", *TINY, "--drivers", "1"])
    assert stop.value.code == 2
    error = " ".join(capsys.readouterr().err.replace("│", " ").split())
    assert "drivers lies in 2 to 1000000, but got 1" in error
    assert not Path("runs").exists()


def test_help_teaches_by_an_example(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["adapt", "--help"])
    assert "Example: hmi-marl adapt --quick" in " ".join(capsys.readouterr().out.split())


def test_it_plays_writes_and_prints(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    small_evaluation(monkeypatch)
    arguments = ["adapt", *TINY, *made_of(save_trained(tmp_path / "learned"))]
    assert main(arguments) == 0
    printed = capsys.readouterr().out
    out = Path("runs/adapt")
    assert {path.name for path in out.iterdir()} == {
        *("adapt.txt", "adapt.json", "adapt.png", "adapt.gif", "index.html"),
    }
    assert (out / "adapt.txt").read_text("utf-8").strip() in printed
    assert "the clip: runs/adapt/adapt.gif" in printed
    assert "index.html" in printed
    content = json.loads((out / "adapt.json").read_text("utf-8"))
    assert content["command"] == shlex.join(["hmi-marl", *arguments])
    assert content["settings"]["population"] == 2
    assert "NaN" not in (out / "adapt.json").read_text("utf-8")
    assert len(content["verdicts"]) == 12


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--quick", "--drivers", "7"], "--quick sets the sizes itself; leave it out"),
        (["--workers", "0"], "workers lies in 1 to"),
        (["--evidence", "nowhere"], "no evidence model at nowhere"),
        (["--driver-policy", "siren"], "unknown driver policy 'siren'"),
    ],
)
def test_what_cannot_be_is_told_in_one_line(
    arguments: list[str],
    told: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    small_evaluation(monkeypatch)
    words = [] if "--quick" in arguments else ["--drivers", "2", "--driver-policy", "random"]
    words += ["--workers", "1", *made_of(save_trained(tmp_path / "learned"))]
    for name in set(arguments[::2]) & set(words):
        place = words.index(name)
        del words[place : place + 2]
    assert main(["adapt", *words, *arguments]) == 2
    last = capsys.readouterr().err.splitlines()[-1]
    assert told in last
