"""Schema and checks of the parquet files of demonstrations, and their rows, group by group.

:mod:`hmi_marl.demonstrations.parquet` writes the two files, :mod:`hmi_marl.demonstrations.stored`
reads them.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

import hmi_marl
from hmi_marl.checks import shown
from hmi_marl.demonstrations.checksums import (
    BELONGS,
    STAMP,
    Checksum,
    checksum_of,
    group_checksums,
    rows_checksum,
)
from hmi_marl.envs.drivers import TRAIT_NAMES
from hmi_marl.envs.observations import Layout, Part
from hmi_marl.files import json_value
from hmi_marl.reading import parse_json
from hmi_marl.text import listed, quoted
from hmi_marl.typed_json import read_value

FORMAT = "hmi-marl demonstrations 2"
_UNREADABLE = (pa.ArrowException, OSError)
"""Errors of pyarrow for damaged files."""
_REMEDY = "copy it again from where it comes from, or record it again"
KEYS = (("episode", pa.int32()), ("step", pa.int32()))
TRUTH_SCHEMA = pa.schema(
    [
        pa.field(name, kind, nullable=False)
        for name, kind in (
            *KEYS,
            ("distracted", pa.int8()),
            ("accepted", pa.int8()),
            ("counter", pa.int32()),
            ("intended_action", pa.int8()),
            *((trait, pa.float64()) for trait in TRAIT_NAMES),
        )
    ]
)


def column_names(layout: Layout) -> list[str]:
    """Return a name for every column: the part's name, or name_0, name_1, ... if it has several."""
    return [
        part.name if part.size == 1 else f"{part.name}_{k}"
        for part in layout.parts
        for k in range(part.size)
    ]


def observed_schema(layout: Layout) -> pa.Schema:
    """Return the columns of ``observed.parquet`` for states of this layout."""
    fields = [pa.field(name, kind, nullable=False) for name, kind in KEYS]
    fields.append(pa.field("driver", pa.dictionary(pa.int32(), pa.string())))
    fields.append(pa.field("seed", pa.uint64()))
    for name, kind in (("crashed", pa.bool_()), ("action", pa.int8()), ("alert", pa.int8())):
        fields.append(pa.field(name, kind, nullable=False))
    fields += [pa.field(name, pa.float32(), nullable=False) for name in column_names(layout)]
    return pa.schema(fields)


def stamped(schema: pa.Schema, about: Any, more: dict[str, Any]) -> pa.Schema:
    """Return the schema with the format, the version, how the data were made, and ``more``."""
    stamp = {"format": FORMAT, "version": hmi_marl.__version__, "about": json_value(about)} | more
    return schema.with_metadata({STAMP: json.dumps(stamp, allow_nan=False)})


MOST_GROWTH = 1000
"""Most memory that reading takes, as a multiple of the file's size. It is 18 for recorded drives,
and 134 for their truth, which compresses well."""
_SMALL = 16 * 2**20
"""Memory that reading may take whatever the file's size [bytes]."""


class StepFile:
    """One of the two files, with the checks that both have in common; read by groups of rows.

    Its size in memory is known from its metadata, and checked before any row is read.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: another kind of file, a damaged one, or one that takes far more memory than
            disk space.
    """

    def __init__(self, path: Path, schema: pa.Schema | None = None) -> None:
        if not path.is_file():
            raise FileNotFoundError(f"no demonstrations at {path}; make some with hmi-marl collect")
        self.path = path
        self._limit = _SMALL + MOST_GROWTH * path.stat().st_size
        try:
            self._parquet = pq.ParquetFile(path, page_checksum_verification=True)
            found = self._parquet.schema_arrow
        except _UNREADABLE as error:
            raise ValueError(f"{path} is no parquet file, or cut off: {quoted(error)}") from None
        footer = self._parquet.metadata
        metadata = footer.metadata or {}
        self.belongs_to = metadata.get(BELONGS, b"").decode(errors="replace")
        self.stamp = _read_stamp(path, metadata.get(STAMP, b"{}"))
        try:
            self._checksum = rows_checksum(metadata)
        except ValueError as error:
            raise ValueError(f"{path} has a damaged stamp: {error}; {_REMEDY}") from None
        if schema is None:
            self.layout = _read_layout(path, self.stamp, len(found))
            schema = observed_schema(self.layout)
            self.states = column_names(self.layout)
            """Columns of the states."""
        _check_schema(path, found, schema)
        self.columns = tuple(schema.names)
        self.check_size(footer.num_rows)
        rows = [footer.row_group(group).num_rows for group in range(footer.num_row_groups)]
        self.first_rows = np.cumsum([0, *rows])
        """Number of each group's first row, and of rows: shape (G + 1,)."""
        self._checksums = group_checksums(metadata, rows)
        self._checked: set[int] = set()
        """Groups whose checksum was right."""
        self._latest: tuple[int, tuple[str, ...], pa.Table] | None = None

    def check_size(self, steps: int) -> None:
        """Raise ValueError if so many steps would take far more memory than the file."""
        size = 8 * steps * len(self.columns)  # numbers of 4 bytes, copied once
        if size > self._limit:
            raise ValueError(
                f"{self.path} would take {size / 2**20:,.0f} MiB of memory, over {MOST_GROWTH} "
                "times its size; it is damaged, or its episodes differ too much in length to be "
                "read together"
            )

    def scan(self, columns: Sequence[str]) -> Iterator[pa.Table]:
        """Yield these columns of one group after the other.

        Raises:
            ValueError: a damaged file. If it has no checksums of its groups, all of it is read and
                checked against that of all rows, after the last group.
        """
        whole = Checksum() if self._checksums is None else None
        for group in range(len(self.first_rows) - 1):
            if whole is None:
                yield self._read(group, columns)
                continue
            table = self._read(group)
            whole.add(table)
            yield table.select(columns)
        if whole is not None and whole.of_rows() != self._checksum:
            raise self._differs()

    def rows(self, first: int, stop: int, columns: Sequence[str]) -> Iterator[pa.Table]:
        """Yield these columns of the rows from ``first`` to before ``stop``, group by group.

        Raises:
            ValueError: a damaged file; each group's checksum is checked when it is first read.
        """
        start = int(np.searchsorted(self.first_rows, first, "right")) - 1
        for group in range(start, len(self.first_rows) - 1):
            begins, ends = (int(row) for row in self.first_rows[group : group + 2])
            if begins >= stop:
                break
            table = self._group(group, tuple(columns))
            low = max(first, begins)
            yield table.slice(low - begins, min(stop, ends) - low)

    def _group(self, group: int, columns: tuple[str, ...]) -> pa.Table:
        """Return columns of a group; the latest is kept, as pieces end within one."""
        if self._latest is not None and self._latest[:2] == (group, columns):
            return self._latest[2]
        self._latest = None
        if self._checksums is None or group in self._checked:
            table = self._read(group, columns)
        else:
            table = self._read(group)
            if checksum_of(table) != self._checksums[group]:
                raise self._differs()
            self._checked.add(group)
            table = table.select(columns)
        self._latest = group, columns, table
        return table

    def _read(self, group: int, columns: Sequence[str] | None = None) -> pa.Table:
        try:
            return self._parquet.read_row_group(group, columns)
        except _UNREADABLE as error:
            raise ValueError(f"{self.path} is damaged: {quoted(error)}") from None

    def _differs(self) -> ValueError:
        return ValueError(f"{self.path} is damaged: the checksum of its rows differs; {_REMEDY}")


def _read_stamp(path: Path, text: bytes) -> dict[str, Any]:
    try:
        stamp = parse_json(text)
    except ValueError as error:
        raise ValueError(f"{path} has a damaged stamp: {error}") from None
    form = stamp.get("format") if isinstance(stamp, dict) else None
    if form != FORMAT:
        raise ValueError(
            f"{path} holds no demonstrations that can be read here: format {shown(form)}"
        )
    if not isinstance(stamp.get("about"), dict):
        raise ValueError(f"{path} has a damaged stamp: it does not say how the data were made")
    if not isinstance(stamp["about"].get("team", {}), dict):
        raise ValueError(f"{path} has a damaged stamp: team is a mapping")
    return stamp


def _read_layout(path: Path, stamp: dict[str, Any], columns: int) -> Layout:
    """Layout in the stamp of a file with so many columns."""
    if "layout" not in stamp:
        raise ValueError(f"{path} holds no observed data: its stamp has no layout")
    try:
        parts = read_value(tuple[Part, ...], stamp["layout"], "layout")
    except ValueError as error:
        raise ValueError(f"{path} has a damaged layout: {error}") from None
    for part in parts:
        if not (part.name.isidentifier() and part.size > 0 and part.low <= part.high):
            raise ValueError(f"{path} has a damaged layout: {shown(part)}")
    layout = Layout(parts)
    if layout.size > columns:  # before a name is made for each
        raise ValueError(f"{path} has {columns} columns, fewer than its layout of {layout.size}")
    return layout


def _check_schema(path: Path, found: pa.Schema, expected: pa.Schema) -> None:
    if found.names != expected.names:
        missing = [name for name in expected.names if name not in found.names]
        foreign = [name for name in found.names if name not in expected.names]
        odd = f"missing: {listed(missing) or 'none'}; foreign: {listed(foreign) or 'none'}"
        raise ValueError(f"{path} has other columns than its stamp says ({odd})")
    for field in expected:
        column = found.field(field.name)
        if not column.equals(field):
            raise ValueError(
                f"{path}: column {listed([field.name])} is {_type(column)}, not {_type(field)}"
            )


def _type(field: pa.Field) -> str:
    return f"{field.type}{'' if field.nullable else ' not null'}"
