"""The database of people: visitors, their sessions, trips and answers, in one SQLite file.

Every method that writes is one transaction, which is on the disk when it returns: what was
acknowledged to a person survives ``kill -9`` and a power cut. Several threads and processes may
write at the same time; each process opens its own :class:`Store`.

A visitor is a number, without a name. The code that they are given opens and deletes their data; of
it the file holds a hash alone.
"""

from __future__ import annotations

import hashlib
import json
import secrets
import sqlite3
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from hmi_marl.checks import shown
from hmi_marl.people.database import Database
from hmi_marl.people.record import TIME, Progress, TripRecord
from hmi_marl.people.tables import OF_VISITOR, SCHEMA, TABLES

_ALPHABET = "23456789ABCDEFGHJKLMNPQRSTUVWXYZ"
"""Letters and digits that are not mistaken for each other."""
_CODE = 16
"""Letters of a code: 80 bits."""


@dataclass(frozen=True)
class Visitor:
    """A person."""

    number: int
    code: str
    """Opens and deletes their data; known to them alone."""

    @property
    def name(self) -> str:
        """Name in trips and exports, such as visitor-17."""
        return visitor_name(self.number)


@dataclass(frozen=True)
class Session:
    """One visit of a person, such as play or a study."""

    id: str
    visitor: int
    kind: str
    state: Any
    """Where it is, as JSON content."""
    made: str


@dataclass(frozen=True)
class StoredTrip:
    """A trip, with its number in the database."""

    number: int
    session: str
    record: TripRecord


@dataclass(frozen=True)
class Answer:
    """One answer."""

    visitor: int
    session: str
    question: str
    value: Any
    """JSON content."""
    made: str


def visitor_name(number: int) -> str:
    """Return a visitor's name in trips and exports."""
    return f"visitor-{number}"


class Store(Database):
    """The database in a file, which is made if there is none.

    Raises:
        ValueError, OSError: see :class:`Database`. Methods also raise ValueError for what is not
            there.
    """

    def __init__(self, path: Path, make: bool = True) -> None:
        super().__init__(path, TABLES, SCHEMA, make)

    def new_visitor(self) -> Visitor:
        """Note a new person and return them with their code, which is not shown again."""
        code = "".join(secrets.choice(_ALPHABET) for _ in range(_CODE))
        with self.writing() as base:
            cursor = base.execute(
                "INSERT INTO visitors (code, made) VALUES (?, ?)", (_hashed(code), _now())
            )
        assert cursor.lastrowid is not None
        return Visitor(cursor.lastrowid, code)

    def find_visitor(self, code: str) -> int | None:
        """Return the number of the person with this code, or None."""
        found = self.rows("SELECT number FROM visitors WHERE code = ?", _hashed(code))
        return found[0][0] if found else None

    def visitors(self) -> list[int]:
        """Return the numbers of all people."""
        return [number for (number,) in self.rows("SELECT number FROM visitors ORDER BY number")]

    def counts(self) -> dict[str, int]:
        """Return the number of visitors, sessions, trips, decisions and answers."""
        return {name: self.rows(f"SELECT count(*) FROM {name}")[0][0] for name in OF_VISITOR}

    def delete_visitor(self, code: str) -> dict[str, int]:
        """Delete everything of the person with this code, also from the free parts of the file.

        Returns:
            Number of rows deleted of each table.

        Raises:
            ValueError: no visitor has this code.
        """
        with self.writing() as base:
            found = base.execute(
                "SELECT number FROM visitors WHERE code = ?", (_hashed(code),)
            ).fetchone()
            if found is None:
                raise ValueError(f"no visitor in {self.path} has this code; check its letters")
            counts = {
                name: base.execute(f"SELECT count(*) FROM {where}", found).fetchone()[0]
                for name, where in OF_VISITOR.items()
            }
            base.execute("DELETE FROM visitors WHERE number = ?", found)
        self.forget()
        return counts

    def new_session(self, visitor: int, kind: str, state: Any = None) -> str:
        """Note a new visit of a person and return its id, which is hard to guess."""
        identity = secrets.token_urlsafe(18)
        with self.writing() as base:
            if not base.execute("SELECT 1 FROM visitors WHERE number = ?", (visitor,)).fetchone():
                raise ValueError(f"there is no visitor {visitor}")
            base.execute(
                "INSERT INTO sessions VALUES (?, ?, ?, ?, ?)",
                (identity, visitor, kind, _json(state), _now()),
            )
        return identity

    def session(self, identity: str) -> Session | None:
        """Return a visit by its id, or None."""
        return next(self._sessions("WHERE id = ?", identity), None)

    def sessions(self, visitor: int | None = None) -> Iterator[Session]:
        """Yield all visits, or those of a person, in the order in which they began."""
        if visitor is None:
            return self._sessions("ORDER BY rowid")
        return self._sessions("WHERE visitor = ? ORDER BY rowid", visitor)

    def save_session(self, identity: str, state: Any) -> None:
        """Keep where a visit is.

        Raises:
            ValueError: there is no such visit.
        """
        with self.writing() as base:
            self._update(base, "UPDATE sessions SET state = ? WHERE id = ?", _json(state), identity)

    def answer(self, session: str, question: str, value: Any) -> Any:
        """Keep the answer to a question of a visit, and return the one that is kept.

        The first answer stays: one that is sent again after a lost connection changes nothing.

        Raises:
            ValueError: there is no such visit.
        """
        with self.writing() as base:
            self._need_session(base, session)
            base.execute(
                "INSERT OR IGNORE INTO answers VALUES (?, ?, ?, ?)",
                (session, question, _json(value), _now()),
            )
            kept = base.execute(
                "SELECT value FROM answers WHERE session = ? AND question = ?", (session, question)
            ).fetchone()
        return self.parsed(kept[0])

    def answers(self, session: str | None = None, visitor: int | None = None) -> Iterator[Answer]:
        """Yield all answers, or those of a visit or a person, oldest first."""
        where, values = _restricted({"answers.session": session, "visitor": visitor})
        rows = self.rows(
            "SELECT visitor, session, question, value, answers.made FROM answers "
            f"JOIN sessions ON sessions.id = session {where} ORDER BY answers.made, visitor",
            *values,
        )
        for who, its_session, question, value, made in rows:
            yield Answer(who, its_session, question, self.parsed(value), made)

    def begin_trip(self, session: str, record: TripRecord) -> int:
        """Note a trip of a visit, with the decisions it has, and return its number.

        Raises:
            ValueError: there is no such visit.
        """
        head = replace(record, intents=(), alerts=(), looking_away=None, crashed=False, digest="")
        with self.writing() as base:
            self._need_session(base, session)
            cursor = base.execute(
                "INSERT INTO trips (session, head, seen, crashed, digest, finished) "
                "VALUES (?, ?, 0, 0, '', 0)",
                (session, _json(head.to_json())),
            )
            assert cursor.lastrowid is not None
            self._save_trip(base, cursor.lastrowid, record)
        return cursor.lastrowid

    def save_trips(self, records: Mapping[int, TripRecord]) -> None:
        """Keep what was decided since in any number of trips, in one transaction.

        Args:
            records: the trips until now, by their numbers.

        Raises:
            ValueError: no such trip, or one that is further or went otherwise; none is kept then.
        """
        with self.writing() as base:
            for number, record in records.items():
                self._save_trip(base, number, record)

    def add_decisions(self, progress: Mapping[int, Progress]) -> None:
        """Keep new decisions of any number of trips, in one transaction.

        Args:
            progress: the decisions that follow those that are kept, by the numbers of the trips.

        Raises:
            ValueError: no such trip, or decisions that do not follow; none is kept then.
        """
        with self.writing() as base:
            for number, new in progress.items():
                if not new.steps:
                    continue
                last = self._last_step(base, number)
                if new.first != (0 if last is None else last[0] + 1):
                    raise self._went_otherwise(base, number)
                self._add(base, number, new, new.steps[0][2] is not None)

    def trip(self, number: int) -> StoredTrip:
        """Return a trip by its number.

        Raises:
            ValueError: there is no such trip.
        """
        found = next(self._trips("WHERE trips.number = ?", number), None)
        if found is None:
            raise ValueError(f"there is no trip {number} in {self.path}")
        return found

    def trips(
        self, visitor: int | None = None, session: str | None = None, finished: bool | None = None
    ) -> Iterator[StoredTrip]:
        """Yield all trips, or those of a person or a visit, in the order in which they began.

        Args:
            finished: whether they have ended; either by default.
        """
        where, values = _restricted(
            {"visitor": visitor, "trips.session": session, "finished": finished}
        )
        return self._trips(f"{where} ORDER BY trips.number", *values)

    def _sessions(self, rest: str, *values: Any) -> Iterator[Session]:
        columns = "id, visitor, kind, state, made"
        rows = self.rows(f"SELECT {columns} FROM sessions {rest}", *values)
        for identity, visitor, kind, state, made in rows:
            yield Session(identity, visitor, kind, self.parsed(state), made)

    def _trips(self, rest: str, *values: Any) -> Iterator[StoredTrip]:
        query = "SELECT trips.number FROM trips JOIN sessions ON sessions.id = session"
        for (number,) in self.rows(f"{query} {rest}", *values):
            rows = self.rows(  # one query, so that it is one moment of a trip that goes on
                "SELECT session, head, seen, crashed, digest, step, intent, alert, away FROM trips "
                "LEFT JOIN decisions ON trip = number WHERE number = ? ORDER BY step",
                number,
            )
            if rows:  # else it has been deleted meanwhile
                yield self._trip(number, rows)

    def _trip(self, number: int, rows: list[Any]) -> StoredTrip:
        session, head, seen, crashed, digest = rows[0][:5]
        steps = [row[5:] for row in rows if row[5] is not None]
        try:
            if [step[0] for step in steps] != list(range(len(steps))):
                raise ValueError("a decision is missing")
            _, intents, alerts, away = map(list, zip(*steps, strict=True)) if steps else [[]] * 4
            changed = {
                "intents": intents,
                "alerts": alerts,
                "looking_away": away if seen else None,
                "crashed": bool(crashed),
                "digest": digest,
            }
            return StoredTrip(number, session, TripRecord.from_json(self.parsed(head) | changed))
        except (TypeError, ValueError) as error:
            raise self.damaged(f"trip {number}: {error}") from None

    def _need_session(self, base: sqlite3.Connection, identity: str) -> None:
        if not base.execute("SELECT 1 FROM sessions WHERE id = ?", (identity,)).fetchone():
            raise ValueError(f"there is no session {shown(identity)}")

    def _save_trip(self, base: sqlite3.Connection, number: int, record: TripRecord) -> None:
        """Add the decisions that are not kept yet."""
        away = record.looking_away
        steps = list(zip(record.intents, record.alerts, away or [None] * len(record), strict=True))
        last = self._last_step(base, number)
        first = 0 if last is None else last[0] + 1
        if first > len(steps) or (last is not None and last[1:] != steps[first - 1]):
            raise self._went_otherwise(base, number)
        self._add(
            base,
            number,
            Progress(first, tuple(steps[first:]), record.crashed, record.digest, record.finished),
            away is not None,
        )

    def _last_step(self, base: sqlite3.Connection, number: int) -> Any:
        return base.execute(
            "SELECT step, intent, alert, away FROM decisions WHERE trip = ? "
            "ORDER BY step DESC LIMIT 1",
            (number,),
        ).fetchone()

    def _went_otherwise(self, base: sqlite3.Connection, number: int) -> ValueError:
        if not base.execute("SELECT 1 FROM trips WHERE number = ?", (number,)).fetchone():
            return ValueError(f"{self.path} has no trip {number}")  # its visitor deleted it
        return ValueError(f"trip {number} in {self.path} is further, or went otherwise")

    def _add(self, base: sqlite3.Connection, number: int, new: Progress, seen: bool) -> None:
        self._update(
            base,
            "UPDATE trips SET seen = ?, crashed = ?, digest = ?, finished = ? WHERE number = ?",
            seen, new.crashed, new.digest, new.finished, number,
        )  # fmt: skip
        base.executemany(
            "INSERT INTO decisions VALUES (?, ?, ?, ?, ?)",
            [(number, step, *values) for step, values in enumerate(new.steps, start=new.first)],
        )

    def _update(self, base: sqlite3.Connection, query: str, *values: Any) -> None:
        if base.execute(query, values).rowcount != 1:
            raise ValueError(f"{self.path} has no {query.split()[1][:-1]} {shown(values[-1])}")


def _restricted(wanted: Mapping[str, Any]) -> tuple[str, list[Any]]:
    """Return a WHERE for these columns and its values; None is any."""
    given = {name: value for name, value in wanted.items() if value is not None}
    words = " AND ".join(f"{name} = ?" for name in given)
    return (f"WHERE {words}" if words else ""), list(given.values())


def _hashed(code: str) -> str:
    """Return what is kept of a code; spaces, dashes and case do not matter."""
    plain = "".join(letter for letter in code.upper() if letter.isalnum())
    return hashlib.sha256(plain.encode("utf-8", "backslashreplace")).hexdigest()


def _json(value: Any) -> str:
    return json.dumps(value, allow_nan=False)


def _now() -> str:
    return datetime.now(UTC).strftime(TIME)
