"""Steps of episodes as rows of a file, and as arrays of shape (E, T)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

_BLOCK = 512
"""Rows that are turned into columns at a time, so that they stay in the processor's cache."""


class StepRows:
    """Rows of E episodes, one episode after the other.

    Args:
        length: steps of each episode, shape (E,).
        width: T, steps in the arrays, at least the longest length; that by default.
    """

    def __init__(self, length: NDArray[np.int64], width: int | None = None) -> None:
        self.shape = len(length), int(length.max()) if width is None else width
        self._where: NDArray[np.int64] | None = None
        if (length != self.shape[1]).any():
            self._where = np.flatnonzero(np.arange(self.shape[1]) < length[:, None])

    def __len__(self) -> int:
        return self.shape[0] * self.shape[1] if self._where is None else len(self._where)

    def places(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return episode, counted from 0, and step of every row."""
        where = np.arange(len(self)) if self._where is None else self._where
        episode, step = np.divmod(where, self.shape[1])
        return episode, step

    def of(self, steps: NDArray[Any]) -> NDArray[Any]:
        """Return the rows of an array of shape (E, T, ...); a view if all episodes are full."""
        flat = steps.reshape(-1, *steps.shape[2:])
        return flat if self._where is None else flat[self._where]

    def columns_of(self, steps: NDArray[Any]) -> NDArray[Any]:
        """Return the columns of an array of shape (E, T, D), each in one piece: (D, rows)."""
        rows = self.of(steps)
        columns = np.empty((rows.shape[1], len(rows)), rows.dtype)
        for first in range(0, len(rows), _BLOCK):
            block = slice(first, first + _BLOCK)
            columns[:, block] = rows[block].T
        return columns

    def put(self, steps: NDArray[Any], first: int, rows: NDArray[Any]) -> None:
        """Write rows, counted from the row ``first``, into a contiguous array (E, T, ...)."""
        flat, part = steps.reshape(-1, *steps.shape[2:]), slice(first, first + len(rows))
        flat[part if self._where is None else self._where[part]] = rows
