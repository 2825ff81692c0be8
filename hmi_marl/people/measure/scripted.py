"""Scripted persons: simulated people in the driver's seat, to judge measurements with known traits.

A scripted person opens and closes the second task by the chain of their traits, and keeps the
speed. As a person does, they see the alert of a step only when it has been taken. Draws depend on
the episode's seed and the step alone, so that a person drives the same trip in :class:`Trip` and
among others in :func:`simulate_calibrations`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from hmi_marl.agents.catalogue import make_hmi
from hmi_marl.envs.attention import distraction_probability, next_acceptance
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import Driver, Traits
from hmi_marl.envs.streams import Stream, episode_seed, team_seed, uniform
from hmi_marl.envs.teaming import Teaming
from hmi_marl.envs.worlds import VEHICLE_ACTIONS
from hmi_marl.people.measure.hmis import calibration_alerts
from hmi_marl.people.record import TripRecord
from hmi_marl.people.trip import Trip

KEEP_SPEED = VEHICLE_ACTIONS.index("keep_speed")


class ScriptedPeople:
    """N persons with known traits, each on a trip.

    Args:
        traits: of the N persons.
        window: N of the environment, in steps.
        seeds: of their episodes, shape (N,).
    """

    def __init__(self, traits: Traits, window: int, seeds: NDArray[np.uint64]) -> None:
        self._traits, self._window, self._seeds = traits, window, seeds
        self._away, self._accepted, self._counter = np.zeros((3, len(traits)), np.int64)
        self._step = 0

    def look(self, seen: NDArray[np.int64]) -> NDArray[np.int64]:
        """Decide whether to look away in the next step, d_t of shape (N,).

        Args:
            seen: alert of the step before, shape (N,); 0 in the first.
        """
        self._accepted, self._counter = next_acceptance(
            self._accepted, self._counter, seen, self._window
        )
        chance = self.chance(self._away, self._accepted)
        draw = uniform(self._seeds, Stream.ATTENTION, self._step)
        self._away = (draw < chance).astype(np.int64)
        self._step += 1
        return self._away

    def chance(self, away: NDArray[np.int64], helped: NDArray[np.int64]) -> NDArray[np.float64]:
        """Probability of looking away, after d_{t-1} and with i_t."""
        traits = self._traits
        return distraction_probability(away, helped, traits.beta, traits.alpha, traits.eta)


def simulate_calibrations(
    traits: Traits | Sequence[Driver],
    config: TeamConfig,
    trips: int,
    seed: int = 0,
    people: Callable[..., ScriptedPeople] = ScriptedPeople,
) -> list[list[TripRecord]]:
    """Let P scripted persons drive calibration trips, all persons side by side.

    Args:
        traits: of the P persons, or drivers with these traits.
        config: settings of the teams; ``end_at_crash=False`` keeps every trip whole.
        trips: number of trips of each person.
        seed: of all; person p's k-th trip has the seed episode_seed(team_seed(seed, p), k).
        people: makes the persons of a trip, for others than by the chain.

    Returns:
        The trips of each person.
    """
    traits = traits if isinstance(traits, Traits) else Traits.of(traits)
    series = team_seed(seed, np.arange(len(traits)))
    found: list[list[TripRecord]] = [[] for _ in series]
    for place in range(trips):
        for person, trip in enumerate(_trips(traits, config, episode_seed(series, place), people)):
            found[person].append(trip)
    return found


def _trips(
    traits: Traits,
    config: TeamConfig,
    seeds: NDArray[np.uint64],
    people: Callable[..., ScriptedPeople],
) -> Iterator[TripRecord]:
    """One trip of each person."""
    name = calibration_alerts(config)
    teaming, hmi = Teaming(config, len(seeds), "batched"), make_hmi(name, config)
    teaming.reset(seeds)
    hmi.reset(seeds)
    persons = people(traits, config.alert_window, seeds)
    keep, seen = np.full(len(seeds), KEEP_SPEED), np.zeros(len(seeds), np.int64)
    away, alerts, length = [], [], np.zeros(len(seeds), np.int64)
    while not teaming.over.all():
        length += ~teaming.over
        away.append(persons.look(seen))
        teaming.turn(keep, hmi.act, looking_away=away[-1])
        seen = teaming.alerted.copy()
        alerts.append(seen)
    looked, alerted = np.stack(away, axis=1).tolist(), np.stack(alerts, axis=1).tolist()
    for person, steps in enumerate(length.tolist()):
        yield TripRecord(
            config,
            int(seeds[person]),
            "driver",
            "calibration",
            name,
            (KEEP_SPEED,) * steps,
            tuple(alerted[person][:steps]),
            tuple(looked[person][:steps]),
            bool(teaming.crashed[person]),
        )


def drive_calibration(traits: Traits, config: TeamConfig, seed: int) -> TripRecord:
    """Let one scripted person drive one trip through :class:`Trip`, as the server does."""
    trip = Trip(config, "driver", calibration_alerts(config), seed, "calibration", begun="")
    person = ScriptedPeople(traits, config.alert_window, np.array([seed], np.uint64))
    seen = np.zeros(1, np.int64)
    while not trip.over:
        trip.advance(KEEP_SPEED, int(person.look(seen)[0]))
        seen = trip.teaming.alerted.copy()
    return trip.record()
