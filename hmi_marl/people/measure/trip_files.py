"""Recorded trips from files, and which of them traits can be measured from."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from hmi_marl.people.database import is_sqlite
from hmi_marl.people.record import TripRecord
from hmi_marl.people.store import Store
from hmi_marl.reading import read_json

MOST_TRIPS = 10_000
"""Most trips that are read at once; 20 s each, 56 hours."""


def read_trips(paths: Sequence[Path]) -> list[TripRecord]:
    """Read trips from files, folders and databases.

    Args:
        paths: JSON files, each of one trip or a list of trips; folders of such files, or of an
            export with them; or databases of hmi-marl play.

    Raises:
        ValueError: no trip, too many, or a file that holds something else; the message names it.
        OSError: a file that cannot be read.
    """
    found: list[TripRecord] = []
    for record in (each for path in paths for each in _trips(path)):
        if len(found) == MOST_TRIPS:
            raise ValueError(f"more than {MOST_TRIPS} trips; name fewer recordings")
        found.append(record)
    if not found:
        raise ValueError("there are no trips; name files that hmi-marl play has recorded")
    return found


def _trips(path: Path) -> Iterator[TripRecord]:
    if path.is_file() and is_sqlite(path):
        with Store(path, make=False) as store:
            yield from (trip.record for trip in store.trips())
        return
    for file in _files(path):
        content = read_json(file)
        for place, one in enumerate(content if isinstance(content, list) else [content]):
            try:
                yield TripRecord.from_json(one)
            except ValueError as error:
                where = f"{file}, trip {place}" if isinstance(content, list) else str(file)
                raise ValueError(f"{where}: {error}") from None


def _files(path: Path) -> list[Path]:
    if not path.is_dir():
        return [path]
    files = sorted(path.glob("*.json")) or sorted(path.glob("trips/*.json"))
    if not files:
        raise ValueError(f"there is no .json file in the folder {path}")
    return files


def measurable(trips: Sequence[TripRecord], visitor: str | None = None) -> list[TripRecord]:
    """Return the trips of one person in the driver's seat in which looking away was seen.

    Args:
        trips: of one or several persons.
        visitor: code of the person; needed only where there are several.

    Raises:
        ValueError: no such trip, trips of several persons or with different windows or alerts.
    """
    own = [trip for trip in trips if visitor is None or trip.visitor == visitor]
    if not own:
        known = ", ".join(sorted({trip.visitor or "(none)" for trip in trips}))
        raise ValueError(f"no trip is of visitor {visitor!r}; there are trips of {known}")
    seen = [trip for trip in own if trip.seat == "driver" and trip.looking_away and len(trip)]
    if not seen:
        raise ValueError(
            f"in none of {len(own)} trips a person drove with the second task, whose openings "
            "traits are measured from; record a calibration with hmi-marl play"
        )
    codes = sorted({trip.visitor for trip in seen})
    if len(codes) > 1:
        raise ValueError(
            f"the trips are of {len(codes)} persons; choose one with --visitor: {', '.join(codes)}"
        )
    windows = {trip.config.alert_window for trip in seen}
    if len(windows) > 1:
        raise ValueError(
            f"the trips have different windows of alerts ({sorted(windows)} steps); name those "
            "with the same"
        )
    if not all(trip.config.alerts.plain for trip in seen):
        raise ValueError("traits are measured from the paper's alerts alone, not graded ones")
    return seen
