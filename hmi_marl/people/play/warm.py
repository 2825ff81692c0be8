"""Compile and import what a trip needs, before the first visitor waits for it."""

from __future__ import annotations

from hmi_marl.envs.config import DRIVER
from hmi_marl.people.play.live import road_of
from hmi_marl.people.play.settings import PlaySettings
from hmi_marl.people.trip import Trip


def warm(settings: PlaySettings) -> None:
    """Take a step in each seat, and import what measuring a person needs."""
    from scipy import stats  # noqa: F401  # takes half a second

    for seat in settings.seats:
        driving = seat == DRIVER
        driver = settings.drivers[0]
        config = settings.config(seat, driver)
        road_of(config.scene)
        partner = settings.hmis[0] if driving else settings.driver_policies[0]
        trip = Trip(config, seat, partner, settings.seed)
        trip.advance(0, 0 if driving else None)
        trip.picture()
        trip.record()
