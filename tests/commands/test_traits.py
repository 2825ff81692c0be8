import json
import shlex
from pathlib import Path
from typing import Any

import pytest

from hmi_marl.cli import main, parse
from hmi_marl.experiments.latent_traits.assessment import AssessSettings
from hmi_marl.training.traits.settings import TraitSettings

COLLECT = ["--steps", "100", "--duration", "1", "--vehicles", "1", "4", "--num-teams", "64"]
TINY = ["--steps", "1", "--imitation-updates", "1", "--pool", "2", "--num-teams", "2"]
TINY += ["--ppo.num-mini-batches", "1", "--encoder.features", "4", "--held-out", "0.4"]
TINY += ["--average-updates", "1", "--encoder-updates", "1", "--device", "cpu"]
JUDGE = ["--windows", "10", "--episodes", "2", "--ranked", "2"]


@pytest.fixture(autouse=True)
def in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def collected(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["collect", "--drivers", "lisa", "homer", *COLLECT]) == 0
    capsys.readouterr()


def told_of(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """The one line that a command which fails tells."""
    assert main(arguments) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    (line,) = printed.err.splitlines()
    return line


def test_the_defaults_are_those_of_python() -> None:
    command: Any = parse(["traits", "train"])
    for name in TraitSettings.__dataclass_fields__:
        assert getattr(command.what, name) == getattr(TraitSettings(), name), name
    assert str(command.what.demonstrations) == "runs/demonstrations"
    assert (command.what.preferences, command.what.out) == (None, None)
    command = parse(["traits", "evaluate", "runs/a", "runs/b", "--ranked", "7"])
    assert command.what.runs == (Path("runs/a"), Path("runs/b"))
    assert command.what.size == AssessSettings(ranked=7)


def test_settings_reach_the_training() -> None:
    command_line = (
        "traits train --supervision id --latent 3 --weights.imitate 1 --policy.hidden-dims 8 8"
    )
    settings: Any = parse(command_line.split()).what  # type: ignore[union-attr]
    assert (settings.supervision, settings.latent) == ("id", 3)
    assert settings.weights.imitate == 1.0
    assert settings.policy.hidden_dims == (8, 8)


@pytest.mark.parametrize("command", ["train", "evaluate", "posterior"])
def test_help_teaches_by_an_example(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["traits", command, "--help"])
    assert f"Example: hmi-marl traits {command}" in " ".join(capsys.readouterr().out.split())


@pytest.mark.usefixtures("collected")
def test_traits_are_learned_and_judged(capsys: pytest.CaptureFixture[str]) -> None:
    train = ["traits", "train", "--supervision", "id", *TINY]
    assert main(train) == 0
    printed = capsys.readouterr().out
    assert "learned: runs/traits-id" in printed
    assert "hmi-marl traits evaluate runs/traits-id --demonstrations runs/demonstrations" in printed
    about = json.loads(Path("runs/traits-id/run.json").read_text("utf-8"))
    assert about["command"] == shlex.join(["hmi-marl", *train])
    assert main(["traits", "evaluate", "runs/traits-id", *JUDGE]) == 0
    printed = capsys.readouterr().out
    out = Path("runs/traits")
    assert {path.name for path in out.iterdir()} == {
        "traits-report.txt",
        "traits-report.json",
        "embeddings.png",
        "accuracy.png",
        "index.html",
    }
    assert (out / "traits-report.txt").read_text("utf-8").strip() in printed
    assert (out / "index.html").resolve().as_uri() in printed
    content = json.loads((out / "traits-report.json").read_text("utf-8"))
    assert list(content["supervisions"]) == ["id"]
    assert "traits evaluate runs/traits-id" in (out / "index.html").read_text("utf-8")


@pytest.mark.usefixtures("collected")
def test_preferences_of_people_are_read_from_a_file(capsys: pytest.CaptureFixture[str]) -> None:
    preferred = ["traits", "train", "--supervision", "preference", *TINY, "--preferences", "asked"]
    for content, told in (
        ("", "asked is no JSON file"),
        ('["lisa"]', 'asked does not contain {"name": number in [0, 1], ...}'),
        ('{"lisa": true, "homer": 1}', "asked does not contain"),
        ('{"lisa": 0.2}', "the preferences lack homer"),
        ('{"lisa": 0.2, "homer": 1.5}', "a preference lies in [0, 1], but got 1.5"),
    ):
        Path("asked").write_text(content, "utf-8")
        assert told in told_of(preferred, capsys)
    Path("asked").unlink()
    assert "asked" in told_of(preferred, capsys)
    assert not Path("runs/traits-preference/traits.json").exists()
    Path("asked").write_text('{"lisa": 0.2, "homer": 1}', "utf-8")
    assert main(preferred) == 0
    about = json.loads(Path("runs/traits-preference/run.json").read_text("utf-8"))
    assert about["preferences"] == {"lisa": 0.2, "homer": 1.0}


def test_what_is_not_there_is_told_in_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert "no demonstrations at runs/demonstrations" in told_of(["traits", "train"], capsys)
    nowhere = ["traits", "evaluate", "runs/nowhere"]
    assert "no trait model at runs/nowhere" in told_of(nowhere, capsys)
    told = told_of(["traits", "evaluate"], capsys)
    assert "name the folder of at least one trained run" in told


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["train", "--latent", "0"], "latent lies in 1 to"),
        (["train", "--num-teams", "3", "--pool", "2"], "num_teams is a multiple of pool = 2"),
        (
            ["train", "--supervision", "age"],
            "unknown value of --supervision 'age'; known: self, none, id, pref",
        ),
        (["evaluate", "run", "--ranked", "1"], "ranking takes two windows"),
    ],
)
def test_bad_settings_are_refused_before_anything_is_learned(
    arguments: list[str], told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stop:
        main(["traits", *arguments])
    assert stop.value.code == 2
    error = " ".join(capsys.readouterr().err.replace("│", " ").split())
    assert told in error
    assert "dummy" not in error
    assert list(tmp_path.iterdir()) == []
