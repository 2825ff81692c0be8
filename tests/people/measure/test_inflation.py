"""Caution by the driver policy that fits best."""

import numpy as np
import pytest

from hmi_marl.agents.catalogue import make_driver_policy
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import DRIVERS, Traits
from hmi_marl.envs.scene import Scene
from hmi_marl.people.measure.hmis import calibration_alerts
from hmi_marl.people.measure.inflation import FEWEST_TRIPS, measure_inflation
from hmi_marl.people.measure.scripted import ScriptedPeople
from hmi_marl.people.trip import Trip

ATTENTION = (0.1, 0.3, 0.1)
CONFIG = TeamConfig(
    driver="cautious:0.1,0.3,0.1,7",
    duration=10.0,
    scene=Scene(vehicles=(15, 20)),
    end_at_crash=False,
)
GRID = np.arange(1.0, 12.01, 1.0)


def recorded(trips, lapses=0.0):
    """Trips of the shipped driver policy with inflation 7, which looks away by the chain."""
    policy, rng = make_driver_policy("trained:driver", CONFIG), np.random.default_rng(0)
    found = []
    for seed in range(trips):
        trip = Trip(CONFIG, "driver", calibration_alerts(CONFIG), seed, "calibration")
        seeds = np.array([seed], np.uint64)
        policy.reset(seeds)
        person = ScriptedPeople(Traits.from_array([[*ATTENTION, 7.0]]), CONFIG.alert_window, seeds)
        seen = np.zeros(1, np.int64)
        while not trip.over:
            intent = int(policy.act(trip.teaming.observe("driver"))[0])
            intent = int(rng.integers(5)) if rng.random() < lapses else intent
            trip.advance(intent, int(person.look(seen)[0]))
            seen = trip.teaming.alerted.copy()
        found.append(trip.record())
    return found


@pytest.fixture(scope="module")
def trips():
    return recorded(FEWEST_TRIPS, lapses=0.2)


def test_the_policys_own_inflation_fits_best(trips):
    policy = make_driver_policy("trained:driver", CONFIG)
    found = measure_inflation(trips, policy, ATTENTION, GRID)
    assert found.inflation.low <= 7.0 <= found.inflation.high
    assert abs(found.inflation.mean - 7.0) <= 2.0
    assert found.inflation.high - found.inflation.low < 8.0
    assert 0.6 <= found.explained <= 0.95
    assert found.steps == sum(len(trip) - sum(trip.looking_away) for trip in trips)
    assert max(found.log_likelihood) == 0.0


def test_few_trips_give_no_interval(trips):
    policy = make_driver_policy("trained:driver", CONFIG)
    found = measure_inflation(trips[:1], policy, ATTENTION, GRID)
    assert (found.inflation.low, found.inflation.high) == (1.0, 12.0)


@pytest.mark.parametrize("looks_at_the_road", [False, True])
def test_trips_that_say_nothing_give_the_average_inflation(looks_at_the_road):
    """Without a look at the road, or where the policy explains none of the actions."""
    policy, found = make_driver_policy("trained:driver", CONFIG), []
    for seed in range(FEWEST_TRIPS):
        trip = Trip(CONFIG, "driver", "never", seed, "calibration")
        for _ in range(20):
            trip.advance(0, int(not looks_at_the_road))  # always left
        found.append(trip.record())
    measured = measure_inflation(found, policy, ATTENTION, GRID)
    assert measured.log_likelihood == (0.0,) * len(GRID)
    assert measured.inflation.mean == DRIVERS["average"].inflation
    assert (measured.inflation.low, measured.inflation.high) == (1.0, 12.0)
    assert measured.explained == 0.0
    assert measured.steps == 100 * looks_at_the_road


def test_what_cannot_be_measured_is_refused(trips):
    with pytest.raises(TypeError, match="must give its probabilities"):
        measure_inflation(trips, make_driver_policy("rule", CONFIG), ATTENTION, GRID)
    policy = make_driver_policy("trained:driver", CONFIG)
    other = TeamConfig(driver="average", scene=Scene(vehicles=(1, 2)))
    far = Trip(other, "driver", "never", 1)
    far.advance(1, 0)
    with pytest.raises(ValueError, match="different settings of road or rewards"):
        measure_inflation([*trips, far.record()], policy, ATTENTION, GRID)
