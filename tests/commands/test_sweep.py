from pathlib import Path

import pytest

from hmi_marl.cli import main

SWEPT = ["sweep", "joint", "two-stage", "--over", "steps=1e5,2e5", "num_teams=64", "--seeds", "2"]


def test_a_dry_run_prints_the_plan_and_makes_nothing(tmp_path: Path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    assert main([*SWEPT, "--dry-run"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "Plan of the sweep in runs/sweep"
    head = "protocol steps seed environment steps folder state"
    assert lines[1].split() == head.split()
    assert len(lines) == 2 + 8 + 1
    assert lines[2].split()[-2:] == ["joint_num_teams=64_steps=100000_run0", "new"]
    assert lines[-1].strip().endswith("are left to do. For all: num_teams = 64.")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("over", "message"),
    [
        ("hmi_for=homer", "joint has no option hmi_for; two-stage:hmi_for=homer sweeps it for"),
        ("ppo.gamma=0.9,1.5", "joint with ppo.gamma = 1.5: gamma lies in [0, 1], but got 1.5"),
        ("ppo.gamm=1", "unknown option of joint 'ppo.gamm'; did you mean ppo.gamma"),
        ("critic=nope", "critic is one of team, own, not 'nope'"),
    ],
)
def test_what_does_not_fit_is_told_in_one_line(over, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["sweep", "joint", "two-stage", "--over", over]) == 2
    assert capsys.readouterr().err.startswith(f"hmi-marl: {message}")
    assert list(tmp_path.iterdir()) == []
