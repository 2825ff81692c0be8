"""Schema and checks of the parquet files of demonstrations: columns, stamp and order of rows.

:mod:`hmi_marl.demonstrations.parquet` writes and reads the two files.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

import hmi_marl
from hmi_marl.checks import shown
from hmi_marl.demonstrations.dataset import MISSING
from hmi_marl.envs.drivers import TRAIT_NAMES
from hmi_marl.envs.observations import Layout, Part
from hmi_marl.files import json_value, sha256
from hmi_marl.reading import parse_json
from hmi_marl.text import listed, quoted
from hmi_marl.typed_json import read_value

FORMAT = "hmi-marl demonstrations 2"
STAMP, BELONGS = b"hmi-marl", b"hmi-marl observed"
_ROWS, _WHOLE = b"hmi-marl rows", b"hmi-marl sha256"
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


class Checksum:
    """SHA-256 checksum of rows, whatever groups they are written in, and of the metadata with it.

    The checksum of the rows is kept under ``hmi-marl rows``; that of the stamp, of the observed
    file that a truth belongs to, and of the rows' checksum under ``hmi-marl sha256``.
    """

    def __init__(self) -> None:
        self._columns: dict[tuple[str, str], Any] = {}

    def add(self, rows: pa.Table) -> None:
        """Count in rows of a file, in their order."""
        for field in rows.schema:
            for part, values in _plain(rows[field.name], field).items():
                digest = self._columns.setdefault((field.name, part), hashlib.sha256())
                digest.update(np.ascontiguousarray(values).view(np.uint8))

    def of_rows(self) -> bytes:
        """Checksum of all rows, in hexadecimal digits."""
        columns = [(*name, each.hexdigest()) for name, each in self._columns.items()]
        return sha256(json.dumps(columns).encode()).encode()

    def metadata(self, stamp: bytes, belongs: bytes = b"") -> dict[bytes, bytes]:
        """Entries of the file's metadata that hold the checksums."""
        rows = self.of_rows()
        return {_ROWS: rows, _WHOLE: _of_metadata(stamp, belongs, rows)}


def _of_metadata(stamp: bytes, belongs: bytes, rows: bytes) -> bytes:
    parts = (hashlib.sha256(part).digest() for part in (stamp, belongs, rows))
    return sha256(b"".join(parts)).encode()


def _plain(column: pa.ChunkedArray, field: pa.Field) -> dict[str, NDArray[Any]]:
    """Values of a column as arrays, and where there are none if that may be; digests of texts."""
    if pa.types.is_dictionary(field.type):
        coded = column.combine_chunks().dictionary_encode()
        codes = coded.indices.fill_null(len(coded.dictionary)).to_numpy(zero_copy_only=False)
        labels = (hashlib.sha256(label.encode()).digest() for label in coded.dictionary.to_pylist())
        table = np.frombuffer(b"".join([*labels, bytes(hashlib.sha256().digest_size)]), np.uint64)
        return {"texts": table.reshape(len(coded.dictionary) + 1, -1)[codes]}
    if field.nullable:
        filled = column.fill_null(pa.scalar(0).cast(field.type))
        return {"null": column.is_null().to_numpy(), "values": filled.to_numpy()}
    return {"values": column.to_numpy()}


MOST_GROWTH = 1000
"""Most memory that reading takes, as a multiple of the file's size. It is 18 for recorded drives,
and 134 for their truth, which compresses well."""
_SMALL = 16 * 2**20
"""Memory that reading may take whatever the file's size [bytes]."""


class StepFile:
    """One of the two files, with the checks that both have in common.

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
        metadata = self._parquet.metadata.metadata or {}
        self.belongs_to = metadata.get(BELONGS, b"").decode(errors="replace")
        self.stamp = _read_stamp(path, metadata.get(STAMP, b"{}"))
        self._rows = metadata.get(_ROWS, b"")
        signed = (metadata[STAMP], metadata.get(BELONGS, b""), self._rows)
        if metadata.get(_WHOLE) != _of_metadata(*signed):
            raise ValueError(f"{path} has a damaged stamp: its checksum differs; {_REMEDY}")
        if schema is None:
            self.layout = _read_layout(path, self.stamp, len(found))
            schema = observed_schema(self.layout)
        _check_schema(path, found, schema)
        self._schema = schema
        self._check_size(self._parquet.metadata.num_rows)
        self.names: list[str] = []
        """Names of the drivers, in the order in which they appear."""

    def read(self) -> dict[str, NDArray[Any]]:
        """Return every column except those of the states, which are put into ``states``."""
        try:
            return self._read()
        except _UNREADABLE as error:
            raise ValueError(f"{self.path} is damaged: {quoted(error)}") from None

    def _check_size(self, steps: int) -> None:
        size = 8 * steps * len(self._schema)  # numbers of 4 bytes, copied once
        if size > self._limit:
            raise ValueError(
                f"{self.path} would take {size / 2**20:,.0f} MiB of memory, over {MOST_GROWTH} "
                "times its size; it is damaged, or its episodes differ too much in length to be "
                "read together"
            )

    def _read(self) -> dict[str, NDArray[Any]]:
        keys = self._parquet.read([name for name, _ in KEYS])
        self.episode, self.step = (keys[name].to_numpy().astype(np.int64) for name, _ in KEYS)
        self.length = self._lengths()
        shape = len(self.length), int(self.length.max())
        self._check_size(shape[0] * shape[1])
        states = column_names(self.layout) if "driver" in self._schema.names else []
        self.states = np.zeros((*shape, len(states)), np.float32)
        pieces: dict[str, list[NDArray[Any]]] = {}
        start, checksum = 0, Checksum()
        for group in range(self._parquet.num_row_groups):
            table = self._parquet.read_row_group(group)
            rows = slice(start, start + len(table))
            start = rows.stop
            checksum.add(table)
            for name in table.column_names:
                if name not in states:
                    for key, values in self._column(name, table[name]).items():
                        pieces.setdefault(key, []).append(values)
            if states:
                block = np.stack([table[name].to_numpy() for name in states], axis=1)
                self.states[self.episode[rows], self.step[rows]] = block
        if checksum.of_rows() != self._rows:
            raise ValueError(f"{self.path} is damaged: the checksum of its rows differs; {_REMEDY}")
        return {name: np.concatenate(several) for name, several in pieces.items()}

    def _column(self, name: str, column: pa.ChunkedArray) -> dict[str, NDArray[Any]]:
        if name == "seed":
            absent = column.is_null().to_numpy()
            return {"seed": column.fill_null(0).to_numpy(), "no seed": absent}
        if name == "driver":
            return {"driver": self._who(column)}
        return {name: column.to_numpy()}

    def _who(self, column: pa.ChunkedArray) -> NDArray[np.int64]:
        """Return indices of ``names``, to which new names are added; -1 where there is none."""
        coded = column.combine_chunks().dictionary_encode()
        codes = coded.indices.fill_null(MISSING).to_numpy(zero_copy_only=False).astype(np.int64)
        labels = coded.dictionary.to_pylist()
        used, at = np.unique(codes[codes != MISSING], return_index=True)
        for code in used[np.argsort(at)]:
            if labels[code] not in self.names:
                self.names.append(labels[code])
        place = {label: k for k, label in enumerate(self.names)}
        table = np.array([*(place.get(label, MISSING) for label in labels), MISSING])
        return table[codes]

    def _lengths(self) -> NDArray[np.int64]:
        """Return the steps of every episode; raise unless rows are sorted and complete."""
        episode, step = self.episode, self.step
        if not len(episode):
            raise ValueError(f"{self.path} holds no steps")
        begins = step == 0
        number = np.cumsum(begins) - 1
        lengths = np.bincount(np.maximum(number, 0))
        expected = np.arange(len(step)) - (np.cumsum(lengths) - lengths)[number]
        wrong = (episode != number) | (step != expected)
        if wrong.any():
            row = int(wrong.argmax())
            raise ValueError(
                f"{self.path} is damaged: row {row} is step {step[row]} of episode {episode[row]}; "
                "episodes count from 0, and their steps from 0, without a gap"
            )
        return lengths

    def spread(self, rows: NDArray[Any], fill: int) -> NDArray[np.int64]:
        """Arrange values of all rows in an array of shape (E, T), with ``fill`` after the end."""
        values = np.full((len(self.length), int(self.length.max())), fill, np.int64)
        values[self.episode, self.step] = rows
        return values


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
