"""The experiment "ablations": settings, figure, report, and the command on a few strangers."""

import json
from dataclasses import replace
from functools import partial
from pathlib import Path

import matplotlib.figure
import pytest
from cited import missing
from trait_models import save_driver

from hmi_marl.cli import main
from hmi_marl.envs.drivers import TRAIT_NAMES
from hmi_marl.exact.importance import Sampling
from hmi_marl.experiments.experiment import Place
from hmi_marl.experiments.training_seeds import over_seeds
from hmi_marl.experiments.trait_ablations import exact
from hmi_marl.experiments.trait_ablations import experiment as running
from hmi_marl.experiments.trait_ablations.experiment import PARTS, RECORDINGS, TraitAblations
from hmi_marl.experiments.trait_ablations.figure import draw
from hmi_marl.experiments.trait_ablations.judging import JUDGED, MANY, NAMED, STRANGERS, score
from hmi_marl.experiments.trait_ablations.rows import AblationResults, Row
from hmi_marl.experiments.trait_ablations.variants import AXES, BY_NAME
from hmi_marl.reporting.statistics import Estimate, share

PLACE = Place(Path("out"), Path("driver"))


def row(axis: str, what: str, mean: float, default: bool = False) -> Row:
    r2 = {
        trait: Estimate(mean + 0.01 * k, mean - 0.1, mean + 0.1, 0.05, 30)
        for k, trait in enumerate(TRAIT_NAMES)
    }
    return Row(axis, what, default, r2, r2, r2, share(17, 20))


ROWS = [
    row("loss", "posteriors", 0.8, True),
    row("loss", "cosine", 0.7),
    row("strangers", "100", 0.4),
    row("strangers", "2000", 0.8, True),
    row("pool", "8", 0.8, True),
]

EXACT = {trait: Estimate(0.91, 0.88, 0.94, 0.015, 40) for trait in TRAIT_NAMES}
RESULTS = AblationResults(ROWS, EXACT)


@pytest.fixture
def here(monkeypatch):
    """Work in this process."""
    monkeypatch.setattr(running, "calls", lambda f, tasks, workers: (f(*task) for task in tasks))


@pytest.fixture
def few_points(monkeypatch):
    """Compute exact posteriors coarsely."""
    few = Sampling(8, 1, most_rounds=1, effective=4)
    coarse = partial(exact.evaluate_posteriors, sampling=few)
    monkeypatch.setattr(exact, "evaluate_posteriors", coarse)


def test_settings_that_cannot_be_are_refused():
    with pytest.raises(ValueError, match="'nope' is none of baseline, loss-distance"):
        TraitAblations(variants=("baseline", "nope"))
    with pytest.raises(ValueError, match="'baseline' among them"):
        TraitAblations(variants=("latent-2",))
    with pytest.raises(ValueError, match="windows is at least 8 for 'windows-8', but got 4"):
        TraitAblations(windows=4)
    TraitAblations(variants=("baseline", "latent-2"), windows=4)
    with pytest.raises(ValueError, match="0, or 3 to 20, not 21"):
        TraitAblations(judged=40, posteriors=21)
    TraitAblations.quick()


def test_every_variant_learns_from_the_first_of_one_population():
    whole = TraitAblations()
    sets = whole.datasets(PLACE)
    assert list(sets) == [NAMED, JUDGED, STRANGERS, MANY]
    assert (sets[STRANGERS].population, sets[MANY].population) == (2000, 10_000)
    assert sets[STRANGERS].seed == sets[MANY].seed
    assert len({sets[name].seed for name in (NAMED, JUDGED, STRANGERS)}) == 3
    few = TraitAblations(variants=("baseline", "strangers-300"))
    assert list(few.datasets(PLACE)) == [NAMED, JUDGED, STRANGERS]
    parts = {name: whole.trial(each) for name, each in BY_NAME.items()}
    assert {n for n, p in parts.items() if p.dataset == MANY} == {
        "strangers-5000",
        "strangers-10000",
    }
    assert parts["strangers-300"].strangers == 300
    assert parts["windows-4"].windows == 4
    assert parts["latent-2"].settings.latent_size == 2
    assert parts["baseline"].settings.latent_size == 8
    assert parts["loss-cosine"].design.loss == "cosine"
    alone = [each.seed for each, _ in TraitAblations(seeds=3).by_seed(PLACE)]
    assert len(set(alone)) == 3
    assert len({each.file(BY_NAME["latent-2"], PLACE) for each, _ in whole.by_seed(PLACE)}) == 3


def test_a_cluster_is_refused(tmp_path):
    place = Place(tmp_path / "out", save_driver(tmp_path / "driver"))
    TraitAblations().check(place)
    with pytest.raises(ValueError, match="learn on this machine: leave --ray out"):
        TraitAblations().check(replace(place, cluster=object()))


def test_the_figure_has_a_panel_for_each_axis():
    drawing = draw(ROWS, EXACT, columns=2)
    assert isinstance(drawing, matplotlib.figure.Figure)
    assert [axes.get_title() for axes in drawing.axes] == [
        AXES[n] for n in ("loss", "strangers", "pool")
    ]
    numbers = drawing.axes[1].get_lines()
    beta = next(line for line in numbers if list(line.get_xdata()) == [100.0, 2000.0])
    assert list(beta.get_ydata()) == [0.4, 0.8]
    words = [label.get_text() for label in drawing.axes[0].get_xticklabels()]
    assert words == ["posteriors", "cosine"]


def test_every_number_of_the_report_has_its_source():
    experiment = TraitAblations(seeds=1)
    blocks = experiment.blocks_of(RESULTS)
    assert not missing(blocks, experiment.numbers_of(RESULTS))
    text = "\n".join(block.as_text() for block in blocks)
    assert "2000 (default)" in text
    assert "0.91 [0.88, 0.94]" in text
    without = AblationResults(ROWS, None)
    assert not missing(experiment.blocks_of(without), experiment.numbers_of(without))
    assert over_seeds([RESULTS, RESULTS]).exact == EXACT
    assert "0.70 [0.60, 0.80]" in text


@pytest.mark.usefixtures("here", "few_points")
def test_the_command_learns_judges_and_resumes(tmp_path, capsys, monkeypatch):
    driver, out = save_driver(tmp_path / "driver"), tmp_path / "out"
    command = [
        *("reproduce", "ablations", "--driver-run", str(driver), "--out", str(out)),
        *("--variants", "baseline", "loss-cosine", "--strangers", "3", "--judged", "6"),
        *("--windows", "2", "--named", "24", "--average-updates", "1", "--encoder-updates", "1"),
        *("--drivers-per-update", "2", "--seeds", "2", "--workers", "1"),
        *("--posteriors", "3"),
    ]
    assert main(command) == 0
    assert "R² of traits, by a small network" in capsys.readouterr().out
    content = json.loads((out / "ablations.json").read_text())
    assert content["training_seeds"] == 2
    assert [r["what"] for r in content["rows"][:2]] == ["posteriors", "cosine"]
    for each in content["rows"]:
        assert set(each["network"]) == set(each["linear"]) == set(TRAIT_NAMES)
        assert 0 <= each["named"]["mean"] <= 1
    assert sorted(path.name for path in (out / RECORDINGS).iterdir()) == [JUDGED, NAMED, STRANGERS]
    files = sorted(path for path in (out / PARTS).iterdir() if path.name != "exact.json")
    assert len(files) == 4
    assert set(content["exact"]) == set(TRAIT_NAMES)
    # The second time one encoder alone is learned again: the one whose file is damaged.
    files[2].write_text("{}")
    made = []

    def watched(trial, recordings, path):
        before = path.stat().st_mtime_ns
        result = score(trial, recordings, path)
        made.extend([path.name] * (path.stat().st_mtime_ns != before))
        return result

    monkeypatch.setattr(running, "score", watched)
    assert main(command) == 0
    assert made == [files[2].name]
    again = json.loads((out / "ablations.json").read_text())
    assert again["rows"] == content["rows"]
