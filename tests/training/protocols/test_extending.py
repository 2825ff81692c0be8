"""A protocol of one's own is one new file and one line that registers it."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from hmi_marl.training.protocols.registry import PROTOCOLS, compared, name_of, register
from hmi_marl.training.protocols.settings import Budget, TrainSettings
from hmi_marl.training.protocols.two_stage import TwoStage

NEW_FILE = '''
from dataclasses import dataclass
from typing import Any, Self

from hmi_marl.envs.config import DRIVER, VEHICLE_AI
from hmi_marl.training.protocols.settings import LEARNED, Budget, Phase, TrainSettings


@dataclass(frozen=True)
class Reversed(TrainSettings):
    """Reversed: an HMI for the rule driver, then a driver with that HMI.

    Example: hmi-marl train reversed
    """

    hmi_steps: int = 1_000_000
    """Environment steps of the HMI."""
    driver_steps: int = 1_000_000
    """Environment steps of the driver."""

    def phases(self) -> tuple[Phase, ...]:
        team = self.team(self.drivers, "individual")
        hmi, driver = self.card(VEHICLE_AI, team), self.card(DRIVER, team)
        return (
            Phase("hmi", VEHICLE_AI, team, self.hmi_steps, "rule", (hmi,)),
            Phase("driver", DRIVER, team, self.driver_steps, LEARNED, (driver,)),
        )

    @classmethod
    def for_comparison(cls, budget: Budget, **shared: Any) -> Self:
        return cls(hmi_steps=budget.hmi_steps, driver_steps=budget.driver_steps, **shared)
'''
ONE_LINE = 'register("reversed", Reversed)'
USED = """
import contextlib, io, json, sys
from new_protocol import Reversed
from hmi_marl.training.protocols.registry import register
{line}
from hmi_marl.cli import main

def told(words):
    with contextlib.redirect_stdout(io.StringIO()) as out, contextlib.redirect_stderr(out):
        try:
            status = main(words.split())
        except SystemExit as stop:
            status = stop.code
    return status or 0, " ".join(out.getvalue().replace("│", " ").split())

if __name__ == "__main__":
    print(json.dumps([told(words) for words in sys.argv[1:]]))
"""
SIZE = "--num-teams 16 --duration 1 --vehicles 1 2"


@pytest.fixture
def commands(tmp_path: Path):
    """Runs ``hmi-marl`` with the new protocol, several times in a process of their own."""
    (tmp_path / "new_protocol.py").write_text(NEW_FILE)
    (tmp_path / "use.py").write_text(USED.format(line=ONE_LINE))

    def run(*lines: str, last: int = 0) -> list[str]:
        program = [sys.executable, "use.py", *lines]
        done = subprocess.run(program, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        found = json.loads(done.stdout)
        statuses, printed = zip(*found, strict=True)
        assert statuses == (*[0] * (len(lines) - 1), last), printed
        return list(printed)

    return run


@pytest.mark.usefixtures("unmeasured")
@pytest.mark.slow
def test_it_is_trained_and_offered_by_help_and_by_errors(commands, tmp_path: Path) -> None:
    overview, own, _, wrong = commands(
        "train --help",
        "train reversed --help",
        f"train reversed --hmi-steps 1 --driver-steps 1 --device cpu --processes 1 {SIZE}",
        "train revesed",
        last=2,
    )
    assert "reversed" in overview
    assert "Reversed: an HMI for the rule driver, then a driver with that HMI." in overview
    assert "--hmi-steps" in own
    assert "did you mean reversed?" in wrong
    folder = tmp_path / "runs" / "reversed"
    assert json.loads((folder / "run.json").read_text())["protocol"] == "Reversed"
    curve = json.loads((folder / "curve.json").read_text())
    assert [row["phase"] for row in curve] == ["hmi", "driver"]
    assert (folder / "driver.json").is_file()
    assert (folder / "vehicle_ai.json").is_file()


@pytest.mark.slow
def test_it_is_compared_with_the_others(commands, tmp_path: Path) -> None:
    words = (
        "compare --tasks seen --protocols two-stage reversed --steps 160 --budgets --rounds 1 "
        f"--seeds 1 --driver-shares 0.5 --snapshots 1 --episodes 16 --cross-episodes 16 {SIZE}"
    )
    for printed in commands("compare --help", f"{words} --no-crash-check --workers 1 --out out"):
        assert "reversed" in printed
    runs = [tmp_path / "out" / "seen" / f"{name}-run0" for name in ("two-stage", "reversed")]
    steps = [json.loads((run / "curve.json").read_text())[-1]["steps"] for run in runs]
    assert steps[0] == steps[1]


def test_one_without_a_budget_is_trained_but_not_compared(commands, tmp_path: Path) -> None:
    without = NEW_FILE.partition("    @classmethod")[0]
    (tmp_path / "new_protocol.py").write_text(without)
    trained, compared, wrong = commands(
        "train --help", "compare --help", "compare --protocols reversed", last=2
    )
    assert "reversed" in trained
    assert "two-stage" in compared
    assert "unknown protocol 'reversed'" in wrong


def test_the_terms_of_its_driver_follow_from_its_phases() -> None:
    space: dict = {}
    exec(NEW_FILE, space)
    settings = space["Reversed"].for_comparison(Budget(100, 20), seed=3)
    assert (settings.driver_steps, settings.hmi_steps, settings.seed) == (100, 20, 3)
    assert settings.driver_terms[-1] == "distraction"
    assert "alert" not in settings.driver_terms
    assert TwoStage(driver_policy="rule").driver_terms == ()


def test_names_are_taken_once_and_classes_are_described() -> None:
    with pytest.raises(ValueError, match="already a protocol called 'joint'"):
        register("joint", TwoStage)

    class Silent(TrainSettings):
        pass

    Silent.__doc__ = None
    with pytest.raises(ValueError, match="Silent needs a docstring"):
        register("silent", Silent)
    assert list(PROTOCOLS) == ["two-stage", "joint", "simultaneous", "alternating", "fine-tune"]
    assert list(compared()) == [
        "two-stage",
        "joint",
        "simultaneous",
        "simultaneous-moves",
        "alternating",
        "fine-tune",
    ]
    assert [name_of(entry.value) for entry in PROTOCOLS.values()] == list(PROTOCOLS)


@pytest.mark.parametrize("name", PROTOCOLS)
def test_a_budget_is_used_up_with_the_reward_that_is_given(name: str) -> None:
    protocol, budget = PROTOCOLS[name].value, Budget(24_000, 8_000, rounds=4, batch=80)
    settings = protocol.for_comparison(budget, num_teams=16, duration=1.0)
    assert sum(phase.steps for phase in settings.phases()) == budget.steps == 32_000
    given = protocol.for_comparison(Budget(24_000, 8_000, 4, "attention"), num_teams=16)
    rewards = [phase.team.reward for phase in given.phases()]
    stages = {"two-stage": rewards, "fine-tune": rewards[:-1]}.get(name, [])  # always the paper's
    assert stages in ([], ["driving", "team"])
    assert set(rewards[len(stages) :]) <= {"attention"}


def test_a_protocol_has_to_say_how_it_is_compared() -> None:
    with pytest.raises(NotImplementedError, match="how it uses a budget"):
        TrainSettings.for_comparison(Budget(1, 1))
