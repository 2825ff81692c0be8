"""A visit, as a state machine without a clock, a browser or a database.

::

    welcome -> free trips in either seat
            -> calibration trips -> measured -> trial trips -> result

It is kept as JSON in the session of the visitor, and all methods return a new visit.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

from hmi_marl.envs.config import DRIVER, TeamConfig
from hmi_marl.envs.streams import episode_seed, team_seed
from hmi_marl.files import json_value
from hmi_marl.people.measure.hmis import blinded_order, calibration_alerts
from hmi_marl.people.play.settings import PlaySettings
from hmi_marl.people.record import Kind, Seat
from hmi_marl.typed_json import read_as

Stage = Literal["welcome", "trip", "over", "calibration", "measuring", "trial", "result"]
Way = Literal["", "free", "measured"]


class VisitError(ValueError):
    """Something that is not possible at this place of a visit."""


@dataclass(frozen=True)
class Plan:
    """A trip that is to begin."""

    config: TeamConfig
    seat: Seat
    partner: str
    kind: Kind
    seed: int


@dataclass(frozen=True)
class Visit:
    """Where a visitor is."""

    visitor: int
    """Number of the visitor."""
    way: Way = ""
    """Way through the visit that they chose."""
    seat: Seat = "driver"
    """Seat of free trips."""
    partner: str = ""
    """Policy in the other seat of free trips."""
    driver: str = ""
    """Driver whose traits draw the attention of free trips in the vehicle AI's seat."""
    begun: int = 0
    """Trips begun."""
    current: int | None = None
    """Number of the trip that is under way."""
    last: int | None = None
    """Number of the trip that ended last."""
    free: tuple[int, ...] = ()
    """Numbers of the free trips that have ended."""
    calibration: tuple[int, ...] = ()
    """Numbers of the calibration trips."""
    person: dict[str, Any] | None = None
    """What was measured, see :mod:`hmi_marl.people.play.measured`."""
    order: tuple[str, ...] = ()
    """The HMI of each trip of the trial, in their order."""
    trial: tuple[int, ...] = ()
    """Numbers of the trial's trips."""
    result: dict[str, Any] | None = None
    """What the trial showed."""

    def to_json(self) -> dict[str, Any]:
        """Return the visit as JSON content."""
        found: dict[str, Any] = json_value(self)
        return found

    @classmethod
    def from_json(cls, content: Any) -> Visit:
        """Make a visit from JSON content.

        Raises:
            ValueError: it is none.
        """
        return read_as(cls, content)

    def stage(self, settings: PlaySettings) -> Stage:
        """Return what comes next."""
        if self.current is not None:
            return "trip"
        if not self.way:
            return "welcome"
        if self.way == "free":
            return "over"
        if len(self.calibration) < settings.calibration_trips:
            return "calibration"
        if self.person is None:
            return "measuring"
        if len(self.trial) < len(self.order):
            return "trial"
        return "result"

    def choose_free(self, settings: PlaySettings, seat: str, partner: str, driver: str) -> Visit:
        """Choose free trips.

        Raises:
            VisitError: a choice that is not offered, or a trip is under way.
        """
        self._need_no_trip()
        if seat not in settings.seats:
            raise VisitError(f"there is no seat {seat!r}")
        driving = seat == DRIVER
        if partner not in (settings.hmis if driving else settings.driver_policies):
            raise VisitError(f"there is no partner {partner!r} for this seat")
        if not driving and driver not in settings.drivers:
            raise VisitError(f"there is no driver {driver!r}")
        found: Seat = "driver" if driving else "vehicle_ai"
        return replace(
            self, way="free", seat=found, partner=partner, driver="" if driving else driver
        )

    def choose_measured(self, settings: PlaySettings) -> Visit:
        """Choose the calibration and the trial, or go on with them.

        Raises:
            VisitError: they are not offered, or a trip is under way.
        """
        self._need_no_trip()
        if not settings.measures:
            raise VisitError("there is no calibration on this server")
        return replace(self, way="measured")

    def plan(self, settings: PlaySettings, team: TeamConfig | None = None) -> Plan:
        """Return the trip that is to begin.

        Args:
            settings: of the server.
            team: of the calibration trips until now, with which calibration and trial go on; that
                of the server if there are none.

        Raises:
            VisitError: none is.
        """
        stage = self.stage(settings)
        series = team_seed(settings.seed, self.visitor)
        seed = int(episode_seed(series, self.begun))
        if stage == "over":
            self.choose_free(settings, self.seat, self.partner, self.driver)  # is offered still
            config = settings.config(self.seat, self.driver)
            return Plan(config, self.seat, self.partner, "free", seed)
        config = settings.config("driver") if team is None else team
        if stage == "calibration":
            return Plan(config, "driver", calibration_alerts(config), "calibration", seed)
        if stage == "trial":
            assert self.person is not None
            hmi = self.order[len(self.trial)]
            return Plan(config, "driver", self.person["hmis"][hmi]["partner"], "trial", seed)
        raise VisitError("there is no trip to begin now")

    def begin(self, number: int) -> Visit:
        """Note that a trip has begun."""
        self._need_no_trip()
        return replace(self, current=number, begun=self.begun + 1)

    def finish(self) -> Visit:
        """Note that the trip under way has ended by itself."""
        number = self._trip()
        ended = replace(self, current=None, last=number)
        if self.way == "free":
            return replace(ended, free=(*self.free, number))
        if self.person is None:
            return replace(ended, calibration=(*self.calibration, number))
        return replace(ended, trial=(*self.trial, number))

    def stop(self) -> Visit:
        """Leave the way chosen; a trip under way stays as it is, and is not counted."""
        return replace(self, current=None, way="")

    def measured(self, person: dict[str, Any], settings: PlaySettings) -> Visit:
        """Note the measured traits, and draw the order of the trial's HMIs.

        The visit keeps it, so that a server that is started anew with other settings goes on alike.
        """
        if self.person is not None:
            return self
        hmis = blinded_order(self.visitor - 1, settings.seed)
        order = tuple(hmi for hmi in hmis for _ in range(settings.trial_trips))
        return replace(self, person=person, order=order)

    def judged(self, result: dict[str, Any]) -> Visit:
        """Note the trial's result."""
        return self if self.result is not None else replace(self, result=result)

    @property
    def own_trips(self) -> tuple[int, ...]:
        """Numbers of all trips that ended."""
        return self.free + self.calibration + self.trial

    @property
    def blinded_trips(self) -> tuple[int, ...]:
        """Numbers of the trial's trips while their HMIs are not to be known."""
        return self.trial if self.result is None else ()

    @property
    def hmis(self) -> tuple[str, ...]:
        """The HMIs of the trial, in their order."""
        return tuple(dict.fromkeys(self.order))

    def of_hmi(self, hmi: str) -> tuple[int, ...]:
        """Numbers of the trial's trips with an HMI."""
        trips = zip(self.trial, self.order, strict=False)  # the trial may go on
        return tuple(number for number, its in trips if its == hmi)

    def _trip(self) -> int:
        if self.current is None:
            raise VisitError("there is no trip under way")
        return self.current

    def _need_no_trip(self) -> None:
        if self.current is not None:
            raise VisitError("a trip is under way; end it first")
