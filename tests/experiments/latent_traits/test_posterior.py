import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cited import missing_in, reports_written
from trait_models import save_driver

from hmi_marl.demonstrations.dataset import Demonstrations
from hmi_marl.demonstrations.parquet import write_demonstrations
from hmi_marl.demonstrations.recording import CollectSettings, collect
from hmi_marl.exact.importance import Sampling
from hmi_marl.exact.trait_posterior import TraitPosterior, trait_posterior
from hmi_marl.experiments.experiment import Place, conduct
from hmi_marl.experiments.latent_traits.ceiling import NoCeilingError
from hmi_marl.experiments.latent_traits.posterior import (
    CASES,
    PosteriorEvaluation,
    evaluate_posteriors,
    judge_posteriors,
)

FEW = Sampling(groups=16, rounds=1, most_rounds=2, effective=5)


@pytest.fixture(scope="module")
def population(tmp_path_factory: pytest.TempPathFactory) -> Demonstrations:
    """Four people with three windows of two seconds each."""
    folder = save_driver(tmp_path_factory.mktemp("driver"), 0)
    settings = CollectSettings(
        drivers=(),
        population=4,
        windows=3,
        duration=2.0,
        vehicles=(1, 8),
        driver_policy=str(folder),
        num_teams=100,
    )
    (data,) = collect(settings)
    return data


def certain(traits: list[float]) -> TraitPosterior:
    return TraitPosterior(np.array([traits]), np.ones(1), 0.0, 1.0, 1, True)


def test_scores_by_hand() -> None:
    true = np.array([[0.0, 0.2, 0.1, 1.0], [0.5, 0.4, 0.2, 5.0], [1.0, 0.6, 0.3, 9.0]])
    found = [certain(own) for own in true.tolist()]
    perfect = judge_posteriors(found, true)
    assert {score.r2.mean for score in perfect.values()} == {1.0}
    # Ranks of what is equal are one half.
    assert {score.ranks for score in perfect.values()} == {(0, 0, 0, 0, 0, 3, 0, 0, 0, 0)}
    average = [certain(true.mean(axis=0).tolist())] * 3
    scores = judge_posteriors(average, true)
    assert scores["beta"].r2.mean == pytest.approx(0.0)
    assert scores["beta"].r2.low <= 0.0 <= scores["beta"].r2.high
    # The first is below its point, the last above, and the second is met.
    assert scores["beta"].ranks == (1, 0, 0, 0, 0, 1, 0, 0, 0, 1)
    assert [each.mean for each in scores["beta"].coverage] == pytest.approx([1 / 3] * 3)
    with pytest.raises(ValueError, match="same 3 or more drivers, not 2 posteriors of 3"):
        judge_posteriors(average[:2], true)


@pytest.mark.parametrize("case", CASES)
def test_the_first_windows_of_each_driver_are_judged(population: Demonstrations, case: str) -> None:
    row = evaluate_posteriors(population, case, 2, sampling=FEW)
    assert (row.case, row.windows, row.seconds, row.drivers) == (case, 2, 2.0, 4)
    observed, truth = population.observed, population.truth
    assert truth is not None
    rows = np.flatnonzero(observed.number < 2)
    from hmi_marl.demonstrations.env import team_of
    from hmi_marl.experiments.latent_traits.ceiling import driver_policy_of

    config, known = team_of(observed), CASES[case]
    found = trait_posterior(
        config,
        driver_policy_of(observed, None, config) if known.policy else None,
        observed.seeds[rows] if observed.seeds is not None else None,
        observed.actions[rows],
        observed.alerts[rows],
        observed.length[rows],
        intended=truth.intended[rows] if known.intent else None,
        person=observed.driver[rows],
        sampling=FEW,
    )
    assert row.traits == judge_posteriors(found, truth.traits[rows][::2])


def test_a_part_of_a_window_is_all_that_is_read(population: Demonstrations) -> None:
    row = evaluate_posteriors(population, "seen-unknown", 1, 0.8, sampling=FEW)
    assert row.seconds == 0.8
    later = population.observed.actions.copy()
    later[:, 4:] = 0  # possible, though no driver did so
    other = Demonstrations(replace(population.observed, actions=later), population.truth)
    assert evaluate_posteriors(other, "seen-unknown", 1, 0.8, sampling=FEW) == row


def test_data_that_cannot_be_judged_are_refused(population: Demonstrations) -> None:
    observed = population.observed
    with pytest.raises(ValueError, match="true traits, which these data do not hold"):
        evaluate_posteriors(Demonstrations(observed))
    with pytest.raises(ValueError, match="only 0 drivers have 4 windows; collect more"):
        evaluate_posteriors(population, windows=4)
    with pytest.raises(ValueError, match="case is one of hidden-known"):
        evaluate_posteriors(population, "known")
    about: dict[str, Any] = {**observed.about, "hmi": "optimal"}
    chosen = Demonstrations(replace(observed, about=about), population.truth)
    with pytest.raises(NoCeilingError, match="alerts at random"):
        evaluate_posteriors(chosen)
    about = {**observed.about, "driver_policy": {"name": "rule"}}
    driven_by_another = Demonstrations(replace(observed, about=about), population.truth)
    with pytest.raises(NoCeilingError, match="takes a learned driver policy"):
        evaluate_posteriors(driven_by_another)


def test_an_evaluation_says_what_it_lacks(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="each of windows lies in 1 to"):
        PosteriorEvaluation(tmp_path, windows=(0,))
    with pytest.raises(ValueError, match="each of seconds lies in"):
        PosteriorEvaluation(tmp_path, seconds=(0.0,))
    with pytest.raises(ValueError, match="each of cases is one of hidden-known"):
        PosteriorEvaluation(tmp_path, cases=("known",))
    with pytest.raises(ValueError, match="names its demonstrations"):
        PosteriorEvaluation.quick()


def test_what_cannot_be_judged_leaves_no_folder(population: Demonstrations, tmp_path: Path) -> None:
    data, out = tmp_path / "data", tmp_path / "out"
    with pytest.raises(FileNotFoundError, match="hmi-marl collect"):
        conduct(PosteriorEvaluation(data), Place(out, out))
    observed = population.observed
    by_rule = {**observed.about, "driver_policy": {"name": "rule"}}
    ruled = replace(population, observed=replace(observed, about=by_rule))
    for lacking, windows, message in (
        (Demonstrations(observed), 1, "true traits, which these data do not hold"),
        (population, 16, "only 0 drivers have 16 windows"),
        (ruled, 1, "a learned driver policy"),
    ):
        write_demonstrations(data, lacking)
        with pytest.raises(ValueError, match=message):
            conduct(PosteriorEvaluation(data, windows=(windows,)), Place(out, out))
        assert not out.exists()


def test_the_command_prints_tables_and_writes_json(
    population: Demonstrations,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    pytest.importorskip("pyarrow")
    from hmi_marl.cli import main
    from hmi_marl.demonstrations.parquet import write_demonstrations

    monkeypatch.chdir(tmp_path)
    write_demonstrations(tmp_path / "data", population)
    few = "--sampling.groups 16 --sampling.rounds 1 --sampling.most-rounds 2"
    command = f"traits posterior --demonstrations data --windows 3 --seconds 1 --out out {few}"
    command += " --cases hidden-known seen-unknown"
    with reports_written() as reports:
        assert main(command.split()) == 0
    assert [missing_in(report) for report in reports] == [[]]
    printed = capsys.readouterr().out
    assert "R² of the posterior mean: a^H hidden, driver policy known" in printed
    assert "a^H seen, driver policy unknown" in printed
    content = json.loads((tmp_path / "out" / "trait-posterior.json").read_text("utf-8"))
    assert [(row["case"], row["windows"], row["seconds"]) for row in content["rows"]] == [
        ("hidden-known", 1, 1.0),
        ("hidden-known", 3, 2.0),
        ("seen-unknown", 1, 1.0),
        ("seen-unknown", 3, 2.0),
    ]
    assert content["levels"] == [0.5, 0.8, 0.95]
    assert sum(content["rows"][0]["traits"]["beta"]["ranks"]) == 4
