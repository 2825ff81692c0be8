import json
import shlex
import sys

import minari
import numpy as np
import pytest

from hmi_marl.cli import main, parse
from hmi_marl.demonstrations.parquet import read_demonstrations
from hmi_marl.demonstrations.recording import CollectSettings

TINY = ["--steps", "40", "--duration", "2", "--vehicles", "1", "3"]


@pytest.fixture(autouse=True)
def in_a_folder_of_its_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("MINARI_DATASETS_PATH", raising=False)


def test_the_defaults_are_those_of_python():
    command = parse(["collect"])
    assert command.record == CollectSettings()
    assert str(command.out) == "runs/demonstrations"
    command_line = (
        "collect --drivers homer mona:0.4,0.3,0.5,2 --population 5 --alert-rate 0.1 --greedy"
    )
    settings = parse(command_line.split()).record
    assert settings.drivers == ("homer", "mona:0.4,0.3,0.5,2")
    assert (settings.population, settings.alert_rate, settings.greedy) == (5, 0.1, True)
    assert parse(["collect", "--end-at-crash"]).record.end_at_crash


def test_help_teaches_by_an_example(capsys):
    with pytest.raises(SystemExit):
        main(["collect", "--help"])
    printed = " ".join(capsys.readouterr().out.split())
    assert "Example: hmi-marl collect" in printed
    assert "population-0" in printed


def test_demonstrations_are_recorded_written_and_summed_up(tmp_path, capsys):
    arguments = ["collect", "--drivers", "lisa", "homer", *TINY, "--population", "2", "--minari"]
    assert main(arguments) == 0
    printed = capsys.readouterr()
    assert "400/400" in printed.err, "the bar ran to its end"
    assert [line.split()[:3] for line in printed.out.splitlines()[:4]] == [
        ["driver", "episodes", "steps"],
        ["lisa", "4", "40"],
        ["homer", "4", "40"],
        ["population", "32", "320"],
    ]
    folder = tmp_path / "runs" / "demonstrations"
    written = printed.out.splitlines()[-1]
    for name in ("observed.parquet", "truth.parquet", "summary.json"):
        assert (folder / name).is_file()
        assert f"runs/demonstrations/{name}" in written
    content = json.loads((folder / "summary.json").read_text())
    assert content["command"] == shlex.join(["hmi-marl", *arguments])
    assert [row["episodes"] for row in content["drivers"]] == [4, 4, 32]
    data = read_demonstrations(folder)
    assert len(data) == 40
    assert data.truth.about["command"] == content["command"]
    place = folder / "minari" / "hmi_marl-demonstrations-v0"
    assert str(place.relative_to(tmp_path)) in written
    dataset = minari.MinariDataset(str(place / "data"))
    assert dataset.total_episodes == 40
    np.testing.assert_array_equal(dataset[3].observations, data.observed.states[3])
    # a second time the parquet files are replaced, while a Minari dataset is not
    assert main(arguments) == 2
    assert "is there already; remove it" in capsys.readouterr().err
    assert main(arguments[:-1]) == 0


def test_without_minari_nothing_is_played(monkeypatch, tmp_path, capsys):
    monkeypatch.delitem(sys.modules, "hmi_marl.demonstrations.minari", raising=False)
    monkeypatch.setitem(sys.modules, "minari", None)
    assert main(["collect", *TINY, "--minari"]) == 2
    assert "pip install 'hmi-marl[data]'" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--drivers", "nobody"], "unknown driver"),
        (["--steps", "0"], "steps lies in 1 to"),
        (["--alert-rate", "2"], "alert_rate lies in [0, 1]"),
    ],
)
def test_bad_settings_are_refused_before_anything_is_played(arguments, told, capsys):
    with pytest.raises(SystemExit) as stop:
        main(["collect", *arguments])
    assert stop.value.code == 2
    error = " ".join(capsys.readouterr().err.replace("│", " ").split())
    assert told in error
    assert "dummy" not in error


def test_a_policy_that_is_not_there_leaves_nothing_behind(tmp_path, capsys):
    assert main(["collect", *TINY, "--driver-policy", "runs/nowhere"]) == 2
    assert "no policy for the seat of driver" in capsys.readouterr().err.splitlines()[-1]
    assert list(tmp_path.iterdir()) == []
