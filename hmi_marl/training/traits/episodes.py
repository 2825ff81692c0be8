"""Episodes to learn latent traits from, whose situations lie on disk, not in memory.

A dataset is read once, in pieces, and its situations are written to a file without a name, which is
gone with the process. Pools are drawn from all of it: the system keeps in memory what fits of it.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hmi_marl.agents.learned.situations import EXTRA, situations
from hmi_marl.agents.learned.trait_encoder import standardise
from hmi_marl.demonstrations.dataset import MISSING, Observed
from hmi_marl.demonstrations.stored import ObservedFile
from hmi_marl.envs.observations import Layout

PIECE = 512
"""Episodes that are read at a time."""
SMALLEST_SPREAD = 1e-6


class Units(NamedTuple):
    """Units of the observed states in the model: both of shape (D,)."""

    centre: NDArray[np.float32]
    scale: NDArray[np.float32]

    def standardise(self, x: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return situations in these units."""
        return standardise(x, self.centre, self.scale)


class Moments:
    """Sums over the steps of episodes, read in pieces, from which units follow."""

    def __init__(self, columns: int) -> None:
        self._count, self._alerts = 0, 0
        self._mean, self._squares = np.zeros(columns), np.zeros(columns)

    def add(self, observed: Observed) -> None:
        """Add all steps of these episodes."""
        there = observed.steps_taken
        states = observed.states[there].astype(np.float64)
        # Means and squares about them are joined without loss where a column is large.
        count, mean = len(states), states.mean(axis=0)
        squares = ((states - mean) ** 2).sum(axis=0)
        total, apart = self._count + count, mean - self._mean
        self._squares += squares + apart**2 * (self._count * count / total)
        self._mean += apart * (count / total)
        self._count = total
        self._alerts += int(observed.alerts[there].sum())

    def units(self) -> Units:
        """Return mean and standard deviation of every column."""
        spread = np.sqrt(self._squares / self._count)
        scale = np.where(spread > SMALLEST_SPREAD, spread, 1.0)
        return Units(self._mean.astype(np.float32), scale.astype(np.float32))

    @property
    def alert_rate(self) -> float:
        """Mean number of alerts per step."""
        return self._alerts / self._count


@dataclass(frozen=True, eq=False)
class Episodes:
    """E episodes of at most T steps, of one dataset."""

    layout: Layout
    """Layout of the observed states."""
    situations: NDArray[np.float32]
    """x_t before step t, not standardised, shape (E, T, D + EXTRA); any numbers after the end."""
    actions: NDArray[np.int8]
    """v_t, shape (E, T); -1 after the end."""
    length: NDArray[np.int64]
    """Steps of each episode, shape (E,)."""
    driver: NDArray[np.int64]
    """Driver of each episode, an index of ``names``, shape (E,); -1 if not known."""
    names: tuple[str, ...]
    """Names of the known drivers."""
    units: Units
    """Units of the states."""
    alert_rate: float
    """Mean number of alerts per step."""
    about: Mapping[str, Any]
    """How the data were made."""

    def __len__(self) -> int:
        return len(self.length)

    @classmethod
    def of(cls, observed: Observed) -> Episodes:
        """Take episodes that are in memory."""
        moments = Moments(observed.layout.size)
        moments.add(observed)
        return cls(
            observed.layout,
            situations(observed.states, observed.actions, observed.alerts),
            observed.actions.astype(np.int8),
            observed.length,
            observed.driver,
            observed.names,
            moments.units(),
            moments.alert_rate,
            observed.about,
        )

    @classmethod
    def read(cls, stored: ObservedFile, which: NDArray[np.bool_], folder: Path) -> Episodes:
        """Read the episodes that are marked, shape (E,), at least one.

        Takes memory for a piece of them, and for two bytes a step.

        Args:
            folder: where the file of situations is made; or, where that is not there, the nearest
                folder above it.

        Raises:
            OSError: it cannot be written.
            ValueError: the dataset is damaged.
        """
        length = stored.length[which]
        count, steps = len(length), int(length.max())
        actions = np.full((count, steps), MISSING, np.int8)
        moments, done = Moments(stored.layout.size), 0
        with tempfile.TemporaryFile(dir=_nearest(folder)) as file:
            for first in range(0, len(stored), PIECE):
                marked = which[first : first + PIECE]
                if not marked.any():
                    continue
                piece = stored.read(first, first + len(marked)).take(marked)
                moments.add(piece)
                actions[done : done + len(piece), : piece.actions.shape[1]] = piece.actions[
                    :, :steps
                ]
                _write(file, piece, steps)
                done += len(piece)
            file.flush()
            shape = count, steps, stored.layout.size + EXTRA
            found = np.memmap(file, np.float32, "r", shape=shape)
        return cls(
            stored.layout,
            found,
            actions,
            length,
            stored.driver[which],
            stored.names,
            moments.units(),
            moments.alert_rate,
            stored.about,
        )


def _write(file: BinaryIO, piece: Observed, steps: int) -> None:
    """Write the situations of a piece, (E, steps, D + EXTRA)."""
    x = situations(piece.states, piece.actions, piece.alerts)
    whole = np.zeros((len(x), steps, x.shape[2]), np.float32)
    kept = min(steps, x.shape[1])
    whole[:, :kept] = x[:, :kept]
    file.write(whole.data)


def _nearest(folder: Path) -> Path:
    folder = folder.absolute()
    return next(each for each in (folder, *folder.parents) if each.is_dir())
