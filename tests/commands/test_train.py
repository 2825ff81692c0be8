import json
import shlex
from pathlib import Path

import pytest

from hmi_marl.cli import main, parse
from hmi_marl.commands import train as train_command
from hmi_marl.training.protocols.alternating import Alternating
from hmi_marl.training.protocols.fine_tune import FineTune
from hmi_marl.training.protocols.joint import Joint, Simultaneous
from hmi_marl.training.protocols.two_stage import TwoStage

TINY = ["--num-teams", "16", "--duration", "1"]


@pytest.mark.parametrize(
    ("name", "protocol"),
    [
        ("two-stage", TwoStage),
        ("joint", Joint),
        ("simultaneous", Simultaneous),
        ("alternating", Alternating),
        ("fine-tune", FineTune),
    ],
)
def test_every_protocol_is_a_subcommand_with_the_defaults_of_python(name, protocol):
    command = parse(["train", name])
    assert command.protocol == protocol()
    assert command.out is None


def test_settings_reach_the_protocol():
    command_line = (
        "train two-stage --drivers lisa mona:0.4,0.3,0.5,2 --hmi-for mona:0.4,0.3,0.5,2 --seed 7"
    )
    protocol = parse(
        [*command_line.split(), "--ppo.num-learning-epochs", "2", "--network.hidden-dims", "8", "8"]
    ).protocol
    assert protocol.drivers == ("lisa", "mona:0.4,0.3,0.5,2")
    assert protocol.seed == 7
    assert protocol.ppo.num_learning_epochs == 2
    assert protocol.network.hidden_dims == (8, 8)


def test_a_run_is_learned_watched_and_put_in_a_table(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    steps = ["--driver-steps", "1", "--hmi-steps", "1"]
    assert main(["train", "two-stage", *TINY, *steps]) == 0
    printed = capsys.readouterr().out
    assert "learned: runs/two-stage" in printed
    command = json.loads(Path("runs/two-stage/run.json").read_text())["command"]
    assert command == shlex.join(["hmi-marl", "train", "two-stage", *TINY, *steps])
    table = ["table", "--hmis", "own", "runs/two-stage", "--driver-policy", "runs/two-stage"]
    size = ["--drivers", "bart", "--episodes", "2", "--world", "batched", "--duration", "1"]
    assert main([*table, *size, "--workers", "1", "--no-clip"]) == 0
    assert "runs/two-stage" in capsys.readouterr().out
    clip = ["watch", "--hmi", "runs/two-stage", "--policy", "runs/two-stage", "--out", "clip.gif"]
    assert main([*clip, "--duration", "0.4"]) == 0
    assert Path("clip.gif").stat().st_size > 1000


def test_a_mixture_that_an_hmi_learned_with_is_watched_with_it(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    mixture = "mixture:trained:driver,rule"
    steps = ["--driver-policy", mixture, "--hmi-steps", "1", "--processes", "1"]
    assert main(["train", "two-stage", *TINY, *steps]) == 0
    printed = capsys.readouterr().out
    assert f"watch --hmi runs/two-stage --policy {mixture} --out clip.gif" in printed
    assert f"table --hmis own runs/two-stage --driver-policy {mixture} " in printed
    table = ["table", "--hmis", "runs/two-stage", "--drivers", "bart", "--episodes", "2"]
    size = ["--world", "batched", "--duration", "1", "--workers", "1", "--no-clip"]
    assert main([*table, "--driver-policy", mixture, *size]) == 0
    assert mixture in Path("runs/table/table.json").read_text()
    assert main([*table, "--driver-policy", "runs/two-stage", *size]) == 2
    told = "no policy for the seat of driver at runs/two-stage; it holds one for vehicle_ai"
    assert told in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--num-teams", "0"], "num_teams lies in 1 to"),
        (["--ppo.gamma", "1.5"], "gamma lies in [0, 1]"),
        (["--drivers", "nobody"], "unknown driver"),
        (["--hmi-reads", "wheel"], "no part 'wheel' to read"),
    ],
)
def test_bad_settings_are_refused_before_anything_is_learned(arguments, told, capsys):
    with pytest.raises(SystemExit) as stop:
        main(["train", "two-stage", *arguments])
    assert stop.value.code == 2
    error = " ".join(capsys.readouterr().err.replace("│", " ").split())
    assert told in error
    assert "dummy" not in error


def test_a_driver_that_is_not_there_is_told_in_one_line(tmp_path, capsys):
    command = ["train", "two-stage", *TINY, "--driver-policy", str(tmp_path / "nowhere")]
    assert main([*command, "--out", str(tmp_path / "run")]) == 2
    assert "no policy for the seat of driver" in capsys.readouterr().err.splitlines()[-1]


@pytest.mark.parametrize(
    ("chosen", "started"), [([], 2), (["--processes", "2"], 2), (["--processes", "1"], 1)]
)
def test_it_starts_as_many_processes_as_cores_or_as_told(chosen, started, tmp_path, monkeypatch):
    calls = []

    def start(settings, folder, processes, **shown):
        calls.append((settings.num_teams, folder, processes, shown))

    monkeypatch.setattr(train_command, "train_together", start)
    monkeypatch.setattr(train_command, "default_processes", lambda settings: 2)
    monkeypatch.delenv("WORLD_SIZE", raising=False)
    mini_batches = ["--ppo.num-mini-batches", "2", "--device", "cpu"]
    command = ["train", "joint", *TINY, *mini_batches, "--steps", "1", "--out", str(tmp_path)]
    assert main([*command, *chosen]) == 0
    if started == 1:
        assert not calls
        assert (tmp_path / "driver.json").is_file()
    else:
        shown = {"command_line": shlex.join(["hmi-marl", *command, *chosen])}
        assert calls == [(16, tmp_path, 2, shown)]


def test_torchruns_processes_start_no_others(tmp_path, monkeypatch):
    monkeypatch.setenv("WORLD_SIZE", "1")
    monkeypatch.setattr(train_command, "train_together", None)
    command = ["train", "joint", *TINY, "--steps", "1", "--processes", "4"]
    assert main([*command, "--device", "cpu", "--out", str(tmp_path)]) == 0


@pytest.mark.parametrize(
    ("processes", "told"),
    [
        ("0", "processes lies in 1 to 1024, but got 0"),
        ("3", "processes is one of 1, 2, since a batch"),
    ],
)
def test_processes_that_cannot_be_are_refused(processes, told, capsys):
    assert main(["train", "joint", "--processes", processes, "--device", "cpu"]) == 2
    assert told in capsys.readouterr().err
