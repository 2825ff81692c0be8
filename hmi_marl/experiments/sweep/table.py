"""The results of a sweep as one parquet file. Needs pyarrow, which comes with the ``data`` extra.

A row for each run and driver, and for each run with all drivers together (``driver`` is ``all``):
``protocol``, ``run`` and ``seed``; a column for each swept option, null where a protocol does not
have it; ``driver``, ``episodes``, ``crashes`` and the means over its episodes, the eight reward
terms among them; ``training_steps`` and ``training_seconds`` of the run, and its ``folder``.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from hmi_marl.experiments.sweep.options import written
from hmi_marl.experiments.sweep.plan import SweptRun
from hmi_marl.experiments.sweep.runs import Result
from hmi_marl.extras import needing
from hmi_marl.files import write_atomically

TABLE = "sweep.parquet"
STAMP = b"hmi-marl"
"""Key of the file's metadata that holds JSON: the version, the command and the settings."""


def write_table(
    path: Path, results: Sequence[tuple[SweptRun, Result]], about: dict[str, Any]
) -> None:
    """Write the results of all runs, atomically."""
    with needing("writing the table of a sweep"):
        import pyarrow as pa
        import pyarrow.parquet as pq
    rows = list(_rows(results))
    names = list(dict.fromkeys(name for row in rows for name in row))
    columns = {name: _column(row.get(name) for row in rows) for name in names}
    whole = {"run": pa.int32(), "seed": pa.uint64()}
    arrays = {name: pa.array(values, whole.get(name)) for name, values in columns.items()}
    table = pa.table(arrays).replace_schema_metadata({STAMP: json.dumps(about).encode()})
    write_atomically(path, lambda temporary: pq.write_table(table, temporary, compression="zstd"))


def _rows(results: Iterable[tuple[SweptRun, Result]]) -> Iterator[dict[str, Any]]:
    for run, result in results:
        combination = run.combination
        for driver, played in result.by_driver.items():
            yield {
                "protocol": combination.protocol,
                "run": run.number,
                "seed": run.settings.seed,
                **combination.options,
                "driver": driver,
                "episodes": played.episodes,
                "crashes": played.crashes,
                **played.metrics,
                "training_steps": result.steps,
                "training_seconds": result.seconds,
                "folder": run.name,
            }


def _column(values: Iterable[Any]) -> list[Any]:
    """Return values of one type: as they are typed where they are of several parts or types."""
    found = list(values)
    kinds = {type(value) for value in found if value is not None}
    if len(kinds) == 1 and kinds <= {bool, int, float, str}:
        return found
    if kinds == {int, float}:
        return [None if value is None else float(value) for value in found]
    return [None if value is None else written(value) for value in found]
