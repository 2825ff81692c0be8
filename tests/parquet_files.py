"""Parquet files of demonstrations with other content, and the checksums that belong to it."""

from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from hmi_marl.demonstrations.checksums import BELONGS, STAMP, FileChecksums


def write_signed(path: Path, table: pa.Table, **options: Any) -> None:
    """Write rows with the stamp in their metadata, and the right checksums of both.

    ``options`` are those of ``pyarrow.parquet.write_table``.
    """
    metadata = table.schema.metadata or {}
    checksums = FileChecksums()
    checksums.add(table)
    signed = checksums.metadata(metadata.get(STAMP, b""), metadata.get(BELONGS, b""))
    pq.write_table(table.replace_schema_metadata(metadata | signed), path, **options)


def metadata_of(path: Path) -> dict[bytes, bytes]:
    """The stamp and the checksums of a file."""
    found = pq.read_metadata(path).metadata
    return {name: value for name, value in found.items() if name.startswith(STAMP)}
