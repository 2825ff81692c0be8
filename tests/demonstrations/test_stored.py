import tracemalloc
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from demonstrations import LAYOUT, assert_same_observed, assert_same_truth, made_up
from parquet_files import metadata_of, write_signed

from hmi_marl.demonstrations import parquet
from hmi_marl.demonstrations.dataset import MISSING, Demonstrations, Observed, Truth
from hmi_marl.demonstrations.parquet import OBSERVED, TRUTH, read_observed, write_demonstrations
from hmi_marl.demonstrations.step_file import StepFile
from hmi_marl.demonstrations.stored import ObservedFile, joined, read_pieces

NAMES = tuple(f"population-{k}" for k in range(12))
LIGHT = ["episode", "step", "driver", "seed", "crashed"]


def population(seed: int = 0, episodes: int = 3) -> Demonstrations:
    """Twelve drivers with three episodes of 1 to 5 steps each."""
    count = episodes * len(NAMES)
    length = np.random.default_rng(seed).integers(1, 6, count).tolist()
    crash_step = [min(2, steps - 1) if k % 4 == 0 else -1 for k, steps in enumerate(length)]
    driver = np.repeat(np.arange(len(NAMES)), episodes).tolist()
    return made_up(length, seed, crash_step, driver, NAMES)


@pytest.fixture
def folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """The population, in groups of up to 10 rows."""
    monkeypatch.setattr(parquet, "_MOST_ROWS", 10)
    write_demonstrations(tmp_path, population())
    assert pq.read_metadata(tmp_path / OBSERVED).num_row_groups > 8
    return tmp_path


def narrow(data: Any) -> Any:
    """The same episodes in arrays no wider than the longest of them."""
    if isinstance(data, Observed):
        width, names = data.length.max(), ("states", "actions", "alerts")
    else:
        assert isinstance(data, Truth)
        width = (data.intended != MISSING).sum(axis=1).max()
        names = ("distracted", "accepted", "counter", "intended")
    return replace(data, **{name: getattr(data, name)[:, :width] for name in names})


def rewritten(path: Path, size: int) -> None:
    """Write the file anew in groups of so many rows, as another program would."""
    table = pq.read_table(path).replace_schema_metadata(metadata_of(path))
    pq.write_table(table, path, row_group_size=size)


@pytest.fixture
def reads(monkeypatch: pytest.MonkeyPatch) -> list[tuple[int, Any]]:
    """Groups and columns that are read from now on."""
    found: list[tuple[int, Any]] = []
    original = StepFile._read

    def read(self: StepFile, group: int, columns: Any = None) -> pa.Table:
        found.append((group, columns))
        return original(self, group, columns)

    monkeypatch.setattr(StepFile, "_read", read)
    return found


@pytest.mark.parametrize("size", [None, 1, 7, 1000])
def test_any_range_of_episodes_is_read(folder: Path, size: int | None) -> None:
    observed = population().observed
    if size is not None:
        rewritten(folder / OBSERVED, size)
    stored, count = ObservedFile(folder), len(observed)
    assert len(stored) == count
    for first, stop in [(0, 1), (0, 3), (5, 20), (count - 1, count)]:
        expected = narrow(observed.take(range(first, stop)))
        assert_same_observed(stored.read(first, stop), expected)
    assert_same_observed(stored.read(7), narrow(observed.take(range(7, count))))
    assert_same_observed(stored.read(), observed)
    assert_same_observed(read_observed(folder), observed)


@pytest.mark.parametrize(
    ("first", "stop", "message"),
    [
        (-1, 3, "first lies in 0 to 35, but got -1"),
        (36, 37, "first lies in 0 to 35, but got 36"),
        (3, 3, "stop lies in 4 to 36, but got 3"),
        (3, 37, "stop lies in 4 to 36, but got 37"),
    ],
)
def test_episodes_that_are_not_there_are_reported(
    folder: Path, first: int, stop: int, message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        ObservedFile(folder).read(first, stop)


def test_light_columns_are_known_without_reading_the_others(
    folder: Path, reads: list[tuple[int, Any]]
) -> None:
    stored, observed = ObservedFile(folder), population().observed
    assert len(reads) > 8
    assert all(columns == LIGHT for _, columns in reads)
    for name in ("length", "driver", "crash_step", "seeds"):
        np.testing.assert_array_equal(getattr(stored, name), getattr(observed, name))
        with pytest.raises(ValueError, match="read-only"):
            getattr(stored, name)[0] = 0
    assert (stored.names, stored.layout, stored.about) == (NAMES, LAYOUT, observed.about)
    piece = stored.read(0, 4)
    piece.length[:] = 1  # its own
    assert (stored.length == observed.length).all()


def test_pieces_are_all_episodes_in_their_order(folder: Path) -> None:
    observed = population().observed
    for size in (1, 5, 36, 100):
        pieces = list(ObservedFile(folder).pieces(size))
        assert [len(piece) for piece in pieces[:-1]] == [size] * (len(pieces) - 1)
        assert_same_observed(joined(pieces), observed)
    with pytest.raises(ValueError, match="episodes lies in 1 to"):
        next(ObservedFile(folder).pieces(0))


def test_a_group_of_rows_is_read_once_in_a_pass(folder: Path, reads: list[tuple[int, Any]]) -> None:
    stored = ObservedFile(folder)
    reads.clear()
    list(stored.pieces(1))
    groups = pq.read_metadata(folder / OBSERVED).num_row_groups
    assert reads == [(group, None) for group in range(groups)]  # with its checksum
    reads.clear()
    list(stored.pieces(2))
    assert [group for group, _ in reads] == list(range(groups))
    assert not set(LIGHT) & set(reads[0][1])


def test_pieces_come_with_their_truth(folder: Path) -> None:
    data = population()
    assert data.truth is not None
    start = 0
    for piece in read_pieces(folder, 5):
        expected = data.take(range(start, start + len(piece)))
        assert_same_observed(piece.observed, narrow(expected.observed))
        assert_same_truth(piece.truth, narrow(expected.truth))
        start += len(piece)
    assert start == len(data)
    (folder / TRUTH).unlink()
    assert [piece.truth for piece in read_pieces(folder, 30)] == [None, None]


def drivers_of(block: Observed) -> list[int]:
    return list(dict.fromkeys(block.driver.tolist()))


@pytest.mark.parametrize("size", [None, 1, 1000])
@pytest.mark.parametrize("drivers", [1, 5, 12, 50])
def test_every_driver_is_in_one_block_with_all_episodes(
    folder: Path, drivers: int, size: int | None
) -> None:
    observed = population().observed
    if size is not None:
        rewritten(folder / OBSERVED, size)
    blocks = list(ObservedFile(folder).blocks(drivers, np.random.default_rng(1)))
    counts = [len(drivers_of(block)) for block in blocks]
    assert counts[:-1] == [drivers] * (len(counts) - 1)
    assert sorted(chain(*map(drivers_of, blocks))) == list(range(len(NAMES)))
    for block in blocks:
        for who in drivers_of(block):
            found = narrow(block.take(block.driver == who))
            assert_same_observed(found, narrow(observed.take(observed.driver == who)))


def test_blocks_are_drawn(folder: Path) -> None:
    stored = ObservedFile(folder)

    def order(seed: int) -> list[list[int]]:
        blocks = stored.blocks(3, np.random.default_rng(seed))
        return [sorted(drivers_of(block)) for block in blocks]

    assert order(0) == order(0)
    orders = [order(seed) for seed in range(20)]
    assert len({str(each) for each in orders}) > 15
    together = np.zeros((12, 12), np.int64)
    for blocks in orders:
        for block in blocks:
            together[np.ix_(block, block)] += 1
    assert (together > 0).mean() > 0.9  # also those who are far apart in the file
    first = np.bincount([who for blocks in orders for who in blocks[0]], minlength=12)
    assert (first > 0).sum() > 9  # of 12; each is in 1 of 4 first blocks


def test_drivers_whose_episodes_lie_apart_are_put_together(folder: Path, tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    who = rng.integers(-1, 4, 40)
    apart = made_up([2] * 40, driver=who.tolist(), names=NAMES[:4], with_truth=False)
    write_demonstrations(tmp_path, apart)
    stored = ObservedFile(tmp_path)
    names = stored.names
    blocks = list(stored.blocks(2, rng))
    assert [len(drivers_of(block)) for block in blocks] == [2, 2]
    for block in blocks:
        for index in drivers_of(block):
            found = block.take(block.driver == index)
            expected = apart.observed.take(who == NAMES.index(names[index]))
            np.testing.assert_array_equal(found.states, expected.states)
            np.testing.assert_array_equal(found.seeds, expected.seeds)
    assert sum(map(len, blocks)) == (who != MISSING).sum()  # only unknown drivers are left out


def test_without_known_drivers_there_are_no_blocks(tmp_path: Path) -> None:
    write_demonstrations(tmp_path, made_up([2, 3], driver=[-1, -1], names=(), with_truth=False))
    assert list(ObservedFile(tmp_path).blocks(2, np.random.default_rng(0))) == []


@pytest.mark.parametrize("group", [0, 4, -1])
def test_a_flipped_bit_is_found_where_it_lies(folder: Path, group: int) -> None:
    path = folder / OBSERVED
    content, metadata = bytearray(path.read_bytes()), pq.read_metadata(path)
    group %= metadata.num_row_groups
    column = metadata.row_group(group).column(7)
    assert column.path_in_schema == "lidar_0"
    content[column.data_page_offset + column.total_compressed_size - 3] ^= 0x04
    path.write_bytes(content)
    stored, read = ObservedFile(folder), 0
    whole = int(np.searchsorted(stored._index.first, stored._file.first_rows[group], "right")) - 1
    with pytest.raises(ValueError, match=r"observed\.parquet is damaged: .*CRC"):  # noqa: PT012
        for piece in stored.pieces(1):
            read += len(piece)
    assert read == whole  # all episodes before it


def alerts_changed(path: Path, row: int) -> pa.Table:
    table = pq.read_table(path).replace_schema_metadata(metadata_of(path))
    alerts = table["alert"].to_pylist()
    alerts[row] = 1 - alerts[row]
    at, field = table.column_names.index("alert"), table.schema.field("alert")
    return table.set_column(at, field, pa.array(alerts, pa.int8()))


def test_rows_that_differ_from_their_groups_checksum_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(parquet, "_MOST_ROWS", 10)
    write_demonstrations(tmp_path, made_up([5] * 8, with_truth=False))
    path = tmp_path / OBSERVED
    pq.write_table(alerts_changed(path, 23), path, row_group_size=10)  # the same groups
    stored = ObservedFile(tmp_path)
    for first in (0, 1, 2, 3, 6, 7):
        stored.read(first, first + 1)
    for first, stop in [(4, 5), (5, 6), (3, 5), (0, 8)]:
        with pytest.raises(ValueError, match=r"the checksum of its rows differs; copy it again"):
            stored.read(first, stop)


@pytest.mark.parametrize("size", [1, 7, 1000])
def test_without_checksums_of_its_groups_a_file_is_checked_when_it_is_opened(
    folder: Path, size: int
) -> None:
    path = folder / OBSERVED
    pq.write_table(alerts_changed(path, 23), path, row_group_size=size)
    with pytest.raises(ValueError, match=r"the checksum of its rows differs; copy it again"):
        ObservedFile(folder)


@pytest.mark.parametrize("size", [1, 2, 1000])
@pytest.mark.parametrize(
    ("name", "row", "value", "message"),
    [
        ("step", 2, 3, "row 2 is step 3 of episode 0"),
        ("step", 4, 1, "row 4 is step 1 of episode 1"),
        ("episode", 4, 2, "row 4 is step 0 of episode 2"),
        ("driver", 1, "homer", "driver changes within an episode"),
        ("seed", 6, 5, "seed changes within an episode"),
        ("seed", 6, None, "seed changes within an episode"),
        ("crashed", 7, False, "a crashed car is whole again"),
    ],
)
def test_rows_are_checked_across_groups(
    tmp_path: Path, size: int, name: str, row: int, value: Any, message: str
) -> None:
    data = made_up([4, 4], crash_step=[-1, 2], with_truth=False)
    write_demonstrations(tmp_path, data)
    table = pq.read_table(tmp_path / OBSERVED)
    values = table[name].to_pylist()
    values[row] = value
    at, field = table.column_names.index(name), table.schema.field(name)
    column = pa.array(values, field.type if name != "driver" else pa.string())
    if name == "driver":
        column = column.dictionary_encode()
    write_signed(tmp_path / OBSERVED, table.set_column(at, field, column), row_group_size=size)
    with pytest.raises(ValueError, match=message):
        ObservedFile(tmp_path)


# Memory.

POOL = pa.proxy_memory_pool(pa.default_memory_pool())
"""Counts what Arrow takes while it is in use; what it gave must not outlive it."""


@contextmanager
def peak_memory() -> Iterator[list[int]]:
    """The most memory that is taken meanwhile by NumPy and Python, and by Arrow [bytes]."""
    found: list[int] = []
    before = pa.default_memory_pool()
    pa.set_memory_pool(POOL)
    tracemalloc.start()
    try:
        yield found
        found += [tracemalloc.get_traced_memory()[1], POOL.max_memory()]
    finally:
        tracemalloc.stop()
        pa.set_memory_pool(before)


def many_drivers(groups: int, rows: int, steps: int) -> Iterator[Demonstrations]:
    """Chunks of ``rows`` rows, of drivers with 10 episodes each."""
    episodes = rows // steps
    some = made_up([steps] * episodes, names=("ann",), with_truth=False).observed
    names = tuple(f"population-{k}" for k in range(groups * episodes // 10))
    for group in range(groups):
        who = (group * episodes + np.arange(episodes)) // 10
        yield Demonstrations(replace(some, driver=who, names=names))


def check_memory(folder: Path, groups: int, rows: int, steps: int) -> None:
    """Passes over a file take memory for some groups of rows, however many there are."""
    write_demonstrations(folder, many_drivers(groups, rows, steps))
    metadata = pq.read_metadata(folder / OBSERVED)
    assert metadata.num_row_groups == groups
    group = rows * (LAYOUT.size * 4 + 2 * 8)
    episodes = groups * (rows // steps)
    light = episodes * 400  # index, and names of drivers, in Python
    with peak_memory() as peaks:
        stored = ObservedFile(folder)
        assert sum(len(piece) for piece in stored.pieces(rows // steps)) == episodes
        each = rows // steps // 10  # drivers of a group
        blocks = stored.blocks(each, np.random.default_rng(0))
        assert sum(len(block) for block in blocks) == episodes
    numpy, arrow = peaks
    assert numpy < 12 * group + light + 2**20
    assert arrow < 6 * group + 2**20
    assert numpy + arrow < groups * group / 3  # so that the bound means something


def test_memory_does_not_grow_with_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(parquet, "_MOST_ROWS", 2000)
    check_memory(tmp_path, groups=90, rows=2000, steps=20)


@pytest.mark.slow  # some millions of steps
def test_memory_does_not_grow_with_a_file_of_millions_of_steps(tmp_path: Path) -> None:
    check_memory(tmp_path, groups=100, rows=51_200, steps=100)
