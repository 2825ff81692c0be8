"""What a visit shows of its trips: sums, pictures, measured traits, and a belief."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hmi_marl.agents.adaptive.trait_estimator import TraitEstimator
from hmi_marl.agents.rollout import Observer
from hmi_marl.envs.config import DRIVER
from hmi_marl.envs.drivers import PAPER_DRIVERS
from hmi_marl.envs.rewards import ATTENTION_TERMS
from hmi_marl.envs.step_result import StepResult
from hmi_marl.envs.teaming import Teaming
from hmi_marl.exact.evidence import ChainEvidence
from hmi_marl.files import json_value
from hmi_marl.people.measure.person import measure_person
from hmi_marl.people.play.live import road_of
from hmi_marl.people.play.messages import hello, moment_content
from hmi_marl.people.record import TripRecord, replay
from hmi_marl.people.trip import Trip

_ONE_AT_A_TIME = threading.Semaphore(1)
"""Measuring takes seconds of a processor, which trips under way need."""


class _Sums(Observer):
    """Sums over a trip of team 0."""

    def __init__(self, seat: str) -> None:
        self.score = self.attention = self.speed = 0.0
        self.away = self.alerts = 0
        self._seat = seat

    def after(self, teaming: Teaming, result: StepResult) -> None:
        """Add a step."""
        self.score += float(result.rewards[self._seat][0])
        self.attention += sum(float(result.terms[name][0]) for name in ATTENTION_TERMS)
        self.speed += float(teaming.ego.speed[0])
        self.away += int(teaming.attention.distracted[0])
        self.alerts += int(teaming.alerted[0] > 0)


def summary(record: TripRecord) -> dict[str, Any]:
    """Return the sums over a trip: score, attention return, mean speed, share away, alerts."""
    sums = _Sums(record.seat)
    replay(record, observers=[sums])
    steps = max(1, len(record))
    return {
        "score": sums.score,
        "attention": sums.attention,
        "speed": sums.speed / steps,
        "away": sums.away / steps,
        "alerts": sums.alerts,
        "seconds": len(record) / record.config.scene.policy_frequency,
        "crashed": record.crashed,
    }


def pictures(record: TripRecord) -> dict[str, Any]:
    """Return all that is drawn of a trip: the road, and every simulator step."""
    fresh = Trip(
        record.config, record.seat, record.partner, record.seed, record.kind, world=record.world
    )
    moments, steps = [moment_content(fresh.picture().moments[-1])], []
    own = record.intents if record.seat == DRIVER else record.alerts
    for step, action in enumerate(own):
        fresh.advance(action, None if record.looking_away is None else record.looking_away[step])
        picture = fresh.picture()
        moments += map(moment_content, picture.moments)
        away = int(fresh.teaming.attention.distracted[0])
        steps.append({"alert": picture.alert, "away": away, "lane": picture.lane})
    pace = 1.0 / record.config.scene.policy_frequency
    about = hello(road_of(record.config.scene), record.seat, 0, pace, None, 0)
    return about | {"type": "film", "moments": moments, "steps_taken": steps}


def measured(name: str, records: Sequence[TripRecord]) -> dict[str, Any]:
    """Measure a visitor from calibration trips; JSON content of :class:`MeasuredPerson`.

    Args:
        name: of the driver that is made.
        records: of the trips.
    """
    with _ONE_AT_A_TIME:
        found: dict[str, Any] = json_value(measure_person(name, records).as_json())
    return found


class _Watching(Observer):
    """Show an estimator what the vehicle AI sees."""

    def __init__(self, estimator: TraitEstimator) -> None:
        self._estimator = estimator

    def seen(self, teaming: Teaming, observations: NDArray[np.float32]) -> None:
        """Update the belief."""
        self._estimator.observe(observations)


def belief(records: Sequence[TripRecord]) -> dict[str, float]:
    """Return what an HMI believes about a driver that it has only watched: p of the named four.

    By the exact evidence of a^H, v and a^A, over all trips of one person.
    """
    config = records[0].config
    estimator = TraitEstimator(ChainEvidence(PAPER_DRIVERS, config), config, change_rate=0.0)
    for record in records:
        estimator.next_trip()
        replay(record, observers=[_Watching(estimator)])
    named = estimator.belief.named()
    return {name: float(named[name][0]) for name in PAPER_DRIVERS}
