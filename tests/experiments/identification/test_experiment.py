import json
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from cited import missing
from trait_models import save_driver

from hmi_marl.cli import main
from hmi_marl.envs.drivers import PAPER_DRIVERS, TRAIT_NAMES
from hmi_marl.exact.evidence_by_source import SOURCES
from hmi_marl.exact.importance import Sampling
from hmi_marl.experiments.experiment import Place
from hmi_marl.experiments.identification.experiment import CONTROL_RUN, DriverIdentification
from hmi_marl.experiments.identification.report import (
    CONTROL,
    TRAINED,
    IdentificationResults,
    in_short,
)
from hmi_marl.experiments.identification.scoring import POOL, SECONDS, NamedRow, Read
from hmi_marl.experiments.latent_traits.posterior import (
    PosteriorRow,
    TraitScore,
    evaluate_posteriors,
)
from hmi_marl.experiments.metrics_table.experiment import MetricsTable
from hmi_marl.reporting.blocks import Verdicts, as_text
from hmi_marl.reporting.statistics import Estimate, share


def difference(mean: float) -> Estimate:
    return Estimate(mean, mean - 0.02, mean + 0.02, 0.01, 4000)


def results(alone: float = 0.4, first: float = 0.1, last: float = 0.06, left: float = 0.96):
    """Made-up results with these differences, and this share named with the control."""
    gains = {("intended", 20.0): alone, ("hidden", 1.0): first, ("hidden", 20.0): last}
    control = share(round(4000 * left), 4000)
    named = [
        NamedRow(
            Read(source, seconds, 1),
            share(3800, 4000),
            control,
            difference(gains.get((source, seconds), 0.0)),
        )
        for source in SOURCES
        for seconds in SECONDS
    ]
    score = TraitScore(Estimate(0.9, 0.8, 0.95), (), ())
    row = PosteriorRow("hidden-known", POOL, 20.0, 3, dict.fromkeys(TRAIT_NAMES, score), 9.0, 1.0)
    return IdentificationResults(named, (), {TRAINED: row, CONTROL: row})


def outcomes(**made: float) -> list[str]:
    return [str(v.outcome) for v in DriverIdentification().judge(results(**made))]


def test_verdicts_follow_the_numbers() -> None:
    assert outcomes() == ["supported"] * 4
    assert outcomes(last=0.01)[2] == "undetermined"
    assert outcomes(first=-0.1, alone=-0.1)[:2] == ["not supported"] * 2
    assert outcomes(left=0.88)[3] == "not supported"
    assert outcomes(left=0.9)[3] == "undetermined"


def test_the_report_says_which_part_is_the_reaction() -> None:
    text = in_short(results())
    assert "names 95.0 % of the drivers with the policy that reads all traits, and 96.0 %" in text
    assert "6.0 points are the network's reaction to β, α and η" in text
    assert "After 1 s it is 95.0 and 96.0 %, 10.0 points" in text
    experiment = DriverIdentification()
    shown = as_text([*experiment.blocks(results()), Verdicts(experiment.judge(results()))])
    assert "v with a^H hidden, by both" in shown
    assert "+40.0 [+38.0, +42.0]" in shown
    assert "0.90 [0.80, 0.95]" in shown
    assert not missing(experiment.blocks(results()), experiment.numbers(results()))


def test_the_control_is_learned_as_the_papers_table_learns_its_driver(tmp_path: Path) -> None:
    experiment = DriverIdentification(driver_steps=500, num_teams=16, seed=3)
    job = experiment.control_job(tmp_path)
    table = MetricsTable(driver_steps=500, num_teams=16, seed=3).driver_job(tmp_path)
    assert replace(job.settings, condition="traits") == table.settings
    assert DriverIdentification().driver_job(tmp_path) == MetricsTable().driver_job(tmp_path)
    (phase,) = job.settings.phases()
    reads = [name for name, _ in phase.cards[0].reads]
    assert reads[-1] == "inflation"
    assert "traits" not in reads
    save_driver(job.folder)
    (agent,) = experiment.agents(Place(tmp_path, tmp_path))
    assert (agent.name, agent.card) == (CONTROL_RUN, tmp_path / CONTROL_RUN / "driver.json")


@pytest.mark.usefixtures("trained_here")
def test_the_command_learns_the_control_and_compares(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    here: Any = lambda function, tasks, workers: (function(*task) for task in tasks)  # noqa: E731
    monkeypatch.setattr("hmi_marl.experiments.identification.experiment.calls", here)
    few = partial(evaluate_posteriors, sampling=Sampling(groups=16, most_rounds=4, effective=5))
    monkeypatch.setattr("hmi_marl.experiments.identification.scoring.evaluate_posteriors", few)
    save_driver(tmp_path / "driver")
    size = ["--driver-steps", "1600", "--num-teams", "16", "--windows", str(POOL)]
    size += ["--strangers", "3", "--episodes", "4", "--workers", "1"]
    where = ["--driver-run", str(tmp_path / "driver"), "--out", str(tmp_path / "out")]
    assert main(["reproduce", "identify", *size, *where]) == 0
    numbers = json.loads((tmp_path / "out" / "identify.json").read_text())
    assert [row["driver"] for row in numbers["driving"]] == list(PAPER_DRIVERS)
    assert {row["source"] for row in numbers["named"]} == set(SOURCES)
    assert set(numbers["posteriors"]) == {TRAINED, CONTROL}
    assert len(numbers["verdicts"]) == 4
    card = json.loads((tmp_path / "out" / CONTROL_RUN / "driver.json").read_text())
    assert card["reads"][-1] == ["inflation", 1]
    assert "Who drives, by what is read" in capsys.readouterr().out
