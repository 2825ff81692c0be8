"""Scripted persons: the same trips alone, through Trip, and side by side; coverage."""

from dataclasses import replace

import numpy as np
import pytest

from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import DRIVERS, PAPER_DRIVERS, TraitDistributions, Traits
from hmi_marl.envs.scene import Scene
from hmi_marl.envs.streams import episode_seed, team_seed
from hmi_marl.people.measure.person import measure_person
from hmi_marl.people.measure.scripted import drive_calibration, simulate_calibrations
from hmi_marl.people.measure.steps import SEEN_AFTER, ChainCounts, chain_counts
from hmi_marl.people.measure.traits import ATTENTION_TRAITS, intervals
from hmi_marl.people.record import replay

QUIET = TeamConfig(driver="average", scene=Scene(vehicles=(1, 1)), end_at_crash=False)
FOUR = Traits.of([DRIVERS[name] for name in PAPER_DRIVERS])


def test_a_trip_is_the_same_alone_and_among_others():
    trips = simulate_calibrations(FOUR, QUIET, 2, seed=5)
    seed = int(episode_seed(team_seed(5, 2), 1))
    alone = drive_calibration(Traits.of([DRIVERS["bart"]]), QUIET, seed)
    assert replace(alone, digest="") == trips[2][1]
    assert replay(alone).over[0]


def test_trips_end_with_the_crash_where_they_do():
    config = TeamConfig(driver="average", scene=Scene(vehicles=(10, 20)))
    for trips in simulate_calibrations(FOUR, config, 2, seed=1):
        for trip in trips:
            assert trip.finished
            replay(trip)


def test_a_person_is_measured_through_trips():
    person = measure_person("bart-like", simulate_calibrations(FOUR, QUIET, 9, seed=2)[2])
    for trait in ATTENTION_TRAITS:
        found = person.estimates[trait]
        assert found.low <= getattr(DRIVERS["bart"], trait) <= found.high
    assert person.minutes == pytest.approx(3.0)
    assert not any(test.rejected for test in person.tests)
    assert person.driver.name == "bart-like"
    assert person.driver.inflation == DRIVERS["average"].inflation


@pytest.mark.slow
def test_intervals_hold_the_truth_in_200_calibrations():
    """At least 90 % for each trait, of named and of random drivers, after 5 minutes."""
    named = np.repeat(FOUR.as_array(), 25, axis=0)
    drawn = TraitDistributions().draw(np.arange(100, dtype=np.uint64)).as_array()
    traits = Traits.from_array(np.concatenate([named, drawn]))
    counts = []
    for trips in simulate_calibrations(traits, QUIET, 15, seed=9):
        pairs = [(trip.looking_away, trip.alerts) for trip in trips]
        counts.append(chain_counts(pairs, QUIET.alert_window, SEEN_AFTER))
    for trait, found in intervals(ChainCounts.stack(counts)).items():
        assert found.covers(getattr(traits, trait)).sum() >= 180, trait
