import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from trait_models import save_driver

from hmi_marl.agents.learned.policy import load_policy
from hmi_marl.demonstrations.dataset import Observed
from hmi_marl.demonstrations.env import team_of
from hmi_marl.demonstrations.recording import CollectSettings, collect
from hmi_marl.envs.drivers import DRIVERS, PAPER_DRIVERS
from hmi_marl.exact.identify import Identification, identify
from hmi_marl.experiments.latent_traits.ceiling import (
    ceiling,
    ceilings,
    driver_policy_of,
    evidence,
    exact_evidence,
    from_one_step,
)
from hmi_marl.files import json_value
from hmi_marl.reporting.statistics import share

FOUR = tuple(DRIVERS[name] for name in PAPER_DRIVERS)


@pytest.fixture(scope="module")
def steering(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return save_driver(tmp_path_factory.mktemp("steering"), 0)


def observe(driver_policy: Path | str, **settings: Any) -> Observed:
    small: dict[str, Any] = {"steps": 40, "duration": 2.0, "vehicles": (1, 8)}
    (data,) = collect(
        CollectSettings(**{**small, **settings}, driver_policy=str(driver_policy), num_teams=10_000)
    )
    return data.observed


# Who steered.


@pytest.mark.parametrize("greedy", [False, True])
def test_the_policy_is_found_where_it_was_and_acts_as_it_did(steering: Path, greedy: bool) -> None:
    observed = observe(steering, greedy=greedy)
    config = team_of(observed)
    found = driver_policy_of(observed, None, config)
    assert found.greedy == greedy
    expected = load_policy(steering, "driver", config).weights
    for name, values in expected.items():
        np.testing.assert_array_equal(found.weights[name], values)


def test_a_policy_that_has_moved_is_found_where_it_is_said_to_be(tmp_path: Path) -> None:
    observed = observe(save_driver(tmp_path / "before", 0))
    shutil.move(tmp_path / "before", tmp_path / "after")
    config = team_of(observed)
    with pytest.raises(FileNotFoundError, match=r"no exact ceiling: no policy .*; give the folder"):
        driver_policy_of(observed, None, config)
    found = driver_policy_of(observed, str(tmp_path / "after" / "driver.json"), config)
    assert found.card.seat == "driver"


def test_another_policy_is_refused(steering: Path, tmp_path: Path) -> None:
    observed = observe(steering)
    other = save_driver(tmp_path, 1)
    with pytest.raises(ValueError, match="holds another driver policy than the one that"):
        driver_policy_of(observed, str(other), team_of(observed))


@pytest.mark.parametrize("policy", ["rule", "random"])
def test_a_driver_without_probabilities_gives_no_ceiling(policy: str, steering: Path) -> None:
    observed = observe(policy)
    for given in (None, str(steering)):
        with pytest.raises(ValueError, match=f"no exact ceiling: .* are by '{policy}'"):
            evidence(observed, given, PAPER_DRIVERS)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"seeds": None}, "no exact ceiling: recorded drives without seeds"),
        ({"about": {"hmi": "random:0.2"}}, "are by an unknown driver policy"),
        ({"about": {"hmi": "optimal"}}, "takes alerts at random, but they came from 'optimal'"),
        ({"about": {}}, "takes alerts at random, but they came from None"),
    ],
)
def test_data_without_what_it_takes_give_no_ceiling(
    steering: Path, change: dict[str, Any], message: str
) -> None:
    observed = replace(observe("rule"), **change)
    with pytest.raises(ValueError, match=message):
        evidence(observed, str(steering), PAPER_DRIVERS)


def test_the_evidence_is_that_of_the_oracle(steering: Path) -> None:
    observed = observe(steering, end_at_crash=True, ai_sees_attention=False, alert_window=3)
    config = team_of(observed)
    assert config.alert_window == 3
    policy = load_policy(steering, "driver", config, greedy=False)
    data = observed.seeds, observed.actions, observed.alerts, observed.length
    expected = identify(config, policy, FOUR, *data)  # type: ignore[arg-type]
    found = evidence(observed, None, PAPER_DRIVERS)
    assert found.drivers == FOUR
    np.testing.assert_array_equal(found.log_evidence, expected.log_evidence)


def test_a_single_observation_tells_less_than_a_window(steering: Path) -> None:
    (data,) = collect(
        CollectSettings(steps=2000, duration=2.0, driver_policy=str(steering), num_teams=10_000)
    )
    one, whole = (exact_evidence(data, None, steps) for steps in (1, None))
    observed = data.observed
    config = team_of(observed)
    policy = load_policy(steering, "driver", config, greedy=False)
    first = observed.actions[:, :1], observed.alerts[:, :1], np.ones_like(observed.length)
    expected = identify(config, policy, FOUR, observed.seeds, *first)  # type: ignore[arg-type]
    np.testing.assert_array_equal(one.log_evidence, expected.log_evidence)
    assert np.ptp(one.log_evidence, axis=1).mean() < np.ptp(whole.log_evidence, axis=1).mean()
    found = from_one_step(data, None)
    windows = np.arange(len(data.observed.driver))[:, None]
    assert found == ceilings(one, windows, data.observed.driver)


# Accuracy.


def told(*odds: list[float]) -> Identification:
    return Identification(FOUR[: len(odds[0])], np.log(odds))


def test_accuracy_by_hand() -> None:
    # Alone the first is likeliest; the second and third have more together.
    found = told([0.4, 0.35, 0.25], [0.4, 0.35, 0.25], [0.8, 0.1, 0.1], [0.1, 0.1, 0.8])
    pools, true = [[0], [1], [2], [3]], [0, 1, 0, 1]
    assert ceiling(found, pools, true, ["a", "b", "c"]) == share(2, 4)  # a, a, a, c
    assert ceiling(found, pools, true, ["a", "b", "b"]) == share(3, 4)  # b, b, a, b
    assert ceiling(found, pools, true, ["a", "a", "a"]) == share(4, 4)
    # Sure of it beforehand, the classifier is right about the second window alone, and the fourth.
    assert ceiling(found, pools, true, ["a", "b", "c"], prior=[0, 1, 0]) == share(2, 4)
    # Together a has 0.4 x 0.8 of the one pair, and c 0.25 x 0.8 of the other.
    assert ceiling(found, [[0, 2], [1, 3]], [0, 1], ["a", "b", "c"]).mean == 0.5


def test_identity_and_preference() -> None:
    # Lisa and Bart like no help, Marge and Homer do.
    found = told([0.3, 0.35, 0.3, 0.05], [0.1, 0.2, 0.1, 0.6])
    both = ceilings(found, [[0], [1]], [0, 1])
    assert (both.identity, both.preference) == (share(0, 2), share(2, 2))
    assert json_value(both)["preference"] == share(2, 2).as_json()


def test_preferences_are_kinds_of_drivers_not_degrees() -> None:
    # Two who like help, not equally, together outweigh the one who does not.
    cast = (replace(FOUR[0], eta=0.4), replace(FOUR[1], eta=0.5), replace(FOUR[2], eta=0.9))
    found = Identification(cast, np.log([[0.4, 0.3, 0.3]]))
    both = ceilings(found, [[0]], [1])
    assert (both.identity, both.preference) == (share(0, 1), share(1, 1))


def test_pools_that_share_windows_are_no_more_trials() -> None:
    rng = np.random.default_rng(0)
    found, true = Identification(FOUR, rng.normal(size=(40, 4))), np.arange(20) % 4
    pools = np.arange(40).reshape(20, 2)
    names = list(PAPER_DRIVERS)
    once = ceiling(found, pools, true, names)
    assert once == share(round(20 * once.mean), 20)
    often = ceiling(found, np.tile(pools, (5, 1)), np.tile(true, 5), names)
    assert often == once
    one = ceiling(found, [[0, 0, 0]], [0], names)
    assert (one.low, one.high) == (share(int(one.mean), 1).low, share(int(one.mean), 1).high)


def test_nobody_does_better_and_the_accuracy_is_what_bayes_says() -> None:
    # Windows are one symbol of six, drawn by the driver's own odds.
    rng = np.random.default_rng(1)
    odds, count = rng.dirichlet(np.ones(6), 4), 20_000
    true = rng.integers(0, 4, count)
    symbols = (rng.random(count)[:, None] >= odds.cumsum(axis=1)[true][:, :-1]).sum(axis=1)
    found = Identification(FOUR, np.log(odds.T[symbols]))
    best = ceiling(found, np.arange(count)[:, None], true, list(PAPER_DRIVERS))
    assert best.mean == pytest.approx(odds.max(axis=0).sum() / 4, abs=5 * 0.5 / np.sqrt(count))
    for guesses in rng.integers(0, 4, (50, 6)):
        assert (guesses[symbols] == true).mean() < best.high


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"true": [0]}, r"integers of shape \(2,\), but got int64 of shape \(1,\)"),
        ({"true": [0.0, 1.0]}, "integers of shape"),
        ({"true": [0, 3]}, "lie in 0 to 2"),
        ({"true": [-1, 0]}, "lie in 0 to 2"),
        ({"labels": ["a", "b"]}, "3 candidates, but 2 labels"),
        ({"pools": [0, 1]}, r"integers of shape \(P, n\)"),
        ({"pools": np.zeros((0, 2), np.int64), "true": np.zeros(0, np.int64)}, "at least one pool"),
        ({"prior": [0, 0, 0]}, "not all of them 0"),
    ],
)
def test_what_does_not_fit_is_refused(change: dict[str, Any], message: str) -> None:
    given: dict[str, Any] = {"pools": [[0], [1]], "true": [0, 1], "labels": ["a", "b", "c"]}
    with pytest.raises(ValueError, match=message):
        ceiling(told([0.4, 0.35, 0.25], [0.8, 0.1, 0.1]), **(given | change))


def test_pools_of_nobody_are_told() -> None:
    found = Identification(FOUR[:2], np.array([[0.0, -np.inf], [-np.inf, 0.0]]))
    with pytest.raises(ValueError, match="impossible for every candidate"):
        ceiling(found, [[0, 1]], [0], ["a", "b"])
