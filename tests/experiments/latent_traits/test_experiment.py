import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from demonstrations import made_up
from trait_models import save_driver, untrained

from hmi_marl.agents.learned.trait_model import save_traits
from hmi_marl.demonstrations.parquet import (
    OBSERVED,
    TRUTH,
    read_demonstrations,
    read_observed,
    write_demonstrations,
)
from hmi_marl.demonstrations.recording import CollectSettings, collect
from hmi_marl.demonstrations.step_file import StepFile
from hmi_marl.envs.drivers import PAPER_DRIVERS
from hmi_marl.envs.streams import part_seed
from hmi_marl.experiments.experiment import Place, conduct
from hmi_marl.experiments.latent_traits import assessment, ceiling
from hmi_marl.experiments.latent_traits.assessment import Assessment
from hmi_marl.experiments.latent_traits.evaluation import SUPERVISIONS, TraitEvaluation
from hmi_marl.experiments.latent_traits.experiment import (
    DEMONSTRATIONS,
    POPULATION,
    STRANGERS,
    AssessSettings,
    LatentTraits,
)
from hmi_marl.files import sha256_of
from hmi_marl.reporting.report import Report, Stopwatch
from hmi_marl.training.traits.settings import TraitSettings

pytestmark = pytest.mark.usefixtures("few_folds")

SMALL = AssessSettings(windows=10, episodes=2, ranked=2)
TINY = LatentTraits(
    seeds=1,
    demonstrated=2000,
    strangers=3,
    population=4,
    learn=TraitSettings(pool=1, latent=2),
    evaluation=SMALL,
)


@pytest.fixture(scope="module")
def steering(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return save_driver(tmp_path_factory.mktemp("steering"))


def record(folder: Path, driver_policy: Path | str, **settings: Any) -> Path:
    small: dict[str, Any] = {"drivers": ("lisa", "homer"), "steps": 100, "duration": 1.0}
    whole = CollectSettings(
        **{"vehicles": (1, 4), **small, **settings}, driver_policy=str(driver_policy)
    )
    write_demonstrations(folder, collect(whole))
    return folder


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory, steering: Path) -> Path:
    """Twenty windows of each of two drivers."""
    return record(tmp_path_factory.mktemp("data"), steering)


@pytest.fixture(scope="module")
def population(tmp_path_factory: pytest.TempPathFactory, steering: Path) -> Path:
    people = {"drivers": (), "population": 4, "windows": 2}
    return record(tmp_path_factory.mktemp("population"), steering, **people)


def a_run(
    folder: Path,
    data: Path,
    supervision: str = "none",
    held_out: float = 0.4,
    margin: float = 2.0,
    **card: Any,
) -> Path:
    """As if it had learned from the data."""
    training = {
        "settings": {
            "supervision": supervision,
            "held_out": held_out,
            "seed": card.get("seed", 0),
            "margin": margin,
        },
        "demonstrations": sha256_of(data / OBSERVED),
    }
    model = untrained(
        read_observed(data).layout, **{"seed": 0, "pool": 2, "training": training, **card}
    )
    save_traits(folder, model.card, model.weights)
    return folder


def assess_runs(
    runs: list[Path],
    data: Path,
    population: Path | None,
    driver_policy: str | None,
    size: AssessSettings,
) -> tuple[dict[str, list[Assessment]], int]:
    evaluation = TraitEvaluation(tuple(runs), data, population, driver_policy, size)
    found = evaluation.run(Place(data, data))
    return dict(found.assessments), found.pool


def write_report(
    out: Path, runs: list[Path], data: Path, population: Path | None = None, **place: Any
) -> Report:
    evaluation = TraitEvaluation(tuple(runs), data, population, None, SMALL)
    return conduct(evaluation, Place(out, out, **place))


# What is made.


def test_every_setting_is_learned_as_often_as_there_are_seeds(tmp_path: Path) -> None:
    size = LatentTraits(seeds=2, seed=5, learn=TraitSettings(latent=3))
    jobs, second = size.trainings(tmp_path), int(part_seed(5, 1))
    assert [(path.name, job.supervision, job.seed) for path, job in jobs.items()] == [
        ("traits-none", "none", 5),
        ("traits-id", "id", 5),
        ("traits-preference", "preference", 5),
        ("traits-self", "self", 5),
        ("traits-none-1", "none", second),
        ("traits-id-1", "id", second),
        ("traits-preference-1", "preference", second),
        ("traits-self-1", "self", second),
    ]
    assert {replace(job, supervision="self", seed=0) for job in jobs.values()} == {size.learn}
    assert list(dict.fromkeys(job.supervision for job in jobs.values())) == list(SUPERVISIONS)


def test_the_population_shares_no_driver_and_no_episode_with_the_demonstrations() -> None:
    sets = TINY.datasets(Path("somewhere"))
    assert list(sets) == [DEMONSTRATIONS, POPULATION, STRANGERS]
    demonstrations, population, strangers = sets.values()
    assert demonstrations.drivers == PAPER_DRIVERS
    assert (demonstrations.population, population.drivers) == (0, ())
    assert (demonstrations.steps, population.population) == (2000, 4)
    assert (strangers.drivers, strangers.population) == ((), 3)
    assert len({each.seed for each in sets.values()}) == 3
    assert demonstrations.driver_policy == population.driver_policy == "somewhere"


@pytest.mark.parametrize(
    "name", ["driver_steps", "demonstrated", "population", "strangers", "seeds"]
)
def test_a_reproduction_of_nothing_is_refused(name: str) -> None:
    with pytest.raises(ValueError, match=f"{name} lies in 1 to"):
        LatentTraits(**{name: 0})


def test_what_a_reproduction_sets_itself_is_refused() -> None:
    for learn in (TraitSettings(supervision="id"), TraitSettings(seed=1)):
        with pytest.raises(ValueError, match=r"leave out --learn\.supervision and"):
            LatentTraits(learn=learn)
    with pytest.raises(ValueError, match="over 4 drivers or more, but got population = 3"):
        LatentTraits(population=3)
    with pytest.raises(ValueError, match="learns from two strangers or more"):
        LatentTraits(strangers=1)


def test_what_is_recorded_is_not_recorded_again(
    tmp_path: Path, steering: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    TINY.collect(steering, tmp_path)
    written = {name: read_demonstrations(tmp_path / name) for name in (DEMONSTRATIONS, POPULATION)}
    assert len(written[DEMONSTRATIONS]) == 4 * 20
    assert written[POPULATION].observed.names == tuple(f"population-{k}" for k in range(4))
    # One that was cut off before its truth was written is recorded anew.
    (tmp_path / POPULATION / TRUTH).unlink()
    before = (tmp_path / DEMONSTRATIONS / OBSERVED).stat().st_mtime_ns
    moved = save_driver(tmp_path / "moved")  # the same policy elsewhere
    TINY.collect(moved, tmp_path)
    assert (tmp_path / POPULATION / TRUTH).is_file()
    assert (tmp_path / DEMONSTRATIONS / OBSERVED).stat().st_mtime_ns == before
    # Another dataset in its place is told.
    with pytest.raises(ValueError, match=r"demonstrations holds another .*steps = 2000, now 1900"):
        replace(TINY, demonstrated=1900).collect(steering, tmp_path)
    # Too little is told before anything is learned from it.
    larger = replace(TINY, learn=TraitSettings(pool=2, latent=2))
    with pytest.raises(ValueError, match="too few windows to judge by"):
        larger.collect(steering, tmp_path)
    monkeypatch.setattr(assessment, "pool_sizes", lambda *given: (1,))
    many = replace(TINY, learn=TraitSettings(pool=32, latent=2))
    with pytest.raises(ValueError, match=r"population holds another .*windows = 16, now 64"):
        many.collect(steering, tmp_path)
    with pytest.raises(ValueError, match="recorded with another driver policy than that of"):
        TINY.collect(save_driver(tmp_path / "other", 7), tmp_path)


# Judging.


@pytest.mark.usefixtures("trained_here")
def test_runs_are_judged_by_setting_in_the_papers_order(
    tmp_path: Path, data: Path, population: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    runs = [
        a_run(tmp_path / "a", data, "id"),
        a_run(tmp_path / "b", data, "none", seed=1),
        a_run(tmp_path / "c", data, "id", seed=2),
    ]
    evaluation = TraitEvaluation(tuple(runs), data, population, None, SMALL)
    judged = evaluation.run(Place(data, data, workers=2))
    found = dict(judged.assessments)
    assert judged.pool == 2
    assert {name: len(several) for name, several in found.items()} == {"none": 1, "id": 2}
    assert list(found) == ["none", "id"]
    first, second = found["id"]
    assert first.identified[0].ceilings == second.identified[0].ceilings is not None
    assert not (first.embedding.means == second.embedding.means).all()
    assert first.reading is not None
    assert second.reading is not None
    assert second.reward_ranking
    watch = Stopwatch()
    watch.seconds["judging"] = 1.0
    monkeypatch.setattr(TraitEvaluation, "run", lambda *_: judged)
    report = write_report(tmp_path / "out", runs, data, population, watch=watch)
    out = tmp_path / "out"
    assert {path.name for path in out.iterdir()} == {
        "traits-report.txt",
        "traits-report.json",
        "embeddings.png",
        "accuracy.png",
        "index.html",
    }
    assert (out / "traits-report.txt").read_text("utf-8") == report.text + "\n"
    assert "pools of 4, 8, 16." in report.text
    assert report.seconds == {"judging": 1.0}
    assert "seconds" not in report.numbers  # which are the same however long it took
    content = json.loads((out / "traits-report.json").read_text("utf-8"))
    assert len(content["supervisions"]["id"]["seeds"]) == 2
    for name in ("embeddings.png", "accuracy.png"):
        assert (out / name).read_bytes().startswith(b"\x89PNG")
    assert "data:image/png;base64" in (out / "index.html").read_text("utf-8")


def test_strangers_may_have_taught_the_self_supervised_setting_alone(
    tmp_path: Path, data: Path, population: Path
) -> None:
    none, own = a_run(tmp_path / "a", data), a_run(tmp_path / "b", population, "self", held_out=0.0)
    found, _ = assess_runs([none, own], data, None, None, SMALL)
    assert list(found) == ["none", "self"]
    # Both name the same windows, which the first has held out.
    assert [row.pools for row in found["none"][0].identified] == [
        row.pools for row in found["self"][0].identified
    ]
    assert [row.windows for row in found["self"][0].naming] == [1, 2]
    with pytest.raises(ValueError, match=r"b has learned from .*; name a population that it has"):
        assess_runs([none, own], data, population, None, SMALL)
    none = a_run(tmp_path / "c", population)
    with pytest.raises(ValueError, match="c learned from other demonstrations than"):
        assess_runs([none], data, None, None, SMALL)


def test_the_exact_posterior_stands_beside(tmp_path: Path, data: Path, steering: Path) -> None:
    people = {"drivers": (), "population": 6, "windows": 2}
    strangers = record(tmp_path / "population", steering, **people)
    size = replace(SMALL, posteriors=3)
    evaluation = TraitEvaluation((a_run(tmp_path / "a", data),), data, strangers, None, size)
    found = evaluation.run(Place(data, data)).posterior
    assert found is not None
    assert (found.drivers, found.windows, found.case) == (3, 2, "hidden-known")
    with pytest.raises(ValueError, match="posteriors is 0, or at least 3, not 2"):
        AssessSettings(posteriors=2)


def test_sizes_of_z_may_differ(tmp_path: Path, data: Path) -> None:
    # Eight held-out windows make pools of two enough for a z of one number, not of four.
    sizes = {"none": 1, "id": 4}
    runs = [a_run(tmp_path / name, data, name, latent=z, pool=1) for name, z in sizes.items()]
    found, _ = assess_runs(runs, data, None, None, SMALL)
    for name in sizes:
        assert [row.windows for row in found[name][0].identified] == [1]
        assert found[name][0].reading is None
    write_report(tmp_path / "out", runs, data)


def test_a_rule_has_no_ceiling_and_is_judged_all_the_same(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = record(tmp_path / "data", "rule")
    report = write_report(tmp_path / "out", [a_run(tmp_path / "run", data)], data)
    assert "no exact ceiling: it takes a learned driver policy" in capsys.readouterr().err
    assert "There is no exact ceiling." in report.text


def test_what_cannot_be_judged_together_is_told(tmp_path: Path, data: Path) -> None:
    good = a_run(tmp_path / "good", data)
    other = record(tmp_path / "other", "rule")
    for run, told in (
        (a_run(tmp_path / "pool", data, pool=1), "pool pools other windows than"),
        (a_run(tmp_path / "share", data, held_out=0.3), "share holds out other windows than"),
        (a_run(tmp_path / "from", other), "from learned from other demonstrations than"),
        (
            a_run(tmp_path / "none", data, training={}),
            "card of .*none does not name its",
        ),
        (good, "good and .*good have the same seed"),
        (
            a_run(tmp_path / "wide", data, margin=3.0, seed=1),
            "wide was learned with another margin",
        ),
    ):
        with pytest.raises(ValueError, match=told):
            assess_runs([good, run], data, None, None, SMALL)
    with pytest.raises(FileNotFoundError, match="no trait model at"):
        assess_runs([tmp_path / "nowhere"], data, None, None, SMALL)
    with pytest.raises(FileNotFoundError, match="no demonstrations at"):
        assess_runs([good], tmp_path, None, None, SMALL)
    with pytest.raises(FileNotFoundError, match="no demonstrations at"):
        assess_runs([good], data, tmp_path, None, SMALL)


def test_runs_that_do_not_fit_are_refused_before_any_row_is_read(
    tmp_path: Path, data: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    good, other = a_run(tmp_path / "good", data), record(tmp_path / "other", "rule")
    learned, copied = a_run(tmp_path / "learned", other, "self"), a_run(tmp_path / "from", other)
    monkeypatch.setattr(StepFile, "_group", None)
    for runs, population, told in (
        ([good, good], None, "have the same seed"),
        ([copied], None, "from other demonstrations than"),
        ([learned], other, "name a population that it has not"),
        ([good], tmp_path / "nowhere", "no demonstrations at"),
    ):
        out = tmp_path / "out"
        with pytest.raises((ValueError, FileNotFoundError), match=told):
            write_report(out, runs, data, population)
        assert not out.exists()


def test_too_little_to_judge_by_is_told_before_anything_is_judged(
    tmp_path: Path, data: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def never(*given: Any) -> None:
        raise AssertionError

    monkeypatch.setattr(ceiling, "exact_evidence", never)
    run = a_run(tmp_path / "large", data, pool=3)
    with pytest.raises(ValueError, match=r"takes 12 of each driver .* of lisa there are 8"):
        assess_runs([run], data, None, None, SMALL)
    run = a_run(tmp_path / "all", data, held_out=0.0)
    with pytest.raises(ValueError, match="no window was held out"):
        assess_runs([run], data, None, None, SMALL)
    run = a_run(tmp_path / "good", data)
    few = record(tmp_path / "few", "rule", drivers=(), population=3, windows=2)
    with pytest.raises(ValueError, match="4 drivers or more with 2 windows each"):
        assess_runs([run], data, few, None, SMALL)
    with pytest.raises(ValueError, match="all drivers of the population have demonstrated"):
        assess_runs([run], data, record(tmp_path / "again", "rule"), None, SMALL)
    coarse = made_up([5] * 8, driver=[0, 1, 2, 3] * 2, names=("a", "b", "c", "d"))
    write_demonstrations(tmp_path / "coarse", coarse)
    with pytest.raises(ValueError, match="use the scene that it was trained on"):
        assess_runs([run], data, tmp_path / "coarse", None, SMALL)


def test_parts_are_timed() -> None:
    watch = Stopwatch()
    with watch.timing("one"), watch.timing("other"):
        pass
    assert list(watch.seconds) == ["other", "one"]
    assert 0 <= watch.seconds["other"] <= watch.seconds["one"] < 10
