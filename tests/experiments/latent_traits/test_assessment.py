import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from trait_models import save_driver, untrained

from hmi_marl.agents.learned.trait_model import TraitModel
from hmi_marl.demonstrations.dataset import Demonstrations, disjoint_pools
from hmi_marl.demonstrations.recording import CollectSettings, collect
from hmi_marl.envs.drivers import DRIVERS, TRAIT_NAMES
from hmi_marl.exact.identify import Identification
from hmi_marl.experiments.latent_traits.assessment import (
    PARTS,
    Assessment,
    AssessSettings,
    Split,
    assess,
    pool_sizes,
)
from hmi_marl.experiments.latent_traits.ceiling import NoCeilingError, evidence, exact_evidence
from hmi_marl.experiments.latent_traits.imitation import by_driver, driving, replay
from hmi_marl.experiments.latent_traits.strangers import read_traits
from hmi_marl.files import json_value

CAST = ("lisa", "homer")
pytestmark = pytest.mark.usefixtures("few_folds")

SMALL = AssessSettings(windows=10, episodes=3, ranked=4)


def record(policy: Path | str, **settings: Any) -> Demonstrations:
    small: dict[str, Any] = {"drivers": CAST, "steps": 100, "duration": 1.0, "vehicles": (1, 4)}
    (data,) = collect(
        CollectSettings(**{**small, **settings}, driver_policy=str(policy), num_teams=10_000)
    )
    return data


@pytest.fixture(scope="module")
def steering(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return save_driver(tmp_path_factory.mktemp("steering"))


@pytest.fixture(scope="module")
def split(steering: Path) -> Split:
    """Twenty windows of each driver, of which eight are held out."""
    return Split.of(record(steering), 0.4, SMALL.windows)


@pytest.fixture(scope="module")
def population(steering: Path) -> Demonstrations:
    return record(steering, drivers=(), population=6, windows=4, seed=1)


def model_for(split: Split, **card: Any) -> TraitModel:
    training: Mapping[str, Any] = {"settings": {"supervision": "id"}}
    return untrained(split.learned.observed.layout, pool=2, training=training, **card)


@pytest.fixture(scope="module")
def assessment(few_folds: None, split: Split, population: Demonstrations) -> Assessment:
    exact = exact_evidence(split.unseen, None)
    sizes = pool_sizes(split, 2, 2)
    return assess(model_for(split), split, exact, population, SMALL, sizes)


def test_everything_is_asked(assessment: Assessment, split: Split) -> None:
    assert assessment.supervision == "id"
    assert [(row.windows, row.pools) for row in assessment.identified] == [(1, 16), (2, 8)]
    assert assessment.at_pool(2) is assessment.identified[1]
    for row in assessment.identified:
        assert row.types.chance == 0.5
        assert row.ceilings is not None
        assert row.preferences is not None
        assert row.ceilings.identity == row.ceilings.preference  # lisa or homer, η 0.01 or 1
    assert assessment.embedding.means.shape == (8, 2)
    assert assessment.embedding.names == CAST
    assert [row.driver for row in assessment.likelihood] == list(CAST)
    assert [row.driver for row in assessment.driving] == list(CAST)
    assert [(row.driver, row.episodes) for row in assessment.reward_ranking] == [
        ("lisa", 4),
        ("homer", 4),
    ]
    assert assessment.reading is not None
    assert tuple(assessment.reading.r2) == TRAIT_NAMES
    for row in assessment.driving:
        assert (row.demonstrated.drives, row.imitated.drives) == (3, 3)
    unseen = split.unseen.observed
    some = unseen.take(unseen.number < 3)
    shown = by_driver(replay(some), some.labels())
    assert assessment.driving[1].demonstrated == driving(shown["homer"], 5)


def test_nobody_beats_the_exact_likelihood_by_much(assessment: Assessment) -> None:
    for row in assessment.likelihood:
        assert row.exact_minus_own is not None
        assert row.exact_minus_own.high > 0


def test_the_regression_is_over_the_population(
    assessment: Assessment, split: Split, population: Demonstrations
) -> None:
    expected = read_traits(model_for(split), population, 2, SMALL.seed).r2
    assert assessment.reading is not None
    assert assessment.reading.r2 == expected


def test_it_comes_back_from_json(assessment: Assessment) -> None:
    content = json.loads(json.dumps(assessment.as_json(), allow_nan=False))
    assert set(content) == {
        "supervision",
        "identified",
        "embedding",
        "likelihood",
        "driving",
        "reward_ranking",
        "traits",
        "naming",
        "prediction",
    }
    assert [row["windows"] for row in content["identified"]] == [1, 2]
    assert content["identified"][1]["types"] == json_value(assessment.identified[1].types)
    assert content["embedding"]["means"] == assessment.embedding.means.tolist()
    assert content["embedding"]["drivers"] == ["lisa"] * 4 + ["homer"] * 4
    assert content["traits"]["eta"]["linear"]["mean"] == pytest.approx(
        assessment.reading.r2["eta"].linear.mean  # type: ignore[index]
    )


def test_what_is_not_known_is_none_in_json(split: Split) -> None:
    # With one drive there is no interval, and a constant reward ranks nothing.
    def constant(name: str, values: Any) -> Any:
        return values * (not name.startswith(("reward", "potential")))

    model = untrained(split.learned.observed.layout, pool=2, change=constant)
    one = AssessSettings(windows=10, episodes=1, ranked=2)
    found = assess(model, split, None, None, one, (1,))
    content = json.loads(json.dumps(found.as_json(), allow_nan=False))
    assert content["supervision"] == "none"
    assert content["driving"][0]["imitated"]["speed"]["low"] is None
    assert content["reward_ranking"][0]["mixture"]["g"]["mean"] is None
    assert content["traits"] is None
    assert content["likelihood"][0]["exact"] is None
    assert content["identified"][0]["ceilings"] is None


def test_progress_is_told(split: Split) -> None:
    calls: list[None] = []
    small = AssessSettings(windows=10, episodes=1, ranked=2)
    assess(model_for(split), split, None, None, small, (1,), lambda: calls.append(None))
    assert len(calls) == PARTS


def test_recorded_people_are_judged_as_far_as_can_be(split: Split) -> None:
    """Without seeds nothing can be played again, and without the truth nobody knows traits."""
    sides = (
        Demonstrations(replace(part.observed, seeds=None)) for part in (split.learned, split.unseen)
    )
    people, calls = Split(*sides), []
    found = assess(model_for(split), people, None, None, SMALL, (1, 2), lambda: calls.append(None))
    assert (found.driving, found.reward_ranking, found.reading) == ([], [], None)
    assert [row.windows for row in found.identified] == [1, 2]
    assert found.identified[0].preferences is None
    assert len(found.likelihood) == 2
    assert len(calls) == PARTS
    json.dumps(found.as_json(), allow_nan=False)


def test_a_z_of_one_number_can_be_judged(split: Split, population: Demonstrations) -> None:
    model = model_for(split, latent=1)
    found = assess(model, split, None, population, SMALL, pool_sizes(split, 2, 1))
    assert found.embedding.means.shape == (8, 1)


# The exact classifier.


def test_the_evidence_is_of_those_who_drove(split: Split) -> None:
    found = exact_evidence(split.unseen, None)
    expected = evidence(split.unseen.observed, None, CAST)
    assert found.drivers == (DRIVERS["lisa"], DRIVERS["homer"])
    np.testing.assert_array_equal(found.log_evidence, expected.log_evidence)
    assert isinstance(found, Identification)
    pools = disjoint_pools(split.unseen.observed.driver, 2)
    assert found.pooled(pools).log_evidence.shape == (8, 2)


def test_where_there_is_no_ceiling_that_is_told(split: Split, tmp_path: Path) -> None:
    with pytest.raises(NoCeilingError, match="the drivers' traits are not known"):
        exact_evidence(Demonstrations(split.unseen.observed), None)
    with pytest.raises(NoCeilingError, match="are by 'rule'"):
        exact_evidence(record("rule"), None)
    # That somebody can do something about is no such thing.
    with pytest.raises(FileNotFoundError, match="give the folder of the driver policy"):
        exact_evidence(split.unseen, str(tmp_path))
    with pytest.raises(ValueError, match="holds another driver policy") as told:
        exact_evidence(split.unseen, str(save_driver(tmp_path, 1)))
    assert not isinstance(told.value, NoCeilingError)


@pytest.mark.parametrize(
    ("name", "value", "told"),
    [
        ("windows", 0, "windows lies in 1 to"),
        ("episodes", 0, "episodes lies in 1 to"),
        ("ranked", 1, "ranking takes two windows: ranked is at least 2"),
    ],
)
def test_judging_by_nothing_is_refused(name: str, value: int, told: str) -> None:
    with pytest.raises(ValueError, match=told):
        AssessSettings(**{name: value})
