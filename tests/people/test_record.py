"""Records of trips: JSON of others, and replays that differ."""

import json
from dataclasses import replace

import numpy as np
import pytest
from people.trips import a_trip

from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import Traits
from hmi_marl.people.record import TripRecord, environment_stamp, replay


@pytest.fixture(scope="module")
def record():
    return a_trip("graded", seed=1, visitor="visitor-1").record()


def made(**fields):
    given = {
        "config": TeamConfig(duration=1.0), "seed": 1, "seat": "driver", "kind": "free",
        "partner": "never", "intents": (1,) * 5, "alerts": (0,) * 5, "looking_away": None,
        "crashed": False,
    }  # fmt: skip
    return TripRecord(**(given | fields))


def test_a_record_says_what_made_it(record):
    content = record.to_json()
    assert content["version"] == record.version
    assert content["stamp"] == environment_stamp()
    assert content["visitor"] == "visitor-1"
    assert content["begun"].endswith("Z")
    assert TripRecord.from_json(json.loads(json.dumps(content))) == record


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"intents": (5,) * 5}, "intents lies in 0 to 4"),
        ({"intents": (1,) * 4}, "as many alerts as intents, not 5 and 4"),
        ({"alerts": (2,) * 5}, "alerts lie in 0 to 1, but got 2"),
        ({"looking_away": (0,)}, "looking_away has 5 steps"),
        ({"looking_away": (2,) * 5}, "looking_away"),
        ({"intents": (1,) * 6, "alerts": (0,) * 6}, "at most 5 steps, not 6"),
        ({"seat": "passenger"}, "seat is one of driver, vehicle_ai"),
        ({"kind": "race"}, "kind is one of"),
        ({"seed": -1}, "seed"),
        ({"visitor": "Jane Doe"}, "visitor is up to 64 letters"),
        ({"partner": "a\nb"}, "partner is one short line"),
        ({"begun": "yesterday"}, "begun is a time in UTC"),
        ({"begun": "2026-13-01T00:00:00Z"}, "begun is a time in UTC"),
        ({"digest": "abc"}, "digest is a SHA-256"),
        ({"world": "mars"}, "world is one of"),
    ],
)
def test_what_is_no_trip_is_refused(fields, message):
    with pytest.raises(ValueError, match=message):
        made(**fields)


def test_a_population_that_json_cannot_hold_is_refused():
    class Own:
        def draw(self, seeds):
            return Traits.from_array(np.full((len(seeds), 4), 1.0))

    with pytest.raises(ValueError, match="drivers or TraitDistributions"):
        made(config=TeamConfig(driver=Own(), duration=1.0))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: {}, "a mapping with the format"),
        (lambda c: [], "a mapping with the format"),
        (
            lambda c: c | {"format": "hmi-marl trip 2"},
            "a mapping with the format",
        ),
        (lambda c: {k: v for k, v in c.items() if k != "seed"}, "not exactly its fields: .*seed"),
        (lambda c: c | {"extra": 1}, "not exactly its fields: .*extra"),
        (lambda c: c | {"seed": "1"}, "seed is a whole number"),
        (lambda c: c | {"intents": 3}, "intents is a list"),
        (lambda c: c | {"config": None}, "config is a mapping"),
        (lambda c: c | {"config": c["config"] | {"duration": "x"}}, "duration"),
        (lambda c: c | {"config": c["config"] | {"colour": 1}}, "colour"),
        (
            lambda c: c | {"config": {k: v for k, v in c["config"].items() if k != "scene"}},
            "config has not exactly its fields: .*scene",
        ),
    ],
)
def test_json_of_others_is_refused_with_the_field(record, change, message):
    with pytest.raises(ValueError, match=message):
        TripRecord.from_json(change(record.to_json()))


def test_a_replay_that_differs_says_how():
    records = (a_trip(seed=seed).record() for seed in range(100))
    record = next(each for each in records if each.crashed and len(each) < 15)
    with pytest.raises(ValueError, match="it ends crashed; it was recorded by version"):
        replay(replace(record, crashed=False))
    names = ("intents", "alerts", "looking_away")
    longer = {name: (*getattr(record, name), 0) for name in names}
    with pytest.raises(ValueError, match=f"it ends after {len(record)} steps and not"):
        replay(replace(record, **longer))
    with pytest.raises(ValueError, match="its states differ"):
        replay(replace(record, digest="0" * 64))
    first = replace(record, crashed=False, **{name: getattr(record, name)[:-1] for name in names})
    replay(replace(first, digest=""))
    with pytest.raises(ValueError, match="it ends without the crash"):
        replay(replace(first, crashed=True))


def test_an_unfinished_trip_replays_too():
    record = a_trip(seed=2, steps=4).record()
    assert not record.finished
    assert int(replay(record).steps[0]) == 4
    assert int(replay(a_trip(seed=2, steps=0).record()).steps[0]) == 0


@pytest.mark.parametrize(
    ("name", "digest"),
    [
        ("paper", "65ca61ce63d7b476b4400dcea67c538e9753a51e88d78a0cd1593811193f0b6f"),
        ("graded", "7ce107c5d6c122b75c704e12557aba65d2c186a9351c7478a74d46bfa7003b8a"),
    ],
)
def test_trips_that_were_recorded_before_still_replay(name, digest):
    # Digests of version 0.2.0, commit af7681d. Change the format if they have to differ.
    assert a_trip(name, seed=3).record().digest == digest
