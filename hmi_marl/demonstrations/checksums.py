"""Checksums of the parquet files of demonstrations: over all rows, over groups of rows, metadata.

The checksum of all rows is kept in a file's metadata under ``hmi-marl rows``, and one for each of
its row groups under ``hmi-marl groups``, as JSON: ``[rows, checksum]`` for each. That of the stamp,
of the observed file that a truth belongs to, and of the rows' checksum is kept under ``hmi-marl
sha256``. The first does not depend on how rows are cut into groups; the second lets a part of a
large file be read with the same certainty.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from hmi_marl.files import sha256
from hmi_marl.reading import parse_json

STAMP, BELONGS = b"hmi-marl", b"hmi-marl observed"
_ROWS, _GROUPS, _WHOLE = b"hmi-marl rows", b"hmi-marl groups", b"hmi-marl sha256"


class Checksum:
    """SHA-256 checksum of rows, whatever groups they come in."""

    def __init__(self) -> None:
        self._columns: dict[tuple[str, str], Any] = {}

    def add(self, rows: pa.Table) -> None:
        """Count in rows of a file, in their order."""
        self.add_plain(_plain_columns(rows))

    def add_plain(self, columns: Iterable[tuple[tuple[str, str], NDArray[np.uint8]]]) -> None:
        """Count in the bytes of rows, by column and part."""
        for name, values in columns:
            self._columns.setdefault(name, hashlib.sha256()).update(values)

    def of_rows(self) -> bytes:
        """Checksum of all rows, in hexadecimal digits."""
        columns = [(*name, each.hexdigest()) for name, each in self._columns.items()]
        return sha256(json.dumps(columns).encode()).encode()


def checksum_of(rows: pa.Table) -> bytes:
    """Return the checksum of some rows alone, in hexadecimal digits."""
    checksum = Checksum()
    checksum.add(rows)
    return checksum.of_rows()


class FileChecksums(Checksum):
    """The checksums of a file that is written group by group."""

    def __init__(self) -> None:
        super().__init__()
        self._groups: list[tuple[int, str]] = []

    def add(self, rows: pa.Table) -> None:
        """Count in the rows of the next group."""
        columns, group = list(_plain_columns(rows)), Checksum()
        self.add_plain(columns)
        group.add_plain(columns)
        self._groups.append((len(rows), group.of_rows().decode()))

    def metadata(self, stamp: bytes, belongs: bytes = b"") -> dict[bytes, bytes]:
        """Entries of the file's metadata that hold the checksums."""
        rows, groups = self.of_rows(), json.dumps(self._groups).encode()
        return {_ROWS: rows, _GROUPS: groups, _WHOLE: _of_metadata(stamp, belongs, rows)}


def rows_checksum(metadata: Mapping[bytes, bytes]) -> bytes:
    """Return the checksum of all rows from a file's metadata.

    Raises:
        ValueError: the checksum of the metadata differs.
    """
    rows = metadata.get(_ROWS, b"")
    signed = metadata.get(STAMP, b""), metadata.get(BELONGS, b""), rows
    if metadata.get(_WHOLE) != _of_metadata(*signed):
        raise ValueError("its checksum differs")
    return rows


def group_checksums(metadata: Mapping[bytes, bytes], rows: Sequence[int]) -> list[bytes] | None:
    """Return the checksum of each group of a file, from its metadata.

    Args:
        metadata: of the file.
        rows: numbers of rows of its groups.

    Returns:
        None if the file holds none, or those of other groups, as one that was written anew by
        another program.
    """
    try:
        found = parse_json(metadata.get(_GROUPS, b"[]"))
        numbers, checksums = zip(*found, strict=True)
    except (TypeError, ValueError):
        return None
    if list(numbers) != list(rows) or not all(isinstance(each, str) for each in checksums):
        return None
    return [each.encode(errors="replace") for each in checksums]


def _of_metadata(stamp: bytes, belongs: bytes, rows: bytes) -> bytes:
    parts = (hashlib.sha256(part).digest() for part in (stamp, belongs, rows))
    return sha256(b"".join(parts)).encode()


def _plain_columns(rows: pa.Table) -> Iterator[tuple[tuple[str, str], NDArray[np.uint8]]]:
    """Yield the bytes of every column's parts, named by column and part."""
    for field in rows.schema:
        for part, values in _plain(rows[field.name], field).items():
            yield (field.name, part), np.ascontiguousarray(values).view(np.uint8)


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
