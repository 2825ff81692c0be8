"""Trips: episodes of the environment, replayed to the bit in both worlds."""

import copy
import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from people.trips import CONFIGS, a_trip, config_of, drive

from hmi_marl.agents.catalogue import make_driver_policy, make_hmi
from hmi_marl.agents.rollout import Observer, begin, play
from hmi_marl.demonstrations.dataset import STATE_PARTS
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.worlds.batched import BatchedWorld
from hmi_marl.envs.worlds.highway import HighwayWorld, MergeScene
from hmi_marl.people.record import StateDigest, TripRecord, replay
from hmi_marl.people.trip import Moment, Road, Trip


class Watch(Observer):
    """All states of a team and its world."""

    def __init__(self):
        self.states, self.whole = [], []

    def after(self, teaming, result):
        self.look(teaming)

    def look(self, teaming):
        snapshot, now = teaming.world.snapshot(0), teaming.attention
        parts = [snapshot.position.ravel(), snapshot.heading, snapshot.speed]
        parts += [teaming.observe(agent, STATE_PARTS)[0] for agent in ("driver", "vehicle_ai")]
        self.states.append(np.concatenate(parts))
        acted = teaming.intent_given[0]  # a driver for the next step
        intended = teaming.previous_intended if acted else teaming.intended
        whole = [intended, teaming.applied, teaming.alerted, now.distracted]
        whole += [now.accepted, now.counter, now.fatigue]
        self.whole.append([int(each[0]) for each in whole])


def check_replay(name, seat, seed, seen, world):
    """A trip, and its replays from JSON in both worlds; returns the record."""
    live = Watch()
    trip = Trip(
        config_of(name), seat, "random:0.3" if seat == "driver" else "rule", seed, world=world
    )
    drive(trip, seed, seen and seat == "driver", watch=lambda trip: live.look(trip.teaming))
    record = TripRecord.from_json(json.loads(json.dumps(trip.record().to_json())))
    assert record == trip.record()
    assert record.finished
    again, other = Watch(), Watch()
    replay(record, observers=[again])
    assert [each.tobytes() for each in again.states] == [each.tobytes() for each in live.states]
    assert again.whole == live.whole
    replay(record, "highway" if world == "batched" else "batched", [other])
    assert other.whole == live.whole
    for ours, theirs in zip(other.states, live.states, strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-6)
    if seen and seat == "driver":
        assert [row[3] for row in live.whole] == list(record.looking_away)
    else:
        assert record.looking_away is None
    return record


@settings(max_examples=12)
@given(
    name=st.sampled_from(list(CONFIGS)),
    seat=st.sampled_from(["driver", "vehicle_ai"]),
    seed=st.integers(0, 2**64 - 1),
    seen=st.booleans(),
)
def test_any_trip_replays_to_the_same_states_to_the_bit(name, seat, seed, seen):
    watched = Watch()
    trip = Trip(config_of(name), seat, "random:0.3" if seat == "driver" else "rule", seed)
    drive(trip, seed, seen and seat == "driver", watch=lambda trip: watched.look(trip.teaming))
    again = Watch()
    replay(TripRecord.from_json(trip.record().to_json()), observers=[again])
    assert [each.tobytes() for each in again.states] == [s.tobytes() for s in watched.states]
    assert again.whole == watched.whole


@pytest.mark.slow  # highway-env takes seconds for each
@settings(max_examples=60)
@given(
    name=st.sampled_from(list(CONFIGS)),
    seat=st.sampled_from(["driver", "vehicle_ai"]),
    seed=st.integers(0, 2**64 - 1),
    seen=st.booleans(),
    world=st.sampled_from(["batched", "highway"]),
)
def test_any_trip_replays_in_both_worlds(name, seat, seed, seen, world):
    check_replay(name, seat, seed, seen, world)


@pytest.mark.parametrize("world", ["batched", "highway"])
def test_a_trip_of_either_world_replays_in_both(world):
    check_replay("paper", "driver", 7, True, world)


def test_trips_with_a_crash_alerts_and_real_distraction_are_among_those_that_replay():
    records = [a_trip("paper", seed=seed).record() for seed in range(20)]
    assert any(record.crashed and len(record) < 15 for record in records)
    assert any(not record.crashed for record in records)
    for record in records:
        replay(record)
    standing = [a_trip("standing", seed=seed).record() for seed in range(8)]
    assert any(record.crashed for record in standing)
    assert all(len(record) == 15 for record in standing)
    for record in standing:
        replay(record)
    graded = a_trip("graded", seed=3).record()
    assert max(graded.alerts) > 1
    replay(graded)
    assert any(sum(record.alerts) for record in records)
    assert any(sum(record.looking_away) for record in records)


class Actions(Observer):
    def __init__(self):
        self.taken = []

    def after(self, teaming, result):
        self.taken.append((int(teaming.intended[0]), int(teaming.alerted[0])))


class _Simultaneous:
    """An HMI that is asked before the driver acts."""

    sequential = False

    def __init__(self, config):
        self.inner = make_hmi("random:0.5", config)

    def reset(self, seeds, which=None):
        self.inner.reset(seeds, which)

    def act(self, observations):
        return self.inner.act(observations)


@pytest.mark.parametrize("seat", ["driver", "vehicle_ai"])
@pytest.mark.parametrize("hmi", ["optimal", "random:0.4", "simultaneous"])
@pytest.mark.parametrize("name", ["paper", "standing"])
def test_a_trip_that_the_chain_draws_is_an_ordinary_episode(seat, hmi, name):
    config = config_of(name) if hmi != "optimal" else TeamConfig(driver="homer", duration=3.0)
    if hmi == "simultaneous" and seat == "vehicle_ai":
        pytest.skip("a person in the vehicle AI's seat sees a^H")

    def make():
        return _Simultaneous(config) if hmi == "simultaneous" else make_hmi(hmi, config)

    for seed in range(3):
        actions, digest = Actions(), StateDigest()
        policies = make_driver_policy("rule", config), make()
        seeds = np.array([seed], np.uint64)
        play(begin(config, *policies, seeds, "batched"), *policies, [actions, digest])
        policy = make() if seat == "driver" else make_driver_policy("rule", config)
        trip = Trip(config, seat, "its name", seed, policy=policy)
        for intent, alert in actions.taken:
            trip.advance(intent if seat == "driver" else alert)
        record = trip.record()
        assert trip.over
        assert list(zip(record.intents, record.alerts, strict=True)) == actions.taken
        assert record.digest == digest.hexdigest()


def test_the_picture_is_the_worlds_own_state_at_every_simulator_step():
    trip = Trip(config_of("paper", 2.0), "driver", "never", 4)
    own = BatchedWorld(trip.config.scene, 1, 1)
    own.reset(np.array([4], np.uint64), np.ones(1), np.ones(1, np.bool_))
    assert trip.picture().moments == (Moment.of(own.snapshot(0)),)

    def look(trip):
        moments, applied = trip.picture().moments, trip.teaming.applied
        assert len(moments) == 3
        for place, moment in enumerate(moments):
            part = copy.deepcopy(own)
            part._merges = part._merges._replace(substeps=place + 1)
            part.step(applied, np.ones(1, np.bool_))
            seen = Moment.of(part.snapshot(0))
            for each in ("x", "y", "heading", "speed", "crashed"):
                assert getattr(moment, each) == getattr(seen, each), (trip.decisions, place)
            assert moment.time == pytest.approx((3 * (trip.decisions - 1) + place + 1) / 15)
        own.step(applied, np.ones(1, np.bool_))

    drive(trip, 4, True, watch=look)
    assert trip.over


def test_in_highway_env_the_picture_is_its_own_frames(monkeypatch):
    frames = []
    monkeypatch.setattr(
        MergeScene,
        "_automatic_rendering",
        lambda self: frames.append(np.array([v.position for v in self.road.vehicles])),
    )
    trip = Trip(config_of("paper", 1.0, 5), "driver", "never", 2, world="highway")

    def look(trip):
        moments = trip.picture().moments
        for moment, frame in zip(moments[:-1], frames, strict=False):
            assert np.array_equal(np.array([moment.x, moment.y]).T, frame)
        last = trip.teaming.world.snapshot(0)
        assert np.array_equal(np.array([moments[-1].x, moments[-1].y]).T, last.position)
        frames.clear()

    assert isinstance(trip.teaming.world, HighwayWorld)
    drive(trip, 2, watch=look)
    assert trip.decisions == 5


def test_a_crashed_car_stands_in_the_picture_too():
    for seed in range(60):
        trip, crashes = Trip(config_of("standing"), "driver", "never", seed), []
        drive(
            trip, seed, watch=lambda trip, crashes=crashes: crashes.append(trip.picture().crashed)
        )
        if crashes[-3]:
            break
    assert crashes[-3]
    snapshot, moments = trip.teaming.world.snapshot(0), trip.picture().moments
    assert moments[0].x == moments[-1].x == tuple(snapshot.position[:, 0])
    assert moments[-1].speed == tuple(snapshot.speed)
    assert moments[-1].time == pytest.approx(3.0)


@pytest.mark.parametrize("sees", [True, False])
@pytest.mark.parametrize("seat", ["driver", "vehicle_ai"])
def test_a_seat_sees_what_its_observation_holds(seat, sees):
    config = TeamConfig(driver="bart", ai_sees_attention=sees, duration=2.0)
    trip = Trip(config, seat, "always" if seat == "driver" else "rule", 1)
    start = trip.picture()
    assert (start.step, start.steps, start.applied, start.alert) == (0, 10, None, 0)
    assert (start.intended is None) == (seat == "driver")  # the other driver has acted already
    trip.advance(1)
    picture = trip.picture()
    known = seat == "driver" or sees
    assert (picture.distracted is not None) == known
    assert (picture.alert_left is not None) == known
    if seat == "driver":
        assert (picture.alert, picture.strength, picture.alert_left) == (1, 1.0, 7)
        assert picture.intended == 1


def test_the_score_is_the_sum_of_the_seats_rewards():
    for seat in ("driver", "vehicle_ai"):
        trip = a_trip("graded", seat, seed=2)
        totals = trip.teaming._teams.totals[0]
        assert trip.picture().score == pytest.approx(totals[8 if seat == "driver" else 9])


@pytest.mark.parametrize("seat", ["driver", "vehicle_ai"])
def test_a_trip_goes_on_where_its_record_ends(seat):
    for steps in (0, 1, 6):
        half = a_trip("paper", seat, 5, steps=steps, visitor="visitor-3").record()
        whole = Trip.resume(TripRecord.from_json(half.to_json()))
        assert whole.decisions == len(half)
        assert whole.record() == half
        rest = a_trip("paper", seat, 5, visitor="visitor-3", begun=half.begun).record()
        own = rest.intents if seat == "driver" else rest.alerts
        for step in range(len(half), len(rest)):
            whole.advance(own[step], rest.looking_away and rest.looking_away[step])
        assert whole.record() == rest


def test_a_partner_who_acts_otherwise_is_not_gone_on_with():
    half = a_trip(steps=6).record()
    with pytest.raises(ValueError, match=r"'random:0\.3' does not go as recorded by version"):
        Trip.resume(half, make_hmi("always", half.config))


def test_what_no_decision_is_is_refused_and_changes_nothing():
    trip = Trip(config_of("paper", 0.6), "driver", "never", 1)
    other = Trip(config_of("paper", 0.6), "vehicle_ai", "rule", 1)
    before = trip.record()
    for action, error in ((5, ValueError), (-1, ValueError), (1.5, TypeError), (True, TypeError)):
        with pytest.raises(error, match="action"):
            trip.advance(action)
    for away, error in ((2, ValueError), ("x", TypeError)):
        with pytest.raises(error, match="looking_away"):
            trip.advance(1, away)
    assert trip.record() == before
    with pytest.raises(ValueError, match="leave it out in this seat"):
        other.advance(0, 0)
    with pytest.raises(ValueError, match="action lies in 0 to 1"):
        other.advance(2)
    trip.advance(1, 0)
    with pytest.raises(ValueError, match="in every step of a trip, or in none"):
        trip.advance(1)
    trip.advance(1, 1)
    trip.advance(1, 1)
    with pytest.raises(ValueError, match="the trip is over"):
        trip.advance(1, 1)
    with pytest.raises(ValueError, match="seat is one of driver, vehicle_ai"):
        Trip(config_of("paper"), "passenger", "rule", 1)
    with pytest.raises(ValueError, match="unknown HMI"):
        Trip(config_of("paper"), "driver", "siren", 1)


def test_the_road_is_highway_envs():
    config = TeamConfig()
    road = Road.of(config.scene)
    x, y = np.array(road.ramp).T
    assert road.lanes == config.scene.lanes
    assert x[0] == 0.0
    assert (np.diff(x) >= 0).all()
    assert x[-1] == pytest.approx(config.scene.merge_end)
    assert y[-1] == pytest.approx(road.lanes * road.lane_width)  # right of them all
    start = Trip(config, "driver", "never", 1).picture().moments[0]
    ramp = min(zip(x, y, strict=True), key=lambda point: abs(point[0] - start.x[-1]))
    assert ramp[1] == pytest.approx(start.y[-1])
