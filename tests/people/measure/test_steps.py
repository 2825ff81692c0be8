"""Steps of the chain in recorded trips, by hand and against the environment."""

import numpy as np
import pytest

from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.teaming import Teaming
from hmi_marl.people.measure.steps import ChainCounts, chain_counts, chain_steps

AWAY = [0, 1, 1, 0, 0, 1]
ALERTS = [0, 0, 1, 0, 0, 0]


def test_a_trip_by_hand():
    steps = chain_steps([(AWAY, ALERTS)], window=2)
    assert steps.before.tolist() == [0, 0, 1, 1, 0, 0]
    assert steps.after.tolist() == AWAY
    assert steps.accepted.tolist() == [0, 0, 1, 1, 0, 0]
    assert steps.counter.tolist() == [0, 0, 0, 1, 0, 0]
    assert steps.age.tolist() == [1, 2, 1, 2, 1, 2]


def test_counts_by_hand():
    counts = chain_counts([(AWAY, ALERTS)], window=2)
    assert counts.as_dict() == {
        "openings": 2,
        "attentive": 4,
        "helped_openings": 0,
        "helped_attentive": 0,
        "closings": 0,
        "away": 0,
        "helped_closings": 1,
        "helped_away": 2,
    }


def test_an_alert_counts_from_a_later_step_for_people():
    assert chain_steps([(AWAY, ALERTS)], 2, delay=1).accepted.tolist() == [0, 0, 0, 1, 1, 0]
    assert chain_steps([(AWAY, ALERTS)], 2, delay=50).accepted.tolist() == [0] * 6


def test_every_trip_begins_anew():
    once = chain_counts([(AWAY, ALERTS)], 3).as_dict()
    both = chain_counts([(AWAY, ALERTS), ([1], [1]), (AWAY, ALERTS)], 3).as_dict()
    only = chain_counts([([1], [1])], 3).as_dict()
    assert only["helped_openings"] == 1
    assert both == {name: 2 * value + only[name] for name, value in once.items()}


def test_the_window_is_that_of_the_environment():
    config, rng = TeamConfig(driver="average", duration=10.0), np.random.default_rng(3)
    teaming = Teaming(config, 1, "batched")
    teaming.reset([1])
    alerts, seen = (rng.random(50) < 0.15).astype(int), []
    for alert in alerts:
        teaming.turn([1], [int(alert)])
        attention = teaming.attention
        seen.append([int(each[0]) for each in (attention.accepted, attention.counter)])
        if teaming.over[0]:
            break
    alerts = alerts[: len(seen)]
    steps = chain_steps([(np.zeros_like(alerts), alerts)], config.alert_window)
    assert np.stack([steps.accepted, steps.counter], axis=1).tolist() == seen


def test_counts_of_several_persons_are_stacked():
    one = chain_counts([(AWAY, ALERTS)], 2)
    both = ChainCounts.stack([one, one.times(3)])
    assert both.openings.tolist() == [2, 6]


@pytest.mark.parametrize(
    ("trips", "message"),
    [
        ([], "at least one trip"),
        ([([0, 1], [0])], r"trip 0: .* shapes are \(2,\) and \(1,\)"),
        ([([0], [0]), ([], [])], "trip 1: "),
        ([([0, 2], [0, 0])], "trip 0: looking_away holds 0 and 1 alone"),
        ([([0, 1], [0, -1])], "trip 0: alerts holds 0 and 1 alone"),
        ([([0.0, 1.0], [0, 1])], "trip 0: looking_away holds 0 and 1 alone"),
    ],
)
def test_bad_trips_are_refused(trips, message):
    with pytest.raises(ValueError, match=message):
        chain_steps(trips, 7)


def test_a_bad_window_or_delay_is_refused():
    with pytest.raises(ValueError, match="alert_window lies in"):
        chain_steps([(AWAY, ALERTS)], 0)
    with pytest.raises(ValueError, match="delay lies in"):
        chain_steps([(AWAY, ALERTS)], 2, delay=-1)
