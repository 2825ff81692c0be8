from dataclasses import replace

import numba
import numpy as np
import pytest

from hmi_marl.agents import make_driver_policy, make_hmi
from hmi_marl.agents.adaptive.hmis import ExpectedValueHMI
from hmi_marl.agents.adaptive.trait_estimator import TraitEstimator
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import DRIVERS, PAPER_DRIVERS, Driver, Traits
from hmi_marl.envs.scene import Scene
from hmi_marl.exact.evidence import ChainEvidence
from hmi_marl.experiments.adaptation.trips import FixedDrivers, HandOver, play_trips
from hmi_marl.experiments.episodes import play_episodes

TEAM = TeamConfig(ai_sees_attention=False, duration=4.0, scene=Scene(vehicles=20))
QUIET = replace(TEAM, scene=Scene(vehicles=1, lanes=5))
FOUR = Traits.of([DRIVERS[name] for name in PAPER_DRIVERS])
ALWAYS = Driver("always", beta=1.0, alpha=0.0, eta=0.0, inflation=1.0)
NEVER = Driver("never", beta=0.0, alpha=1.0, eta=0.0, inflation=1.0)
SEEDS = np.arange(12, dtype=np.uint64).reshape(4, 3)


@pytest.fixture(autouse=True)
def one_thread(monkeypatch):
    monkeypatch.setattr(numba.config, "NUMBA_NUM_THREADS", 1)


def trips(hmi, team=TEAM, drivers=FOUR, seeds=SEEDS, driver="random", **settings):
    hmi = make_hmi(hmi, team) if isinstance(hmi, str) else hmi
    return play_trips(team, make_driver_policy(driver, team), hmi, drivers, seeds, **settings)


def adaptive(rate=0.01):
    drivers = [DRIVERS[name] for name in PAPER_DRIVERS]
    estimator = TraitEstimator(ChainEvidence(drivers, TEAM), TEAM, change_rate=rate)
    return ExpectedValueHMI(estimator, TEAM)


@pytest.mark.parametrize("hmi", ["random:0.3", "belief:average"])
def test_every_trip_is_an_ordinary_episode(hmi):
    found = trips(hmi)
    assert found.rewards.shape == found.driving.shape == (4, 3, 20)
    assert found.probabilities is None
    lengths = found.driving.sum(axis=2)
    assert len(np.unique(lengths)) > 3, "some crash"
    for k, name in enumerate(PAPER_DRIVERS):
        team = replace(TEAM, driver=name)
        policies = make_driver_policy("random", team), make_hmi(hmi, team)
        episodes = play_episodes(team, *policies, SEEDS[k], "batched")
        np.testing.assert_array_equal(found.returns[k], episodes.attention_return())
        np.testing.assert_array_equal(lengths[k], episodes.length)
    for on, earned in zip(
        found.driving.reshape(-1, 20), found.rewards.reshape(-1, 20), strict=True
    ):
        assert not earned[~on].any()


def test_it_is_settled_who_drives_whatever_the_seeds():
    assert FixedDrivers(FOUR).draw(SEEDS[:, 0]) is FOUR
    team = replace(TEAM, driver=FixedDrivers(FOUR))
    assert team.only_driver is None


def test_teams_do_not_depend_on_each_other():
    together = trips(adaptive(), keep_beliefs=True)
    alone = trips(
        adaptive(),
        drivers=Traits.from_array(FOUR.as_array()[2:3]),
        seeds=SEEDS[2:3],
        keep_beliefs=True,
    )
    np.testing.assert_array_equal(alone.rewards, together.rewards[2:3])
    np.testing.assert_array_equal(alone.driving, together.driving[2:3])
    assert together.probabilities.shape == (4, 3, 20, 4)
    np.testing.assert_allclose(alone.probabilities, together.probabilities[2:3], rtol=1e-9)


def test_what_was_learned_of_a_driver_stays_from_trip_to_trip():
    rate = 0.01
    told = trips(adaptive(rate), keep_beliefs=True).probabilities
    np.testing.assert_array_equal(told[:, 0, 0], np.full((4, 4), 0.25))
    for trip in (1, 2):
        # the first turn of a trip tells nothing but that somebody else may drive
        expected = (1 - rate) * told[:, trip - 1, -1] + rate * 0.25
        np.testing.assert_allclose(told[:, trip, 0], expected, rtol=1e-9)
    assert abs(told[:, 2, 0] - 0.25).max(axis=1).min() > 0.05


def test_a_driver_who_was_played_with_before_is_a_stranger_again():
    hmi = adaptive()
    first = trips(hmi, keep_beliefs=True)
    again = trips(hmi, keep_beliefs=True)
    np.testing.assert_array_equal(first.probabilities, again.probabilities)
    np.testing.assert_array_equal(first.rewards, again.rewards)


def test_beliefs_are_kept_when_asked_for_alone():
    assert trips(adaptive()).probabilities is None
    assert trips("never", keep_beliefs=True).probabilities is None


def test_rewards_after_a_change_of_driver_by_hand():
    # Attentive: 10 a step for keeping quiet. Always distracted: 0 in the first step, then -10.
    pair = Traits.of([NEVER, NEVER])
    told = []
    found = trips(
        "never",
        QUIET,
        pair,
        SEEDS[:2],
        "rule",
        hand_over=HandOver(1, 7, Traits.of([ALWAYS, NEVER])),
        on_drivers=lambda traits: told.append(traits.beta.tolist()),
    )
    assert found.driving.all()
    expected = np.full((2, 3, 20), 10.0)
    expected[0, 1, 7:] = [0.0] + [-10.0] * 12
    expected[0, 2] = [0.0] + [-10.0] * 19
    np.testing.assert_array_equal(found.rewards, expected)
    assert told == [[0, 0], [0, 0], [1, 0], [1, 0]]


def test_a_change_before_the_first_step_is_another_driver_from_the_start():
    changed = trips("never", hand_over=HandOver(0, 0, FOUR), drivers=Traits.of([NEVER] * 4))
    np.testing.assert_array_equal(changed.rewards, trips("never").rewards)


def test_returns_of_trips_by_hand():
    found = trips("always", QUIET, Traits.of([ALWAYS] * 2), SEEDS[:2], "rule")
    assert found.returns.tolist() == [[-200.0] * 3] * 2
