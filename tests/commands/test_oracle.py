import json

import pytest

from hmi_marl.cli import main, parse
from hmi_marl.envs.alerts import Fatigue
from hmi_marl.exact import oracle

GRADED = ["--alert-strengths", "0.5", "1", "--fatigue", "20", "5", "1"]


def test_graded_alerts_are_solved_told_and_written_apart(tmp_path, capsys):
    command_line = ["oracle", "--driver", "homer", "--horizon", "50", "--out", str(tmp_path)]
    assert main(command_line) == 0
    assert "Alerts of strength" not in capsys.readouterr().out
    assert main([*command_line, *GRADED]) == 0
    printed = capsys.readouterr().out
    assert "Alerts of strength 0.5, 1, of which plain rules give the strongest" in printed
    assert "5 of 20 levels per alert, which take 1 η" in printed
    plain, graded = "homer-window7-horizon50", "-strengths0.5-1-fatigue20-5-1"
    assert {path.name for path in tmp_path.iterdir()} == {f"{plain}.json", f"{plain}{graded}.json"}
    content = json.loads((tmp_path / f"{plain}{graded}.json").read_text())
    given = {"strengths": (0.5, 1.0), "fatigue": Fatigue(20, 5, 1.0)}
    best = oracle.solve_alerts("homer", 7, 50, **given)
    assert content["alerts"]["strengths"] == [0.5, 1.0]
    assert content["alerts"]["fatigue"] == {"levels": 20, "per_alert": 5, "effect": 1.0}
    told = content["returns"]["optimal"]
    assert told["total_return"] == pytest.approx(best.total_return)
    assert told["alerts_by_strength"] == pytest.approx(best.rate_by_strength.sum(axis=1).tolist())
    always = content["returns"]["always"]
    assert always["alerts_by_strength"] == pytest.approx([0.0, 50.0])


def test_bad_alerts_are_told_in_a_line(tmp_path, capsys):
    out = ["--out", str(tmp_path)]
    assert main(["oracle", "--alert-strengths", "1", "0.5", *out]) == 2
    assert "alert_strengths rise within (0, 1]" in capsys.readouterr().err.splitlines()[-1]
    assert main(["oracle", "--fatigue", "0", "1", "0.5", *out]) == 2
    assert "fatigue: levels lies in 1 to" in capsys.readouterr().err.splitlines()[-1]


def test_every_command_about_teams_takes_them(tmp_path):
    for command in (["table"], ["watch"], ["train", "two-stage"]):
        parsed = parse([*command, *GRADED])
        settings = {"table": "table", "train": "protocol"}.get(command[0])
        told = getattr(parsed, settings) if settings else parsed
        assert told.alert_strengths == (0.5, 1.0)
        assert told.fatigue == (20, 5, 1.0)
    clip = tmp_path / "clip.gif"
    assert main(["watch", "--duration", "0.4", *GRADED, "--out", str(clip)]) == 0
    assert clip.stat().st_size > 1000
