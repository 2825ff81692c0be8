"""Data of people in files: tables, trips to replay, and demonstrations to learn from.

``export`` writes, by format:

=============  =====================================================================================
``csv``        ``trips.csv``, ``steps.csv``, ``answers.csv`` and ``sessions.csv``: a row for each
               trip, for each step of each trip, for each answer, whose ``value`` is JSON, and for
               each visit, whose ``ids`` are those of a panel as JSON
``json``       ``trips/N.json`` for each trip: its :class:`TripRecord`
``parquet``    ``demonstrations/observed.parquet``, in the format of ``hmi-marl collect``, without
               truth, since a person's traits are not known
``minari``     a Minari dataset of the same
=============  =====================================================================================

Demonstrations hold trips of one team's settings in which a person drove, and alerts of one
strength; there is a folder ``demonstrations-K`` for each of several settings.
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, Literal

from hmi_marl.agents.rollout import Observer
from hmi_marl.demonstrations.dataset import MISSING, Demonstrations
from hmi_marl.demonstrations.recording import StepRecorder
from hmi_marl.demonstrations.recordings import Recording, from_recordings
from hmi_marl.envs.config import DRIVER, TeamConfig
from hmi_marl.envs.step_result import StepResult
from hmi_marl.envs.teaming import Teaming
from hmi_marl.envs.worlds import VEHICLE_ACTIONS
from hmi_marl.files import json_digest, json_value, make_folder, write_json, write_text
from hmi_marl.people.record import TripRecord, replay
from hmi_marl.people.store import Store, StoredTrip, visitor_name

Format = Literal["csv", "json", "parquet", "minari"]
FORMATS: tuple[Format, ...] = ("csv", "json", "parquet", "minari")

_TRIP = (
    "trip", "visitor", "session", "seat", "kind", "partner", "seed", "begun", "steps", "finished",
    "crashed", "alerts", "attention", "driver", "version", "stamp",
)  # fmt: skip
_STEP = (
    "trip", "visitor", "step", "intended_action", "action", "alert", "distracted", "accepted",
    "counter", "fatigue", "x", "y", "speed", "lane", "gap", "headway", "crashed",
)  # fmt: skip
_SESSION = ("visitor", "session", "kind", "made", "ids")
ANSWER_COLUMNS = ("visitor", "session", "question", "value", "made")


def demonstrations_of(records: Iterable[TripRecord]) -> Demonstrations:
    """Return the driving of trips of one team's settings, as data recorded elsewhere.

    Trips end with the crash, and trips without a step are left out. The driver's name is the
    visitor's.

    Raises:
        ValueError: no trip, trips of several settings, alerts of several strengths, or a trip that
            does not replay.
    """
    records = [record for record in records if len(record)]
    if not records:
        raise ValueError("there is no trip with a step to make demonstrations of")
    config = records[0].config
    if any(_team(record) != _team(records[0]) for record in records):
        raise ValueError("demonstrations are of one team's settings; take the trips of each apart")
    if config.alerts.choices > 2:
        raise ValueError("demonstrations hold alerts of one strength; use csv or json")
    layout = StepRecorder(config).layout
    about = {
        "environment": "merge_v0",
        "source": "people",
        "team": _team(records[0]),
        "stamps": sorted({f"{record.version} {record.stamp}" for record in records}),
    }
    return from_recordings(map(_recording, records), layout, about)


def _recording(record: TripRecord) -> Recording:
    recorder = StepRecorder(record.config)
    replay(record, observers=[recorder])
    crash = int(recorder.crash_step[0])
    steps = len(record) if crash == MISSING else crash + 1
    states = recorder.states[0, :steps]
    return Recording(
        parts={name: states[:, where] for name, where in recorder.layout.slices.items()},
        actions=recorder.applied[0, :steps],
        alerts=recorder.alerts[0, :steps],
        driver=record.visitor or None,
        crashed=crash != MISSING,
    )


def _team(record: TripRecord) -> dict[str, Any]:
    """Settings of a trip's team but its driver, as demonstrations keep them."""
    return {name: value for name, value in json_value(record.config).items() if name != "driver"}


def export(
    store: Store, out: Path, formats: Sequence[Format] = ("csv", "json"), visitor: int | None = None
) -> list[Path]:
    """Write the data of all people, or of one, into a folder.

    Args:
        store: the database.
        out: the folder; files of the same names are replaced.
        formats: any of ``FORMATS``.
        visitor: number of the one person.

    Returns:
        What was written; a folder for trips as JSON.

    Raises:
        ValueError: no such visitor, a damaged database, a trip that does not replay, or no trips
            that can be demonstrations where these are asked for.
        FileExistsError: a Minari dataset is there already.

    Nothing has been written after such an error.
    """
    if visitor is not None and visitor not in store.visitors():
        raise ValueError(f"{store.path} has no visitor {visitor}")
    trips = list(store.trips(visitor))
    learnable = {"parquet", "minari"} & set(formats)
    datasets = _demonstrations(trips, out) if learnable else {}
    if "minari" in formats:
        from hmi_marl.demonstrations.minari import check_for_minari, export_minari

        for folder, data in datasets.items():
            check_for_minari(data.observed, folder)
    tables: dict[str, str] = {}
    if "csv" in formats:
        steps = (row for trip in trips for row in _step_rows(trip))
        tables = {
            "trips.csv": _csv(_TRIP, map(_trip_row, trips)),
            "steps.csv": _csv(_STEP, steps),
            "answers.csv": _csv(ANSWER_COLUMNS, _answer_rows(store, visitor)),
            "sessions.csv": _csv(_SESSION, _session_rows(store, visitor)),
        }
    make_folder(out)
    written: list[Path] = []
    for name, text in tables.items():
        write_text(out / name, text)
        written.append(out / name)
    if "json" in formats:
        folder = out / "trips"
        make_folder(folder)
        for trip in trips:
            write_json(folder / f"{trip.number}.json", trip.record.to_json())
        written.append(folder)
    for folder, data in datasets.items():
        if "parquet" in formats:
            from hmi_marl.demonstrations.parquet import OBSERVED, write_demonstrations

            make_folder(folder)
            write_demonstrations(folder, data)
            written.append(folder / OBSERVED)
        if "minari" in formats:
            written.append(export_minari(data.observed, folder))
    return written


def _demonstrations(trips: list[StoredTrip], out: Path) -> dict[Path, Demonstrations]:
    """The trips that people drove, by a folder for each kind of team."""
    groups: dict[str, list[TripRecord]] = {}
    for trip in trips:
        record = trip.record
        if record.seat == DRIVER and len(record) and record.config.alerts.choices == 2:
            groups.setdefault(json_digest(_team(record)), []).append(record)
    if not groups:
        raise ValueError(
            "there is no trip for demonstrations, in which a person drove and alerts had one "
            "strength; export csv or json"
        )
    several = len(groups) > 1
    return {
        out / f"demonstrations{f'-{number}' if several else ''}": demonstrations_of(records)
        for number, records in enumerate(groups.values())
    }


def _trip_row(trip: StoredTrip) -> tuple[Any, ...]:
    record = trip.record
    return (
        trip.number, record.visitor, trip.session, record.seat, record.kind, record.partner,
        record.seed, record.begun, len(record), int(record.finished), int(record.crashed),
        sum(alert > 0 for alert in record.alerts),
        "chain" if record.looking_away is None else "person", _driver(record.config),
        record.version, record.stamp,
    )  # fmt: skip


def _driver(config: TeamConfig) -> str:
    only = config.only_driver
    return "population" if only is None else only.name


def _step_rows(trip: StoredTrip) -> list[tuple[Any, ...]]:
    rows = _Rows(trip)
    replay(trip.record, observers=[rows])
    return rows.rows


class _Rows(Observer):
    """Rows of steps.csv."""

    def __init__(self, trip: StoredTrip) -> None:
        self.rows: list[tuple[Any, ...]] = []
        self._key = trip.number, trip.record.visitor

    def after(self, teaming: Teaming, result: StepResult) -> None:
        """Note the step of team 0."""
        ego, attention = teaming.ego, teaming.attention
        actions = (VEHICLE_ACTIONS[int(of[0])] for of in (teaming.intended, teaming.applied))
        whole = [teaming.alerted, attention.distracted, attention.accepted]
        whole += [attention.counter, attention.fatigue]
        numbers = [ego.x, ego.y, ego.speed, ego.lane, ego.gap, teaming.time_headway()]
        self.rows.append(
            (
                *self._key, len(self.rows), *actions, *(int(of[0]) for of in whole),
                *(of[0].item() for of in numbers), int(ego.crashed[0]),
            )
        )  # fmt: skip


def _answer_rows(store: Store, visitor: int | None) -> Iterator[tuple[Any, ...]]:
    for each in store.answers(visitor=visitor):
        value = json.dumps(each.value, allow_nan=False)
        yield visitor_name(each.visitor), each.session, each.question, value, each.made


def _session_rows(store: Store, visitor: int | None) -> Iterator[tuple[Any, ...]]:
    """Rows of sessions.csv; ids are those of a panel, where a study keeps them."""
    for each in store.sessions(visitor):
        ids = each.state.get("ids", {}) if isinstance(each.state, dict) else {}
        yield visitor_name(each.visitor), each.id, each.kind, each.made, json.dumps(ids)


def _csv(columns: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows([_cell(value) for value in row] for row in rows)
    return text.getvalue()


def _cell(value: Any) -> Any:
    """Mark a text that a spreadsheet would take for a formula."""
    return f"'{value}" if isinstance(value, str) and value[:1] in "=+-@\t\r" and value else value
