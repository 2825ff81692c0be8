"""One person's traits: measured, tested, and shown beside the four drivers of the paper."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import DRIVERS, TRAIT_NAMES, Driver
from hmi_marl.exact.identify import StochasticPolicy
from hmi_marl.files import json_value
from hmi_marl.people.measure.assumptions import AssumptionTest, check_assumptions
from hmi_marl.people.measure.hmis import TrialHMI, best_hmis
from hmi_marl.people.measure.inflation import MeasuredInflation, measure_inflation
from hmi_marl.people.measure.steps import SEEN_AFTER
from hmi_marl.people.measure.traits import MeasuredAttention, measure_attention, minutes_needed
from hmi_marl.people.record import TripRecord
from hmi_marl.reporting.statistics import Estimate

WIDTHS = (0.2, 0.1, 0.05)
"""Widths of intervals for which the minutes needed are given."""


@dataclass(frozen=True, eq=False)
class MeasuredPerson:
    """All that is measured of one person."""

    name: str
    """Name of the driver made from it."""
    trips: int
    minutes: float
    """Length of the trips."""
    window: int
    """N, in steps."""
    attention: MeasuredAttention
    inflation: MeasuredInflation | None
    """None if no driver policy was asked."""
    tests: tuple[AssumptionTest, ...]
    needed: dict[float, dict[str, float | None]]
    """Minutes after which intervals are this wide, by width and trait."""
    hmis: dict[str, TrialHMI]
    """What the HMIs of a trial are worth to this person, if the traits are right."""

    @property
    def driver(self) -> Driver:
        """Driver with the estimated traits; with the average inflation if it was not measured."""
        found = self.estimates
        inflation = (
            found["inflation"].mean if "inflation" in found else DRIVERS["average"].inflation
        )
        beta, alpha, eta = (found[trait].mean for trait in TRAIT_NAMES[:3])
        return Driver(self.name, beta, alpha, eta, inflation)

    @property
    def estimates(self) -> dict[str, Estimate]:
        """Estimates and intervals of the measured traits, by name."""
        found = {trait: getattr(self.attention, trait) for trait in TRAIT_NAMES[:3]}
        return found if self.inflation is None else found | {"inflation": self.inflation.inflation}

    def as_json(self) -> dict[str, Any]:
        """JSON content."""
        return {
            "driver": json_value(self.driver),
            "trips": self.trips,
            "minutes": self.minutes,
            "window": self.window,
            "estimates": {name: each.as_json() for name, each in self.estimates.items()},
            "counts": self.attention.counts.as_dict(),
            "inflation": json_value(self.inflation),
            "tests": json_value(self.tests),
            "minutes_needed": json_value(self.needed),
            "hmis": json_value(self.hmis),
        }


def measure_person(
    name: str,
    trips: Sequence[TripRecord],
    policy: StochasticPolicy | None = None,
    widths: Sequence[float] = WIDTHS,
    seed: int = 0,
) -> MeasuredPerson:
    """Measure one person.

    Args:
        name: of the driver made from it.
        trips: of this person in the driver's seat with the second task; see :func:`measurable`.
        policy: driver policy by which caution is measured; None leaves it out.
        widths: of intervals, for which the minutes needed are given.
        seed: of the draws of tests and intervals.

    Raises:
        ValueError: trips that do not fit together.
    """
    config: TeamConfig = trips[0].config
    window = config.alert_window
    pairs = [(trip.looking_away or (), trip.alerts) for trip in trips]
    attention = measure_attention(pairs, window, SEEN_AFTER)
    per_minute = 60.0 * config.scene.policy_frequency
    minutes = sum(map(len, trips)) / per_minute
    inflation = None
    if policy is not None:
        known = attention.beta.mean, attention.alpha.mean, attention.eta.mean
        inflation = measure_inflation(trips, policy, known, seed=seed)
    person = MeasuredPerson(
        name,
        len(trips),
        minutes,
        window,
        attention,
        inflation,
        check_assumptions(attention.steps, seed),
        {width: minutes_needed(attention.counts, minutes, width) for width in widths},
        {},
    )
    person.hmis.update(best_hmis(person.driver, config))
    return person
