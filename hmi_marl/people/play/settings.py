"""Settings of ``hmi-marl play``. This module imports nothing that an extra brings."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

from hmi_marl.agents.catalogue import make_driver_policy, make_hmi
from hmi_marl.checks import Checked, Whole
from hmi_marl.envs.config import DRIVER, VEHICLE_AI, TeamConfig, TeamSettings
from hmi_marl.envs.streams import Seed
from hmi_marl.people.record import SEATS, Seat

NEUTRAL = "average"
"""Driver of the teams in which a person drives: what an HMI that knows no better assumes."""


@dataclass(frozen=True)
class PlaySettings(Checked):
    """What visitors can choose, and how long their calibration and trial are.

    Raises:
        ValueError, TypeError: a value out of its range; the message names it.
    """

    team: TeamSettings = field(default_factory=TeamSettings)
    """Settings of the teams."""
    seats: tuple[Seat, ...] = SEATS
    """Seats that a visitor can choose."""
    hmis: tuple[str, ...] = ("when-distracted", "average", "random:0.2", "never")
    """HMIs that a visitor who drives can choose."""
    driver_policies: tuple[str, ...] = ("trained:driver", "rule")
    """Driver policies that a visitor in the vehicle AI's seat can choose."""
    drivers: tuple[str, ...] = ("homer", "bart", "marge", "lisa")
    """Drivers, whose traits draw their attention, for that visitor."""
    calibration_trips: Annotated[int, Whole(1, 100)] = 5
    """Trips of a calibration."""
    trial_trips: Annotated[int, Whole(1, 30)] = 1
    """Trips with each of the three HMIs of a trial."""
    seed: Seed = 0
    """Seed of the traffic and the orders of HMIs."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("seats", "hmis", "driver_policies", "drivers"):
            values = getattr(self, name)
            if isinstance(values, str) or not values:
                raise ValueError(f"{name} takes at least one name")
            if len(set(values)) < len(values):
                raise ValueError(f"{name} are different names, not {', '.join(values)}")
        if odd := [seat for seat in self.seats if seat not in SEATS]:
            raise ValueError(f"seats are {' and '.join(SEATS)}, not {odd[0]!r}")

    def config(self, seat: Seat, driver: str = NEUTRAL) -> TeamConfig:
        """Return the settings of a team with a person in this seat.

        Args:
            seat: of the person.
            driver: whose traits draw the attention, in the vehicle AI's seat.
        """
        return self.team.team(NEUTRAL if seat == DRIVER else driver)

    @property
    def measures(self) -> bool:
        """Whether there is a calibration: a person may drive, and alerts are the paper's."""
        return DRIVER in self.seats and self.config(DRIVER).alerts.plain

    def check(self) -> None:
        """Make every policy once, so that what does not fit is said before a visitor comes.

        Raises:
            ValueError, FileNotFoundError: a name that is not known, or does not fit the teams.
        """
        if DRIVER in self.seats:
            for name in self.hmis:
                make_hmi(name, self.config(DRIVER))
        if VEHICLE_AI in self.seats:
            for driver in self.drivers:
                config = self.config(VEHICLE_AI, driver)
                for name in self.driver_policies:
                    make_driver_policy(name, config)
