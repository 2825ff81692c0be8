"""Trips of made-up people, for tests."""

import numpy as np

from hmi_marl.envs.alerts import Fatigue
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import TraitDistributions
from hmi_marl.envs.scene import Scene
from hmi_marl.people.trip import Trip

CONFIGS = {
    "paper": {"driver": ["bart", "homer"]},
    "graded": {
        "driver": TraitDistributions(),
        "alert_strengths": (0.25, 0.5, 1.0),
        "fatigue": Fatigue(),
        "reward": "individual",
    },
    "standing": {"driver": "bart", "end_at_crash": False, "ai_sees_attention": False},
}
KINDS = ("free", "calibration", "trial")


def config_of(name, duration=3.0, vehicles=(10, 20)):
    """Settings with much traffic."""
    return TeamConfig(duration=duration, scene=Scene(vehicles=vehicles), **CONFIGS[name])


def reckless(rng, step):
    """Mostly speed up, and change lanes."""
    return int(rng.choice([3, 3, 0, 2, 1, 4]))


def drive(trip, seed, seen=None, steps=None, watch=lambda trip: None):
    """Take random decisions to the end, or so many; with real attention where ``seen``."""
    rng = np.random.default_rng(seed)
    alerts = trip.config.alerts.choices
    while not trip.over and (steps is None or trip.decisions < steps):
        if trip.seat == "driver":
            action = reckless(rng, trip.decisions)
        else:
            action = int(rng.integers(0, alerts))
        trip.advance(action, int(rng.random() < 0.4) if seen else None)
        watch(trip)
    return trip


def a_trip(name="paper", seat="driver", seed=1, seen=True, steps=None, world="batched", **more):
    """A driven trip."""
    partner = "random:0.3" if seat == "driver" else "rule"
    config = config_of(name)
    trip = Trip(config, seat, partner, seed, "calibration", world=world, **more)
    return drive(trip, seed, seen and seat == "driver", steps)
