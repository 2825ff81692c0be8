"""Demonstrations in a folder: ``observed.parquet``, and ``truth.parquet`` if the truth is known.

:mod:`hmi_marl.demonstrations.dataset` describes the columns. Each file's metadata holds, under
``hmi-marl`` and as JSON: ``format``, the package's ``version``, and ``about``, how the data were
made; that of the observed file also ``layout``, the parts of a state with their bounds. That of the
truth holds the SHA-256 of its observed file, under ``hmi-marl observed``. Each file has checksums
over its rows and over its metadata; see :class:`hmi_marl.demonstrations.step_file.Checksum`.

Needs pyarrow, which comes with the ``data`` extra.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hmi_marl.demonstrations.dataset import MISSING, Demonstrations, Observed, Truth
from hmi_marl.envs.drivers import TRAIT_NAMES
from hmi_marl.extras import needing
from hmi_marl.files import json_value, sha256_of, write_atomically

with needing("reading and writing demonstrations"):
    import pyarrow as pa
    import pyarrow.parquet as pq

    from hmi_marl.demonstrations.step_file import (
        BELONGS,
        STAMP,
        TRUTH_SCHEMA,
        Checksum,
        StepFile,
        column_names,
        observed_schema,
        stamped,
    )

OBSERVED, TRUTH = "observed.parquet", "truth.parquet"


def write_demonstrations(
    folder: Path, demonstrations: Demonstrations | Iterable[Demonstrations]
) -> None:
    """Write a dataset, or its chunks, into ``folder`` and replace an existing one.

    An iterable of chunks need not fit into memory as a whole.

    Raises:
        ValueError: no chunks, chunks with different layouts or stamps, or truth in only some.
    """
    chunks = iter(
        [demonstrations] if isinstance(demonstrations, Demonstrations) else demonstrations
    )
    first = next(chunks, None)
    if first is None:
        raise ValueError("there are no demonstrations to write")
    chunks, with_truth = chain([first], chunks), first.truth is not None
    del first
    if not with_truth:
        write_atomically(folder / OBSERVED, lambda path: _write(chunks, path, None))
        (folder / TRUTH).unlink(missing_ok=True)
        return

    def write_both(truth: Path) -> None:
        write_atomically(folder / OBSERVED, lambda path: _write(chunks, path, truth))

    write_atomically(folder / TRUTH, write_both)


def _write(chunks: Iterator[Demonstrations], observed_path: Path, truth_path: Path | None) -> None:
    start, first = 0, None
    with ExitStack() as files:
        for chunk in chunks:
            observed, truth = chunk.observed, chunk.truth
            if first is None:
                first = chunk
                layout = {"layout": json_value(observed.layout.parts)}
                schema = stamped(observed_schema(observed.layout), observed.about, layout)
                observed_file = _Writer(files, observed_path, schema)
                if truth_path is not None and truth is not None:
                    schema = stamped(TRUTH_SCHEMA, truth.about, {})
                    truth_file = _Writer(files, truth_path, schema)
            _check_goes_on(first, chunk)
            observed_file.write(_observed_rows(observed, start))
            if truth is not None:
                truth_file.write(_truth_rows(chunk, truth, start))
            start += len(chunk)
        observed_file.close()
        if truth_path is not None:
            truth_file.close(belongs=sha256_of(observed_path).encode())


class _Writer:
    """A file that is written in chunks, with its checksums."""

    def __init__(self, files: ExitStack, path: Path, schema: pa.Schema) -> None:
        self._stamp, self._checksum = schema.metadata[STAMP], Checksum()
        self._file = _open(files, path, schema)

    def write(self, rows: pa.Table) -> None:
        """Write a chunk."""
        self._checksum.add(rows)
        self._file.write_table(rows)

    def close(self, belongs: bytes = b"") -> None:
        """Write the rest; ``belongs`` is the digest of the file that it is the truth of."""
        metadata = self._checksum.metadata(self._stamp, belongs)
        self._file.add_key_value_metadata(metadata | ({BELONGS: belongs} if belongs else {}))
        self._file.close()


def _open(files: ExitStack, path: Path, schema: pa.Schema) -> pq.ParquetWriter:
    plain_floats = [field.name for field in schema if pa.types.is_floating(field.type)]
    labels = [field.name for field in schema if field.name not in plain_floats]
    writer = pq.ParquetWriter(
        path,
        schema,
        compression="zstd",
        use_dictionary=labels,
        use_byte_stream_split=plain_floats,
        write_page_checksum=True,
    )
    return files.enter_context(writer)


def _check_goes_on(first: Demonstrations, chunk: Demonstrations) -> None:
    one, other = first.observed, chunk.observed
    if one.layout != other.layout or one.about != other.about:
        raise ValueError("the chunks of a dataset have one layout and one stamp")
    if (first.truth is None) != (chunk.truth is None):
        raise ValueError("either all chunks of a dataset hold the truth, or none")


def _keys(observed: Observed, start: int) -> tuple[dict[str, Any], NDArray[np.int64]]:
    """Return episode and step of every row, and the episode's index in the chunk."""
    place, step = np.nonzero(observed.steps_taken)
    return {"episode": (start + place).astype(np.int32), "step": step.astype(np.int32)}, place


def _observed_rows(observed: Observed, start: int) -> pa.Table:
    rows, place = _keys(observed, start)
    real = observed.steps_taken
    who = observed.driver[place].astype(np.int32)
    rows["driver"] = pa.DictionaryArray.from_arrays(
        pa.array(who, mask=who == MISSING), pa.array(observed.names, pa.string())
    )
    count = len(place)
    rows["seed"] = pa.nulls(count, pa.uint64()) if observed.seeds is None else observed.seeds[place]
    crash = observed.crash_step[place]
    rows["crashed"] = (crash != MISSING) & (rows["step"] >= crash)
    rows["action"] = observed.actions[real].astype(np.int8)
    rows["alert"] = observed.alerts[real].astype(np.int8)
    states = np.ascontiguousarray(observed.states[real].T)
    rows |= dict(zip(column_names(observed.layout), states, strict=True))
    return pa.table(rows, schema=observed_schema(observed.layout))


def _truth_rows(chunk: Demonstrations, truth: Truth, start: int) -> pa.Table:
    rows, place = _keys(chunk.observed, start)
    real = chunk.observed.steps_taken
    rows |= {
        "distracted": truth.distracted[real].astype(np.int8),
        "accepted": truth.accepted[real].astype(np.int8),
        "counter": truth.counter[real].astype(np.int32),
        "intended_action": truth.intended[real].astype(np.int8),
    }
    rows |= dict(zip(TRAIT_NAMES, truth.traits[place].T, strict=True))
    return pa.table(rows, schema=TRUTH_SCHEMA)


def read_demonstrations(folder: Path) -> Demonstrations:
    """Read a dataset, with its truth if there is one.

    Raises:
        FileNotFoundError: no dataset in ``folder``.
        ValueError: see :func:`read_observed`; also a truth of another dataset.
    """
    observed = read_observed(folder)
    path = folder / TRUTH
    if not path.is_file():
        return Demonstrations(observed)
    file = StepFile(path, TRUTH_SCHEMA)
    if file.belongs_to != sha256_of(folder / OBSERVED):
        raise ValueError(f"{path} is not the truth of {OBSERVED} in the same folder")
    rows = file.read()
    if not np.array_equal(file.length, observed.length):
        raise ValueError(f"{path} is damaged: its episodes are not those of {OBSERVED}")
    first = file.step == 0
    traits = np.stack([rows[trait] for trait in TRAIT_NAMES], axis=1)
    if not np.array_equal(traits, traits[first][file.episode]):
        raise ValueError(f"{path} is damaged: traits change within an episode")
    try:
        truth = Truth(
            file.spread(rows["distracted"], 0),
            file.spread(rows["accepted"], 0),
            file.spread(rows["counter"], 0),
            file.spread(rows["intended_action"], MISSING),
            traits[first],
            file.stamp["about"],
        )
        return Demonstrations(observed, truth)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def read_about(path: Path) -> dict[str, Any]:
    """Read from one of the two files how it was made, without reading its rows.

    Raises:
        FileNotFoundError, ValueError: see :func:`read_observed`.
    """
    stamp: dict[str, Any] = StepFile(path, TRUTH_SCHEMA if path.name == TRUTH else None).stamp
    return dict(stamp["about"])


def read_observed(folder: Path) -> Observed:
    """Read the observed data alone, without opening the truth's file.

    Raises:
        FileNotFoundError: no dataset in ``folder``.
        ValueError: another kind of file, another version of the format, a damaged file, or numbers
            out of range; the message says which.
    """
    path = folder / OBSERVED
    file = StepFile(path)
    rows = file.read()
    first = file.step == 0
    for name in ("seed", "driver"):
        values = rows[name]
        if not np.array_equal(values, values[first][file.episode]):
            raise ValueError(f"{path} is damaged: {name} changes within an episode")
    crashed = file.spread(rows["crashed"].astype(np.int64), 1)
    if (np.diff(crashed, axis=1) < 0).any():
        raise ValueError(f"{path} is damaged: a crashed car is whole again")
    at = (crashed == 0).sum(axis=1)
    known = ~rows["no seed"]
    if known.any() and not known.all():
        raise ValueError(f"{path} is damaged: some episodes have a seed and some have none")
    try:
        return Observed(
            file.layout,
            file.states,
            file.spread(rows["action"], MISSING),
            file.spread(rows["alert"], 0),
            file.length,
            np.where(at < file.length, at, MISSING),
            rows["driver"][first],
            tuple(file.names),
            rows["seed"][first] if known.all() else None,
            file.stamp["about"],
        )
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
