"""Demonstrations in a folder: ``observed.parquet``, and ``truth.parquet`` if the truth is known.

:mod:`hmi_marl.demonstrations.dataset` describes the columns. Each file's metadata holds, under
``hmi-marl`` and as JSON: ``format``, the package's ``version``, and ``about``, how the data were
made; that of the observed file also ``layout``, the parts of a state with their bounds. That of the
truth holds the SHA-256 of its observed file, under ``hmi-marl observed``. Each file has checksums
over its rows and over its metadata; see :mod:`hmi_marl.demonstrations.checksums`. Files larger than
the memory are read in pieces; see :mod:`hmi_marl.demonstrations.stored`.

Needs pyarrow, which comes with the ``data`` extra.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hmi_marl.demonstrations.dataset import MISSING, Demonstrations, Observed, Truth
from hmi_marl.demonstrations.step_rows import StepRows
from hmi_marl.envs.drivers import TRAIT_NAMES
from hmi_marl.extras import needing
from hmi_marl.files import json_value, sha256_of, write_atomically

with needing("reading and writing demonstrations"):
    import pyarrow as pa
    import pyarrow.parquet as pq

    from hmi_marl.demonstrations.checksums import BELONGS, STAMP, FileChecksums
    from hmi_marl.demonstrations.step_file import (
        TRUTH_SCHEMA,
        column_names,
        observed_schema,
        stamped,
    )
    from hmi_marl.demonstrations.stored import OBSERVED as OBSERVED
    from hmi_marl.demonstrations.stored import TRUTH as TRUTH
    from hmi_marl.demonstrations.stored import read_about as read_about
    from hmi_marl.demonstrations.stored import read_demonstrations as read_demonstrations
    from hmi_marl.demonstrations.stored import read_observed as read_observed


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
    """Write every chunk in a thread of its own while the next one is made."""
    first = next(chunks)
    with ExitStack() as open_files, ThreadPoolExecutor(1, "hmi-marl-write") as writer:
        files = _Files(open_files, observed_path, truth_path, first)
        written = writer.submit(files.write, first)
        for chunk in chunks:
            _check_goes_on(first, chunk)
            written.result()
            written = writer.submit(files.write, chunk)
        written.result()
        files.close()


class _Files:
    """The two files of a dataset, written in chunks; only the observed one without a path."""

    def __init__(
        self, files: ExitStack, observed: Path, truth: Path | None, first: Demonstrations
    ) -> None:
        layout = {"layout": json_value(first.observed.layout.parts)}
        schema = stamped(observed_schema(first.observed.layout), first.observed.about, layout)
        self._path, self._observed = observed, _Writer(files, observed, schema)
        self._truth: _Writer | None = None
        if truth is not None and first.truth is not None:
            self._truth = _Writer(files, truth, stamped(TRUTH_SCHEMA, first.truth.about, {}))
        self._episodes = 0

    def write(self, chunk: Demonstrations) -> None:
        """Write a chunk, in groups of whole episodes."""
        for episodes in _groups(chunk.observed.length):
            part = _Part(chunk.observed, episodes, self._episodes)
            self._observed.write(_observed_rows(part))
            if self._truth is not None and chunk.truth is not None:
                self._truth.write(_truth_rows(part, chunk.truth))
            self._episodes += episodes.stop - episodes.start

    def close(self) -> None:
        """Write the rest."""
        self._observed.close()
        if self._truth is not None:
            self._truth.close(belongs=sha256_of(self._path).encode())


class _Writer:
    """A file that is written in groups of rows, with its checksums."""

    def __init__(self, files: ExitStack, path: Path, schema: pa.Schema) -> None:
        self._stamp, self._checksums = schema.metadata[STAMP], FileChecksums()
        self._file = _open(files, path, schema)

    def write(self, rows: pa.Table) -> None:
        """Write a group."""
        self._checksums.add(rows)
        self._file.write_table(rows, row_group_size=len(rows))

    def close(self, belongs: bytes = b"") -> None:
        """Write the rest; ``belongs`` is the digest of the file that it is the truth of."""
        metadata = self._checksums.metadata(self._stamp, belongs)
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


_MOST_ROWS = 2**16
"""Rows of a group, unless a single episode is longer; so much is read at a time at least."""


def _groups(length: NDArray[np.int64]) -> Iterator[slice]:
    """Yield ranges of episodes of up to so many rows, at least one episode each."""
    first, ends = 0, np.cumsum(length)
    while first < len(length):
        before = ends[first] - length[first]
        stop = int(np.searchsorted(ends, before + _MOST_ROWS, "right"))
        stop = max(stop, first + 1)
        yield slice(first, stop)
        first = stop


class _Part:
    """Episodes of a chunk, the first of which is number ``start`` of the file."""

    def __init__(self, observed: Observed, episodes: slice, start: int) -> None:
        self.observed, self.episodes = observed, episodes
        self.rows = StepRows(observed.length[episodes], observed.actions.shape[1])
        self.place, self.step = self.rows.places()
        """Index of every row's episode among these, and its step."""
        self.keys = {
            "episode": (start + self.place).astype(np.int32),
            "step": self.step.astype(np.int32),
        }

    def of(self, steps: NDArray[Any], kind: type) -> NDArray[Any]:
        """Rows of an array of the chunk, shape (E, T), as this type."""
        return self.rows.of(steps[self.episodes]).astype(kind)


def _observed_rows(part: _Part) -> pa.Table:
    observed, episodes, place = part.observed, part.episodes, part.place
    rows: dict[str, Any] = dict(part.keys)
    used, code = np.unique(observed.driver[episodes], return_inverse=True)
    known = used[used != MISSING]  # comes first, so that the others are moved by one
    code = code - (len(used) - len(known))
    rows["driver"] = pa.DictionaryArray.from_arrays(
        pa.array(code[place].astype(np.int32), mask=code[place] == MISSING),
        pa.array([observed.names[k] for k in known], pa.string()),
    )
    seeds = observed.seeds
    rows["seed"] = pa.nulls(len(place), pa.uint64()) if seeds is None else seeds[episodes][place]
    crash = observed.crash_step[episodes][place]
    rows["crashed"] = (crash != MISSING) & (part.step >= crash)
    rows["action"] = part.of(observed.actions, np.int8)
    rows["alert"] = part.of(observed.alerts, np.int8)
    states = part.rows.columns_of(observed.states[episodes])
    rows |= dict(zip(column_names(observed.layout), states, strict=True))
    return pa.table(rows, schema=observed_schema(observed.layout))


def _truth_rows(part: _Part, truth: Truth) -> pa.Table:
    rows = part.keys | {
        "distracted": part.of(truth.distracted, np.int8),
        "accepted": part.of(truth.accepted, np.int8),
        "counter": part.of(truth.counter, np.int32),
        "intended_action": part.of(truth.intended, np.int8),
    }
    traits = truth.traits[part.episodes].T
    rows |= {name: each[part.place] for name, each in zip(TRAIT_NAMES, traits, strict=True)}
    return pa.table(rows, schema=TRUTH_SCHEMA)
