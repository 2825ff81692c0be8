import pytest

from hmi_marl.agents.adaptive.hmis import Trained
from hmi_marl.experiments.adaptation import evaluation
from hmi_marl.experiments.adaptation.evaluation import AdaptSettings
from hmi_marl.experiments.adaptation.experiment import Adaptation
from hmi_marl.experiments.experiment import Place
from hmi_marl.training.conditioned.settings import ConditionedSettings


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"drivers": 1}, "drivers lies in 2 to 1000000, but got 1"),
        ({"population": 0}, "population lies in 2 to 1000000, but got 0"),
        ({"changes": 1}, "changes lies in 2 to 1000000, but got 1"),
        ({"repeats": 0}, "repeats lies in 1 to"),
        ({"candidates": 0}, "candidates lies in 1 to"),
        ({"revealing": 1.1}, r"revealing lies in \[0, 1\], but got 1\.1"),
        ({"revealing": float("nan")}, r"revealing lies in \[0, 1\]"),
        ({"caution": -1.0}, "caution lies in .*, but got -1"),
        ({"seed": -1}, "a seed lies in"),
    ],
    ids=str,
)
def test_sizes_that_make_no_evaluation_are_refused(changes, told):
    with pytest.raises(ValueError, match=told):
        AdaptSettings(**changes)


def test_what_is_learned_for_it_goes_by_the_driver_that_was_learned(tmp_path):
    sizes = {"strangers": 70, "types": 9, "rounds": 4}
    size = Adaptation(drives=1000, updates=7, rnn_hidden_dim=5, seed=3, traits="t", **sizes)
    evidence, hmi = size.evidence(tmp_path), size.conditioned(tmp_path)
    assert (evidence.drives, evidence.updates, evidence.seed) == (1000, 7, 3)
    assert (hmi.strangers, hmi.types, hmi.rounds, hmi.seed) == (70, 9, 4, 3)
    assert hmi.network.rnn_hidden_dim == 5
    assert evidence.driver_policy == hmi.driver_policy == str(tmp_path)
    assert evidence.traits == hmi.traits == "t"
    assert hmi.revealing == size.evaluation.revealing
    assert hmi.batch == ConditionedSettings.batch
    few = Adaptation(strangers=5, types=1).conditioned(tmp_path)
    assert few.batch == few.trips_per_round == 2 * (5 + 4)  # a round has no more trips


@pytest.mark.parametrize("name", ["drives", "updates", "rounds", "strangers", "rnn_hidden_dim"])
def test_learning_nothing_is_refused(name):
    with pytest.raises(ValueError, match=f"{name} lies in 1 to"):
        Adaptation(**{name: 0})


def test_each_seed_reads_the_traits_that_the_same_seed_of_its_reproduction_has_learned(tmp_path):
    place, size = Place(tmp_path / "adapt", tmp_path), Adaptation(seeds=3)

    def read():
        return [alone.traits for alone, _ in size.by_seed(place)]

    assert read() == [Trained.traits] * 3  # by itself it reads the model of the package
    for run in ("traits-self", "traits-self-2"):
        (tmp_path / "traits" / run).mkdir(parents=True)
    first, third = (str(tmp_path / "traits" / run) for run in ("traits-self", "traits-self-2"))
    assert read() == [first, first, third]
    (other, *_) = Adaptation(seeds=3, traits="other").by_seed(place)
    assert other[0].traits == "other"


def test_each_seed_is_played_with_what_it_has_learned(tmp_path, monkeypatch):
    place, size = Place(tmp_path / "adapt", tmp_path / "driver", workers=2), Adaptation(seeds=3)
    asked = {}

    def evaluate(plays, trained, workers, progress):
        asked.update(trained=trained, policies={each.driver_policy for each in plays})
        return [str(number) for number in range(len(trained))]

    monkeypatch.setattr(evaluation, "evaluate", evaluate)
    each = size.by_seed(place)
    assert size.play_each(each, place) == ["0", "1", "2"]
    assert asked["policies"] == {str(tmp_path / "driver")}
    folders = [tmp_path / "adapt" / name for name in ("", "seed-1", "seed-2")]
    for trained, folder in zip(asked["trained"], folders, strict=True):
        assert trained.evidence == str(folder / "evidence")
        assert trained.conditioned == str(folder / "conditioned")
    third, where = each[2]
    assert third.play(where) == "0"
    assert asked["trained"][0].evidence == str(folders[2] / "evidence")
