"""What is constant within an episode, for all episodes of a file, from a few light columns."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from hmi_marl.demonstrations.dataset import MISSING
from hmi_marl.demonstrations.step_file import KEYS, StepFile

_LIGHT = ("driver", "seed", "crashed")


class EpisodeIndex:
    """Length of every episode, and where known driver, seed and crash; shape (E,) each.

    The file is read group by group, so this takes memory for one group and for E episodes.

    Raises:
        ValueError: rows out of order, values that change within an episode, or see
            :meth:`StepFile.scan`.
    """

    def __init__(self, file: StepFile) -> None:
        self._file, self._names = file, dict[str, int]()
        self._rows = 0
        """Rows read so far."""
        self._last = _Row()
        self._found: dict[str, list[NDArray[Any]]] = {}
        columns = [name for name, _ in KEYS]
        columns += [name for name in _LIGHT if name in file.columns]
        for table in file.scan(columns):
            if len(table):
                self._add(self._arrays(table))
        if not self._rows:
            raise ValueError(f"{file.path} holds no steps")
        found = {name: np.concatenate(parts) for name, parts in self._found.items()}
        self.first = np.append(found["first"], self._rows)
        """Number of each episode's first row, and of rows, shape (E + 1,)."""
        self.length: NDArray[np.int64] = np.diff(self.first)
        self.driver: NDArray[np.int64] = found.get("driver", np.zeros(0, np.int64))
        """Index of ``names``, -1 where there is none."""
        self.names = tuple(self._names)
        """Names of the drivers, in the order in which they appear."""
        self.seeds = self._seeds(found) if "seed" in found else None
        self.crash_step = np.full(len(self.length), MISSING)
        """The step in which the car crashed, -1 if it did not."""
        if "crashed in" in found:
            self.crash_step[found["crashed in"]] = found["crashed at"]
        for array in (self.first, self.length, self.driver, self.seeds, self.crash_step):
            if array is not None:
                array.flags.writeable = False  # they are shown to all who read the file

    def _seeds(self, found: Mapping[str, NDArray[Any]]) -> NDArray[np.uint64] | None:
        absent = found["no seed"]
        if absent.any() and not absent.all():
            raise ValueError(
                f"{self._file.path} is damaged: some episodes have a seed and some have none"
            )
        return None if absent.any() else found["seed"]

    def _add(self, rows: dict[str, NDArray[Any]]) -> None:
        """Check the next rows, and keep what is new in the episodes that begin in them."""
        step, path = rows["step"], self._file.path
        begins = step == 0
        number = self._last.number + np.cumsum(begins)
        at = self._rows + np.arange(len(step))
        first = np.append(self._last.first, at[begins])
        wrong = (rows["episode"] != number) | (step != at - first[np.cumsum(begins)])
        if wrong.any():
            row = int(wrong.argmax())
            raise ValueError(
                f"{path} is damaged: row {at[row]} is step {step[row]} of episode "
                f"{rows['episode'][row]}; episodes count from 0, and their steps from 0, without a "
                "gap"
            )
        self._keep("first", first[1:])
        for name in ("driver", "seed", "no seed"):
            if name in rows:
                if (self._changes(name, rows) & ~begins).any():
                    raise ValueError(
                        f"{path} is damaged: {name.removeprefix('no ')} changes within an episode"
                    )
                self._keep(name, rows[name][begins])
        if "crashed" in rows:
            crashed, changes = rows["crashed"], self._changes("crashed", rows)
            if (changes & ~crashed & ~begins).any():
                raise ValueError(f"{path} is damaged: a crashed car is whole again")
            crashes = crashed & (changes | begins)
            self._keep("crashed in", number[crashes])
            self._keep("crashed at", step[crashes])
        self._rows += len(step)
        values = {name: values[-1] for name, values in rows.items()}
        self._last = _Row(int(number[-1]), int(first[-1]), values)

    def _keep(self, name: str, values: NDArray[Any]) -> None:
        self._found.setdefault(name, []).append(values)

    def _changes(self, name: str, rows: Mapping[str, NDArray[Any]]) -> NDArray[np.bool_]:
        """Whether each value differs from that of the row before."""
        values = rows[name]
        before = np.append(self._last.values.get(name, values[0]), values[:-1])
        return np.asarray(values != before.astype(values.dtype, copy=False))

    def _arrays(self, table: pa.Table) -> dict[str, NDArray[Any]]:
        rows = {name: table[name].to_numpy().astype(np.int64) for name, _ in KEYS}
        if "driver" in table.column_names:
            rows["driver"] = self._driver(table["driver"])
            rows["no seed"] = table["seed"].is_null().to_numpy()
            rows["seed"] = table["seed"].fill_null(0).to_numpy()
            rows["crashed"] = table["crashed"].to_numpy()
        return rows

    def _driver(self, column: pa.ChunkedArray) -> NDArray[np.int64]:
        """Return indices of the names, to which new ones are added; -1 where there is none."""
        coded = column.combine_chunks().dictionary_encode()
        codes = coded.indices.fill_null(MISSING).to_numpy(zero_copy_only=False).astype(np.int64)
        labels = coded.dictionary.to_pylist()
        used, at = np.unique(codes[codes != MISSING], return_index=True)
        for code in used[np.argsort(at)]:
            self._names.setdefault(labels[code], len(self._names))
        table = np.array([*(self._names.get(label, MISSING) for label in labels), MISSING])
        return table[codes]


class _Row:
    """The last row that was read."""

    def __init__(
        self, number: int = -1, first: int = 0, values: Mapping[str, Any] | None = None
    ) -> None:
        self.number, self.first = number, first
        """Its episode, and that episode's first row."""
        self.values = values or {}
