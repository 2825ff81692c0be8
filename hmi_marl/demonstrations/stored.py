"""Demonstrations of a folder that are read in pieces, however large the files.

An :class:`ObservedFile` knows the length, driver, seed and crash of every episode from a few light
columns, and reads the episodes that are asked for, with the same checks as a whole dataset::

    stored = ObservedFile(Path("runs/population"))
    for block in stored.blocks(drivers=64, rng=np.random.default_rng(0)):
        ...  # an Observed with all episodes of 64 drivers

Checksums are checked group by group of rows when these are first read. A file without checksums of
its groups is read as a whole once, group by group, when it is opened.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hmi_marl.checks import COUNT, Whole
from hmi_marl.demonstrations.dataset import MISSING, Demonstrations, Observed, Truth
from hmi_marl.demonstrations.step_rows import StepRows
from hmi_marl.envs.drivers import TRAIT_NAMES
from hmi_marl.extras import needing
from hmi_marl.files import sha256_of

with needing("reading demonstrations"):
    from hmi_marl.demonstrations.episode_index import EpisodeIndex
    from hmi_marl.demonstrations.step_file import TRUTH_SCHEMA, StepFile

OBSERVED, TRUTH = "observed.parquet", "truth.parquet"
_AHEAD = 2
"""Blocks of drivers that are held to draw the next block from."""


class _EpisodeFile:
    """One of the two files, of E episodes."""

    def __init__(self, file: StepFile) -> None:
        self._file = file
        self._index = EpisodeIndex(file)

    def __len__(self) -> int:
        return len(self._index.length)

    def _range(self, first: int, stop: int | None) -> tuple[int, int]:
        """Return the range of episodes, at least one, or raise ValueError."""
        count = len(self)
        first = Whole(0, count - 1)("first", first)
        return first, Whole(first + 1, count)("stop", count if stop is None else stop)

    def _arrays(
        self, first: int, stop: int, fill: dict[str, int]
    ) -> tuple[StepRows, dict[str, NDArray[np.int64]]]:
        """Arrays of shape (E, T) for these columns, filled as after the end of an episode."""
        rows = StepRows(self._index.length[first:stop])
        self._file.check_size(rows.shape[0] * rows.shape[1])
        return rows, {name: np.full(rows.shape, value) for name, value in fill.items()}


class ObservedFile(_EpisodeFile):
    """The observed data of a folder. The truth's file is not opened.

    Raises:
        FileNotFoundError: no dataset in ``folder``.
        ValueError: another kind of file, another version of the format, or a damaged file; the
            message says which. Reading a part raises it too.
    """

    def __init__(self, folder: Path) -> None:
        super().__init__(StepFile(folder / OBSERVED))
        self.layout = self._file.layout
        """Layout of the states."""
        self.about: dict[str, Any] = dict(self._file.stamp["about"])
        """How the data were made; see :attr:`Observed.about`."""
        self.names = self._index.names
        """Names of the known drivers."""
        self.length = self._index.length
        """Steps of each episode, shape (E,)."""
        self.driver = self._index.driver
        """Driver of each episode, an index of ``names``, shape (E,); -1 if not known."""
        self.seeds = self._index.seeds
        """Seeds that replay the episodes, shape (E,), not for learning; None if there are none."""
        self.crash_step = self._index.crash_step
        """The step in which the car crashed, shape (E,); -1 if it did not."""

    def read(self, first: int = 0, stop: int | None = None) -> Observed:
        """Read the episodes from ``first`` to before ``stop``; by default all.

        Takes memory for these episodes and one group of rows. The drivers' indices are those of
        :attr:`names`, in every part.

        Raises:
            ValueError: no such episodes, a damaged file, or numbers out of range; the message says
                which.
        """
        return self._read(*self._range(first, stop))

    def _read(self, first: int, stop: int) -> Observed:
        rows, arrays = self._arrays(first, stop, {"action": MISSING, "alert": 0})
        states = np.zeros((*rows.shape, self.layout.size), np.float32)
        names = self._file.states
        done = 0
        begins, ends = int(self._index.first[first]), int(self._index.first[stop])
        for table in self._file.rows(begins, ends, [*arrays, *names]):
            for name, array in arrays.items():
                rows.put(array, done, table[name].to_numpy())
            block = np.stack([table[name].to_numpy() for name in names], axis=1)
            rows.put(states, done, block)
            done += len(table)
        part = slice(first, stop)
        light = self.length[part].copy(), self.crash_step[part].copy(), self.driver[part].copy()
        actions, alerts = arrays.values()
        seeds = None if self.seeds is None else self.seeds[part].copy()
        try:
            return Observed(
                self.layout, states, actions, alerts, *light, self.names, seeds, self.about
            )
        except ValueError as error:
            raise ValueError(f"{self._file.path}: {error}") from None

    def pieces(self, episodes: int) -> Iterator[Observed]:
        """Yield all episodes in their order, up to so many at a time."""
        for first, stop in _ranges(len(self), episodes):
            yield self.read(first, stop)

    def blocks(self, drivers: int, rng: np.random.Generator) -> Iterator[Observed]:
        """Yield all episodes of so many drivers at a time, each driver once, in random order.

        Drivers are drawn from a buffer of at least twice as many, filled by groups of rows in
        random order, in which neighbours lie together. The last block may hold fewer. Episodes of
        unknown drivers are left out.

        Args:
            drivers: in a block.
            rng: draws the order.
        """
        drivers, groups = COUNT("drivers", drivers), self._neighbours()
        waiting = [groups[k] for k in rng.permutation(len(groups))]
        held: list[Observed] = []
        while waiting or held:
            while waiting and sum(len(np.unique(part.driver)) for part in held) < _AHEAD * drivers:
                held += self._of(waiting.pop())
            buffer = joined(held)
            order = rng.permutation(np.unique(buffer.driver))
            chosen = np.isin(buffer.driver, order[:drivers])
            held = [buffer.take(~chosen)] if len(order) > drivers else []
            block = buffer.take(chosen)
            del buffer
            yield block

    def _neighbours(self) -> list[NDArray[np.int64]]:
        """Return episodes of the drivers whose first episode begins in each group of rows."""
        episodes = np.flatnonzero(self.driver != MISSING)
        who, at = np.unique(self.driver[episodes], return_index=True)
        begins = self._index.first[episodes[at]]
        group = np.full(len(self.names), MISSING)
        group[who] = np.searchsorted(self._file.first_rows, begins, "right")
        of_episode = group[self.driver[episodes]]
        order = np.argsort(of_episode, kind="stable")
        cuts = np.flatnonzero(np.diff(of_episode[order])) + 1
        return np.split(episodes[order], cuts) if len(order) else []

    def _of(self, episodes: NDArray[np.int64]) -> list[Observed]:
        """Read these episodes, in parts that lie together."""
        runs = np.split(episodes, np.flatnonzero(np.diff(episodes) != 1) + 1)
        return [self.read(int(run[0]), int(run[-1]) + 1) for run in runs]


class TruthFile(_EpisodeFile):
    """The truth of the observed data of a folder.

    Raises:
        FileNotFoundError: the folder holds no truth.
        ValueError: as of :class:`ObservedFile`; also the truth of another dataset.
    """

    def __init__(self, folder: Path, observed: ObservedFile) -> None:
        path = folder / TRUTH
        file = StepFile(path, TRUTH_SCHEMA)
        if file.belongs_to != sha256_of(folder / OBSERVED):
            raise ValueError(f"{path} is not the truth of {OBSERVED} in the same folder")
        super().__init__(file)
        if not np.array_equal(self._index.length, observed.length):
            raise ValueError(f"{path} is damaged: its episodes are not those of {OBSERVED}")

    def read(self, first: int = 0, stop: int | None = None) -> Truth:
        """Read the truth of the episodes from ``first`` to before ``stop``; by default of all.

        Raises:
            ValueError: as :meth:`ObservedFile.read`.
        """
        return self._read(*self._range(first, stop))

    def _read(self, first: int, stop: int) -> Truth:
        fill = {"distracted": 0, "accepted": 0, "counter": 0, "intended_action": MISSING}
        rows, arrays = self._arrays(first, stop, fill)
        begins, ends = int(self._index.first[first]), int(self._index.first[stop])
        episode, step = rows.places()
        traits = np.zeros((stop - first, len(TRAIT_NAMES)))
        done = 0
        for table in self._file.rows(begins, ends, [*arrays, *TRAIT_NAMES]):
            for name, array in arrays.items():
                rows.put(array, done, table[name].to_numpy())
            part = slice(done, done + len(table))
            given = np.stack([table[name].to_numpy() for name in TRAIT_NAMES], axis=1)
            at_first = step[part] == 0
            traits[episode[part][at_first]] = given[at_first]
            if not np.array_equal(given, traits[episode[part]]):
                raise ValueError(f"{self._file.path} is damaged: traits change within an episode")
            done = part.stop
        try:
            distracted, accepted, counter, intended = arrays.values()
            about = self._file.stamp["about"]
            return Truth(distracted, accepted, counter, intended, traits, about)
        except ValueError as error:
            raise ValueError(f"{self._file.path}: {error}") from None


def read_demonstrations(folder: Path) -> Demonstrations:
    """Read a dataset, with its truth if there is one.

    Raises:
        FileNotFoundError: no dataset in ``folder``.
        ValueError: see :func:`read_observed`; also a truth of another dataset.
    """
    return next(read_pieces(folder))


def read_observed(folder: Path) -> Observed:
    """Read the observed data alone, without opening the truth's file.

    Raises:
        FileNotFoundError: no dataset in ``folder``.
        ValueError: another kind of file, another version of the format, a damaged file, or numbers
            out of range; the message says which.
    """
    return ObservedFile(folder).read()


def read_about(path: Path) -> dict[str, Any]:
    """Read from one of the two files how it was made, without reading its rows.

    Raises:
        FileNotFoundError, ValueError: see :func:`read_observed`.
    """
    stamp: dict[str, Any] = StepFile(path, TRUTH_SCHEMA if path.name == TRUTH else None).stamp
    return dict(stamp["about"])


def read_pieces(folder: Path, episodes: int | None = None) -> Iterator[Demonstrations]:
    """Yield all episodes of a folder in their order, up to so many at a time, with their truth.

    Args:
        folder: of the dataset.
        episodes: of a piece; by default all are one.

    Raises:
        FileNotFoundError, ValueError: as :class:`ObservedFile` and :class:`TruthFile`; before the
            first piece, or where a damaged one is read.
    """
    observed, truth = ObservedFile(folder), None
    count = len(observed)
    for first, stop in [(0, count)] if episodes is None else _ranges(count, episodes):
        seen = observed._read(first, stop)
        if truth is None and (folder / TRUTH).is_file():
            truth = TruthFile(folder, observed)
        yield _together(folder, seen, None if truth is None else truth._read(first, stop))


def _together(folder: Path, observed: Observed, truth: Truth | None) -> Demonstrations:
    try:
        return Demonstrations(observed, truth)
    except ValueError as error:
        raise ValueError(f"{folder / TRUTH}: {error}") from None


def _ranges(count: int, episodes: int) -> Iterator[tuple[int, int]]:
    size = COUNT("episodes", episodes)
    return ((first, min(first + size, count)) for first in range(0, count, size))


def joined(parts: Sequence[Observed]) -> Observed:
    """Return the episodes of several parts of one dataset, one part after the other."""
    if len(parts) == 1:
        return parts[0]
    one = parts[0]
    shape = sum(map(len, parts)), max(part.actions.shape[1] for part in parts)
    states = np.zeros((*shape, one.layout.size), np.float32)
    actions, alerts = np.full(shape, MISSING), np.zeros(shape, np.int64)
    start = 0
    for part in parts:
        steps = slice(start, start + len(part)), slice(part.actions.shape[1])
        states[steps], actions[steps], alerts[steps] = part.states, part.actions, part.alerts
        start += len(part)
    length, crash_step, driver = (
        np.concatenate([getattr(part, name) for part in parts])
        for name in ("length", "crash_step", "driver")
    )
    seeds = None
    if one.seeds is not None:
        seeds = np.concatenate([part.seeds for part in parts if part.seeds is not None])
    light = length, crash_step, driver
    return Observed(one.layout, states, actions, alerts, *light, one.names, seeds, one.about)
