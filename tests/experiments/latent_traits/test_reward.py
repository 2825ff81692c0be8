import json
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import stats
from trait_models import SMALL

from hmi_marl.agents.learned.network import NetworkConfig
from hmi_marl.agents.learned.trait_model import TraitCard, TraitModel
from hmi_marl.demonstrations.dataset import Observed
from hmi_marl.demonstrations.recording import CollectSettings, collect
from hmi_marl.envs.observations import Layout
from hmi_marl.experiments.latent_traits.imitation import replay
from hmi_marl.experiments.latent_traits.reward import (
    DEMONSTRATED,
    LEARNED,
    rank_correlation,
    returns_of,
    reward_ranking,
    ways_to_drive,
    with_noise,
)
from hmi_marl.files import json_value
from hmi_marl.reporting import statistics
from hmi_marl.reporting.statistics import UNKNOWN

WAYS = [DEMONSTRATED, LEARNED, "10% random", "30% random", "random"]
Z = {"bart": [0.3, -0.2], "marge": [1.0, 1.0]}


def observe(**settings: Any) -> Observed:
    small: dict[str, Any] = {"drivers": ("bart", "marge"), "steps": 300, "duration": 4.0}
    (data,) = collect(
        CollectSettings(**{**small, **settings}, driver_policy="random", num_teams=10_000)
    )
    return data.observed


def for_speed(observed: Observed) -> Observed:
    """The same, of teams whose driving return is of nothing but speed."""
    nothing = dict.fromkeys(("collision", "right_lane", "merging", "lane_change"), 0.0)
    team: Mapping[str, Any] = observed.about["team"]
    weights = {**team["weights"], **nothing}
    return replace(observed, about={**observed.about, "team": {**team, "weights": weights}})


def model_of(layout: Layout, **weights: Any) -> TraitModel:
    """Weights of zero, but those told, by name with __ for the dot."""
    one = NetworkConfig((1,), "relu")
    reads = tuple((part.name, part.size) for part in layout.parts)
    card = TraitCard(reads, encoder=SMALL, gamma=0.9, reward=one, potential=one, policy=one)
    values = {name: np.zeros(size, np.float32) for name, size in card.shapes.items()}
    values["state.scale"] += 1.0
    for name, given in weights.items():
        values[name.replace("__", ".")][...] = given
    return TraitModel(card, values)


def speed_reward(layout: Layout, sign: float = 1.0, potential: float = 0.0) -> TraitModel:
    """g is the speed before the step, or its opposite; h is the same everywhere."""
    columns = model_of(layout).card.inputs("reward")
    reads_speed = np.arange(columns) == layout["speed"].start
    return model_of(
        layout,
        reward__layer0__weight=reads_speed,
        reward__layer1__weight=sign,
        potential__layer1__bias=potential,
    )


# Returns.


def test_recovered_returns_by_hand() -> None:
    observed = observe()
    drives = replay(observed)
    found = returns_of(speed_reward(observed.layout, potential=2.0), drives, np.zeros(2))
    speed = observed.layout.scalar(observed.states, "speed")
    np.testing.assert_allclose(found.g, speed[:, :-1].sum(axis=1), rtol=1e-6)
    # γ h' - h is 0.9 x 2 - 2 in each of 19 transitions.
    np.testing.assert_allclose(found.f, found.g - 0.2 * 19, rtol=1e-6)
    np.testing.assert_array_equal(found.true, drives.driving_return)


def test_returns_of_many_windows_are_those_of_each(monkeypatch: pytest.MonkeyPatch) -> None:
    observed = observe()
    rng = np.random.default_rng(0)
    shapes = model_of(observed.layout).card.shapes
    drawn = {name.replace(".", "__"): rng.standard_normal(size) for name, size in shapes.items()}
    model = model_of(observed.layout, **(drawn | {"state__scale": 1.0}))
    drives, z = replay(observed), np.array([0.3, -1.0])
    whole = returns_of(model, drives, z)
    monkeypatch.setattr("hmi_marl.experiments.latent_traits.reward._AT_ONCE", 7)
    for found, expected in zip(returns_of(model, drives, z), whole, strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)
    one, t = 4, range(19)
    x, a = drives.situations[one], drives.actions[one]
    f = sum(model.reward(x[[k]], a[[k]], x[[k + 1]], z)[0] for k in t)
    g = sum(model.base_reward(x[[k]], a[[k]], z)[0] for k in t)
    assert (whole.f[one], whole.g[one]) == pytest.approx((f, g))


# Worse driving.


def test_noise_is_as_frequent_as_told_and_grows_from_what_was_there() -> None:
    actions, seeds = np.full((300, 50), 1), np.arange(300, dtype=np.uint64)
    for share in (0.1, 0.3, 1.0):
        noisy = with_noise(actions, share, seeds)
        counts = np.bincount(noisy.ravel(), minlength=5) / actions.size
        expected = np.full(5, share / 5) + (1 - share) * (np.arange(5) == 1)
        assert (np.abs(counts - expected) < 5 * np.sqrt(expected / actions.size)).all()
        np.testing.assert_array_equal(noisy[5:8], with_noise(actions[5:8], share, seeds[5:8]))
    # Where what was there does not matter it is replaced, and at a larger share as well.
    replaced = with_noise(actions, 0.3, seeds) == with_noise(actions + 4, 0.3, seeds)
    assert replaced.mean() == pytest.approx(0.3, abs=0.03)
    assert (with_noise(actions + 4, 0.5, seeds)[replaced] < 5).all()


def test_all_ways_to_drive_share_their_traffic_and_noise_knows_no_model() -> None:
    observed = observe()
    fast = model_of(observed.layout, policy__layer1__bias=np.eye(5)[3] * 50)
    slow = model_of(observed.layout, policy__layer1__bias=np.eye(5)[4] * 50)
    one, other = (ways_to_drive(model, observed, np.zeros(2), 0) for model in (fast, slow))
    assert list(one) == list(other) == WAYS
    for way in WAYS:
        same = (one[way].situations == other[way].situations).all()
        assert same == (way != LEARNED)
        start, width = one[way].situations[:, 0], observed.layout.size
        np.testing.assert_array_equal(start[:, :width], observed.states[:, 0])
    np.testing.assert_array_equal(one[DEMONSTRATED].actions, observed.actions)
    assert (one[LEARNED].actions == 3).all()
    changed = [(one[way].actions != observed.actions).mean() for way in WAYS[2:]]
    np.testing.assert_allclose(changed, [0.08, 0.24, 0.8], atol=0.05)
    again = ways_to_drive(fast, observed, np.zeros(2), 1)
    assert (again["random"].actions != one["random"].actions).any()


# Ranks.


@pytest.mark.parametrize(("sign", "expected"), [(1.0, 1.0), (-1.0, -1.0)])
def test_a_reward_for_speed_ranks_speed(sign: float, expected: float) -> None:
    observed = for_speed(observe(steps=600))
    rows = reward_ranking(speed_reward(observed.layout, sign), observed, Z)
    assert [(row.driver, row.episodes) for row in rows] == [("bart", 30), ("marge", 30)]
    for row in rows:
        for ranks in (row.demonstrated, row.mixture):
            for found in (ranks.f, ranks.g):
                assert found.mean == pytest.approx(expected, abs=0.1)
                assert found.low <= found.mean <= found.high
        assert list(row.returns) == WAYS


def test_a_constant_reward_ranks_nothing() -> None:
    observed = observe()
    row = reward_ranking(model_of(observed.layout), observed, {"bart": [0, 0]})[0]
    assert np.isnan(row.demonstrated.g.mean)
    assert json_value(row)["mixture"]["f"] == UNKNOWN.as_json()


def test_what_is_told() -> None:
    observed = observe()
    row = reward_ranking(speed_reward(observed.layout), observed, {"marge": [0, 0]}, seed=3)[0]
    theirs = observed.take(observed.driver == 1)
    true = replay(theirs).driving_return
    assert row.returns[DEMONSTRATED]["true"] == statistics.mean(true)
    speed = observed.layout.scalar(theirs.states, "speed")[:, :-1].sum(axis=1)
    assert row.demonstrated.g.mean == pytest.approx(stats.spearmanr(speed, true).statistic)
    assert row.demonstrated.f == row.demonstrated.g
    again = reward_ranking(speed_reward(observed.layout), observed, {"marge": [0, 0]}, seed=3)[0]
    assert again == row
    content = json.loads(json.dumps(json_value(row)))
    assert list(content["returns"]) == WAYS


def test_correlations_are_those_of_all_pairs_with_intervals_over_columns() -> None:
    rng = np.random.default_rng(0)
    one = rng.normal(size=(3, 40))
    other = one + rng.normal(size=(3, 40))
    found = rank_correlation(one, other)
    assert found.mean == pytest.approx(stats.spearmanr(one.ravel(), other.ravel()).statistic)
    assert found.low < found.mean < found.high
    # The same windows in three ways are no more windows: the interval stays as it is.
    single, thrice = (
        rank_correlation(np.tile(one[:1], (k, 1)), np.tile(other[:1], (k, 1))) for k in (1, 3)
    )
    assert vars(single) == pytest.approx(vars(thrice), nan_ok=True)
    exact = rank_correlation(one, np.exp(one))
    assert (exact.mean, exact.low, exact.high) == pytest.approx((1, 1, 1))
    assert np.isnan(rank_correlation(one, np.ones((3, 40))).mean)


def test_intervals_hold_what_is_true_about_as_often_as_they_say() -> None:
    # Of two normal numbers with correlation r, Spearman's is 6 / π asin(r / 2).
    rng, r, hits = np.random.default_rng(1), 0.6, 0
    for trial in range(100):
        a, b = rng.normal(size=(2, 1, 60))
        found = rank_correlation(a, r * a + np.sqrt(1 - r**2) * b, trial)
        hits += found.low <= 6 / np.pi * np.arcsin(r / 2) <= found.high
    assert hits >= 85


def test_what_cannot_be_ranked_is_refused() -> None:
    observed = observe()
    model = speed_reward(observed.layout)
    with pytest.raises(ValueError, match="two demonstrations or more, but homer has 0"):
        reward_ranking(model, observed, {"homer": [0, 0]})
    with pytest.raises(ValueError, match="z of bart is 2 finite numbers"):
        reward_ranking(model, observed, {"bart": [0, 0, 0]})
    with pytest.raises(ValueError, match="cannot be replayed"):
        reward_ranking(model, replace(observed, seeds=None), Z)
