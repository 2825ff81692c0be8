"""SQLite files of this package: checked when they are opened, written in whole transactions."""

from __future__ import annotations

import sqlite3
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Self

from hmi_marl.reading import opened, parse_json
from hmi_marl.text import quoted

APPLICATION = 0x484D4950
"""Marks the file as ours, in SQLite's own header."""
_PATIENCE = 30.0
"""Longest wait for other writers [s]."""
_SYSTEM = ("SQLITE_BUSY", "SQLITE_CANTOPEN", "SQLITE_FULL", "SQLITE_IOERR", "SQLITE_READONLY")
"""Beginnings of SQLite's names for errors of the system rather than of the file's content."""


def is_sqlite(path: Path) -> bool:
    """Whether a file is a database of SQLite, by its first bytes.

    Raises:
        OSError: it cannot be read.
    """
    with opened(path) as stream:
        return bool(stream.read(16) == b"SQLite format 3\0")


class Database:
    """An SQLite file with the given tables, which are made where there are none.

    What a transaction wrote is on the disk when its block ends. Deleted rows are overwritten.

    Args:
        path: of the file.
        tables: statements that make the tables and indices, by name, as SQLite keeps them.
        version: of the tables.
        make: the file, if there is none, and the tables in an empty one.

    Raises:
        ValueError: the file is something else, or of another version; the message says which. So
            does every method where the file is damaged.
        OSError: the file cannot be opened, read or written.
    """

    def __init__(
        self, path: Path, tables: Mapping[str, str], version: int, make: bool = True
    ) -> None:
        self.path, self._tables, self._version, self._make = path, tables, version, make
        self._lock = threading.RLock()
        if make and not path.parent.is_dir():
            raise FileNotFoundError(f"{path} cannot be made: make its folder first")
        if make and not path.exists():
            path.touch(mode=0o600)  # what people did is not for other users
        with opened(path):  # no pipe, which SQLite would wait for
            pass
        with self.errors():
            self._base = sqlite3.connect(
                path, timeout=_PATIENCE, isolation_level=None, check_same_thread=False
            )
            try:
                self._open()
            except BaseException:
                self._base.close()
                raise

    def close(self) -> None:
        """Close the file."""
        with self._lock:
            self._base.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @contextmanager
    def writing(self) -> Iterator[sqlite3.Connection]:
        """Take a transaction, which is on the disk at the end of the block, or undone by an error.

        One at a time, over all threads and processes; the others wait.
        """
        with self._lock, self.errors():
            self._base.execute("BEGIN IMMEDIATE")
            try:
                yield self._base
                self._base.execute("COMMIT")
            except BaseException:
                if self._base.in_transaction:
                    self._base.execute("ROLLBACK")
                raise

    def rows(self, query: str, *values: Any) -> list[Any]:
        """Return all rows of a query."""
        with self._lock, self.errors():
            return self._base.execute(query, values).fetchall()

    def forget(self) -> None:
        """Have what was deleted leave SQLite's log too, which other readers may delay."""
        with self._lock, self.errors():
            self._base.execute("PRAGMA wal_checkpoint(TRUNCATE)")

    def parsed(self, text: Any) -> Any:
        """Return JSON content from a column."""
        try:
            if isinstance(text, str):
                return parse_json(text)
            reason = "JSON is a text"
        except ValueError as error:
            reason = str(error)
        raise self.damaged(reason)

    def damaged(self, reason: object) -> ValueError:
        """Return the error for content that cannot be."""
        return ValueError(f"{self.path} is damaged, or no database of hmi-marl: {quoted(reason)}")

    @contextmanager
    def errors(self) -> Iterator[None]:
        """Raise SQLite's errors as OSError or ValueError of one line."""
        try:
            yield
        except sqlite3.ProgrammingError:
            raise  # of this program, such as a closed file
        except sqlite3.DatabaseError as error:
            if getattr(error, "sqlite_errorname", "").startswith(_SYSTEM):
                raise OSError(f"{self.path}: {error}") from None
            raise self.damaged(error) from None

    def _open(self) -> None:
        """Check the file, and make the tables in an empty one."""
        if self._check() and not self._make:
            raise ValueError(f"{self.path} is empty, and no database; name another file")
        self._write_ahead()
        for setting in ("synchronous = FULL", "foreign_keys = ON", "secure_delete = ON"):
            self._base.execute(f"PRAGMA {setting}")
        with self.writing() as base:
            if self._check():
                for statement in self._tables.values():
                    base.execute(statement)
                base.execute(f"PRAGMA application_id = {APPLICATION}")
                base.execute(f"PRAGMA user_version = {self._version}")

    def _write_ahead(self) -> None:
        """Have SQLite keep a log, so that readers and a writer do not wait for each other.

        SQLite does not wait for others who do the same at this moment.
        """
        end = time.monotonic() + _PATIENCE
        while self._pragma("journal_mode") != "wal":
            try:
                self._base.execute("PRAGMA journal_mode = WAL")
            except sqlite3.OperationalError:
                if time.monotonic() > end:
                    raise
                time.sleep(0.01)

    def _check(self) -> bool:
        """Return whether the file is empty still, or raise ValueError if it is another's."""
        application, version = self._pragma("application_id"), self._pragma("user_version")
        found = dict(
            self._base.execute(
                "SELECT name, sql FROM sqlite_master WHERE name NOT LIKE 'sqlite\\_%' ESCAPE '\\'"
            ).fetchall()
        )
        if (application, version, found) == (0, 0, {}):
            return True
        if application != APPLICATION:
            raise ValueError(f"{self.path} is a database of another program; name another file")
        if version != self._version:
            raise ValueError(
                f"{self.path} has tables of version {version}, and this is {self._version}; use "
                "the hmi-marl that wrote it, or name another file"
            )
        if found != self._tables:
            raise ValueError(f"{self.path} has other tables than hmi-marl makes; restore a copy")
        return False

    def _pragma(self, name: str) -> Any:
        return self._base.execute(f"PRAGMA {name}").fetchone()[0]
