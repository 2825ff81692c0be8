"""An experiment of one's own: this file, and one line that registers it."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure as Drawing

from hmi_marl.agents.catalogue import make_driver_policy, make_hmi
from hmi_marl.checks import Count
from hmi_marl.cli import main
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.streams import Seed, episode_seed
from hmi_marl.experiments.episodes import play_episodes
from hmi_marl.experiments.experiment import Experiment, Place, with_seed
from hmi_marl.experiments.registry import EXPERIMENTS, Where
from hmi_marl.reporting import statistics
from hmi_marl.reporting.blocks import Block, Figure, Table
from hmi_marl.reporting.drawing import png
from hmi_marl.reporting.statistics import Estimate
from hmi_marl.reporting.verdicts import EPISODES, Part, Verdict
from hmi_marl.reproduction.suite import full_suite

HELP = "Measure how much less distracted a driver is with alerts."


@dataclass(frozen=True)
class Alerting(Experiment[dict[str, Estimate]]):
    """Measure how much less distracted a driver is with alerts."""

    driver: str = "homer"
    """Driver at the wheel."""
    episodes: Count = 64
    """Episodes with each HMI."""
    seed: Seed = 0
    """Seed of the first episode."""

    name = "alerting"
    title = "Alerts against distraction"

    @classmethod
    def quick(cls) -> "Alerting":
        return cls(episodes=8)

    def run(self, place: Place) -> dict[str, Estimate]:
        team = TeamConfig(driver=self.driver, duration=4.0)
        seeds = episode_seed(self.seed, np.arange(self.episodes))
        found = {}
        for hmi in place.each(("never", "optimal"), "HMIs"):
            seats = make_driver_policy("rule", team), make_hmi(hmi, team)
            played = play_episodes(team, *seats, seeds, world="batched")
            found[hmi] = played.distracted / played.length
        less = statistics.mean(found["never"] - found["optimal"])
        return {hmi: statistics.mean(values) for hmi, values in found.items()} | {"less": less}

    def numbers(self, results: dict[str, Estimate]) -> dict[str, Any]:
        return {"distracted": {hmi: found.as_json() for hmi, found in results.items()}}

    def judge(self, results: dict[str, Estimate]) -> list[Verdict]:
        less = Part.mean("less", results["less"], EPISODES, paired=True, above=0.0)
        return [Verdict("alerts reduce distraction", (less,))]

    def blocks(self, results: dict[str, Estimate]) -> Sequence[Block]:
        drawing = Drawing(figsize=(3, 2))
        drawing.subplots().bar(list(results), [found.mean for found in results.values()])
        rows = [[hmi, found.percent()] for hmi, found in results.items()]
        return [
            Figure("distracted", "share of distracted steps by HMI", png(drawing)),
            Table("Distracted steps", ["HMI", "share [%]"], rows),
        ]


@pytest.fixture
def registered(monkeypatch: pytest.MonkeyPatch) -> None:
    for kept in ("_entries", "_by_alias"):
        monkeypatch.setattr(EXPERIMENTS, kept, dict(getattr(EXPERIMENTS, kept)))
    EXPERIMENTS.register("alerting", HELP, Where(f"{__name__}:Alerting", needs=()))


@pytest.mark.usefixtures("registered")
def test_it_runs_by_name_and_writes_its_report(tmp_path: Path, capsys) -> None:
    out = tmp_path / "out"
    command = ["reproduce", "alerting", "--quick", "--seed", "3", "--workers", "1"]
    assert main([*command, "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "alerts reduce distraction" in printed
    assert f"the page: {(out / 'index.html').resolve().as_uri()}" in printed
    assert {path.name for path in out.iterdir()} == {
        *("alerting.txt", "alerting.json", "distracted.png", "index.html")
    }
    content = json.loads((out / "alerting.json").read_text("utf-8"))
    assert content["settings"] == {"driver": "homer", "episodes": 8, "seed": 3}
    assert content["distracted"]["optimal"]["mean"] < content["distracted"]["never"]["mean"]
    (verdict,) = content["verdicts"]
    assert verdict["outcome"] == "supported"
    page = (out / "index.html").read_text("utf-8")
    for shown in ("Alerts against distraction", "alerts reduce distraction", "data:image/png"):
        assert shown in page
    assert (out / "alerting.txt").read_text("utf-8").strip() in printed


@pytest.mark.usefixtures("registered")
def test_it_is_listed_and_takes_its_settings_and_no_others(tmp_path: Path, capsys) -> None:
    with pytest.raises(SystemExit) as stop:
        main(["reproduce", "--help"])
    assert stop.value.code == 0
    assert "alerting" in capsys.readouterr().out
    with pytest.raises(SystemExit):
        main(["reproduce", "alerting", "--help"])
    listed = capsys.readouterr().out
    assert HELP in " ".join(listed.split())
    assert "--driver STR" in listed
    assert "--driver-run" not in listed
    assert main(["reproduce", "alerting", "--quick", "--episodes", "9"]) == 2
    assert "--quick sets the sizes itself" in capsys.readouterr().err


@pytest.mark.usefixtures("registered")
def test_it_is_a_part_of_the_whole_reproduction() -> None:
    assert full_suite()[-1] == Alerting()
    assert full_suite(quick=True, seed=2)[-1] == Alerting(episodes=8, seed=2)


def test_what_is_not_registered_is_not_known(capsys) -> None:
    with pytest.raises(SystemExit):
        main(["reproduce", "alerting"])
    assert "unknown subcommand of reproduce 'alerting'" in capsys.readouterr().err
    assert "alerting" not in [experiment.name for experiment in full_suite()]


def test_an_experiment_is_refused_under_another_name(registered: None, capsys) -> None:
    EXPERIMENTS.register("other", HELP, Where(f"{__name__}:Alerting", needs=()))
    assert main(["reproduce", "other", "--quick"]) == 2
    assert "set Alerting.name = 'other', as it is registered" in capsys.readouterr().err


def test_one_without_a_seed_runs_as_it_is() -> None:
    @dataclass(frozen=True)
    class Plain(Experiment[int]):
        episodes: int = 3
        name = "plain"
        title = "Plain"

        @classmethod
        def quick(cls) -> "Plain":
            return cls(1)

        def run(self, place: Place) -> int:
            return self.episodes

        def numbers(self, results: int) -> dict[str, Any]:
            return {"episodes": results}

        def blocks(self, results: int) -> Sequence[Block]:
            return ()

    assert with_seed(Plain(), 7) == Plain()
