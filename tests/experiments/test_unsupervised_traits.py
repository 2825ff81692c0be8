"""The experiment "unsupervised": settings of the ways, verdicts, report, and tiny trainings."""

from dataclasses import dataclass, replace

import pytest
from cited import missing
from trait_models import save_driver

from hmi_marl.experiments import unsupervised_traits as module
from hmi_marl.experiments.experiment import Place, conduct
from hmi_marl.experiments.unsupervised_traits import (
    BY_NAME,
    WAYS,
    Named,
    UnsupervisedTraits,
    Way,
    WaysResults,
)
from hmi_marl.reporting.statistics import share
from hmi_marl.training.traits.settings import LossWeights, TraitSettings


def named(right: int, labelled: bool = False) -> Named:
    found = share(right, 300)
    return Named("some", f"way {right}", labelled, 64.0, 1e6, 314.0, 2.0, found, found, 14.3)


def test_ways_are_the_papers_setting_with_few_changes():
    experiment = UnsupervisedTraits(seed=4)
    base = TraitSettings(supervision="none", imitation_updates=600, seed=4)
    assert experiment.training(BY_NAME["paper"]) == base
    assert experiment.training(BY_NAME["imitate-8"]) == replace(
        base, latent=8, weights=LossWeights(imitate=1.0)
    )
    assert experiment.training(BY_NAME["id"]) == replace(base, supervision="id")
    for name in ("paper-full", "paper-8-cars-full"):
        full = experiment.training(BY_NAME[name])
        assert full.rounds(100) == 2000  # and 4,000 updates, as the paper's text has them
        assert full.rounds(100) * full.updates == 4000
    assert base.rounds(100) == 157
    assert len({way.name for way in WAYS}) == len(WAYS)


def test_settings_that_cannot_be_are_refused():
    with pytest.raises(ValueError, match="'nope' is none of paper, cohesion"):
        UnsupervisedTraits(ways=("nope",))
    with pytest.raises(ValueError, match="one or more different ones"):
        UnsupervisedTraits(ways=("paper", "paper"))
    with pytest.raises(ValueError, match="at least 16000 steps to judge z of size 2 by, but got 1"):
        UnsupervisedTraits(ways=("paper",), demonstrated=15_900)
    with pytest.raises(ValueError, match="at least 40000 steps to judge z of size 8"):
        UnsupervisedTraits(ways=("latent-8",), demonstrated=16_000)
    UnsupervisedTraits.quick()


def test_ways_without_labels_are_judged():
    results = WaysResults([named(212), named(300), named(272), named(299, labelled=True)], None)
    verdicts = UnsupervisedTraits(seeds=1).judge_of(results)
    outcomes = [str(verdict.outcome) for verdict in verdicts]
    assert outcomes == ["not supported", "supported", "undetermined"]


def test_every_number_of_the_report_has_its_source():
    results = WaysResults([named(212), named(299, labelled=True)], share(300, 300))
    experiment = UnsupervisedTraits(seeds=1)
    blocks = experiment.blocks_of(results)
    assert not missing(blocks, experiment.numbers_of(results))
    assert "exact: 100.0" in blocks[1].as_text()


@dataclass(frozen=True)
class Short(UnsupervisedTraits):
    """One round on windows of a second."""

    def dataset(self, place):
        steps = self.demonstrated // 20
        return replace(super().dataset(place), steps=steps, duration=1.0, vehicles=(1, 2))

    def training(self, way: Way) -> TraitSettings:
        return replace(super().training(way), average_updates=1, imitation_updates=1)


@pytest.fixture
def here(monkeypatch):
    """Learn in this process."""

    def learn(tasks, workers, cluster):
        for task in tasks:
            task.go()

    monkeypatch.setattr(module, "side_by_side", learn)


@pytest.mark.usefixtures("here")
def test_ways_are_learned_judged_and_not_learned_twice(tmp_path):
    driver = save_driver(tmp_path / "driver")
    short = Short(ways=("paper", "imitate"), demonstrated=16_000, steps=1, seeds=2)
    place = Place(tmp_path / "out", driver)
    report = conduct(short, place)
    assert [way["name"] for way in report.numbers["ways"]] == ["paper", "imitate"]
    assert len(report.numbers["by_seed"]) == 2
    for way in report.numbers["ways"]:
        assert 0.0 <= way["drivers"]["mean"] <= 1.0
        assert way["updates"] == 2.0
    assert report.numbers["exact"]["mean"] <= 1.0
    runs = [p for p in (tmp_path / "out").iterdir() if (p / "traits.json").is_file()]
    assert len(runs) == 4
    before = {path: (path / "checkpoint.safetensors").stat().st_mtime_ns for path in runs}
    again = conduct(short, place)
    assert again.numbers["ways"] == report.numbers["ways"]
    assert before == {p: (p / "checkpoint.safetensors").stat().st_mtime_ns for p in runs}
