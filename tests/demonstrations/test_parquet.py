import dataclasses
import hashlib
import json
import shutil
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from demonstrations import LAYOUT, assert_same_observed, assert_same_truth, made_up
from hypothesis import given, settings
from hypothesis import strategies as st
from parquet_files import metadata_of, write_signed

import hmi_marl
from hmi_marl.demonstrations import parquet
from hmi_marl.demonstrations.dataset import Demonstrations
from hmi_marl.demonstrations.parquet import (
    OBSERVED,
    TRUTH,
    read_demonstrations,
    read_observed,
    write_demonstrations,
)
from hmi_marl.demonstrations.step_file import FORMAT, column_names


@st.composite
def demonstrations(draw: st.DrawFn) -> Demonstrations:
    length = draw(st.lists(st.integers(1, 6), min_size=1, max_size=7))
    names = draw(st.lists(st.text(st.characters(codec="utf-8"), min_size=1), unique=True))
    return made_up(
        length,
        draw(st.integers(0, 9)),
        [draw(st.integers(-1, steps - 1)) for steps in length],
        [draw(st.integers(-1, len(names) - 1)) for _ in length],
        tuple(names),
        draw(st.booleans()),
        draw(st.booleans()),
    )


def chunked(data: Demonstrations, size: int) -> list[Demonstrations]:
    return [data.take(np.arange(len(data))[k : k + size]) for k in range(0, len(data), size)]


@settings(max_examples=40)
@given(data=demonstrations(), size=st.integers(1, 8))
def test_what_is_read_is_what_was_written(
    tmp_path_factory: pytest.TempPathFactory, data: Demonstrations, size: int
) -> None:
    folder = tmp_path_factory.mktemp("data")
    write_demonstrations(folder, chunked(data, size))
    read = read_demonstrations(folder)
    assert_same_observed(read.observed, data.observed)
    assert_same_truth(read.truth, data.truth)
    assert_same_observed(read_observed(folder), data.observed)
    shutil.rmtree(folder)


@settings(max_examples=20)
@given(data=demonstrations(), rows=st.integers(1, 9))
def test_groups_of_rows_are_of_whole_episodes(
    tmp_path_factory: pytest.TempPathFactory, data: Demonstrations, rows: int
) -> None:
    folder = tmp_path_factory.mktemp("data")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(parquet, "_MOST_ROWS", rows)
        write_demonstrations(folder, data)
    for name in (OBSERVED, TRUTH) if data.truth is not None else (OBSERVED,):
        file = pq.ParquetFile(folder / name)
        starts = [
            file.read_row_group(group)["step"][0].as_py() for group in range(file.num_row_groups)
        ]
        assert set(starts) == {0}
        sizes = [file.metadata.row_group(group).num_rows for group in range(len(starts))]
        assert max(sizes) <= max(rows, int(data.observed.length.max()))
        assert json.loads(file.metadata.metadata[b"hmi-marl groups"])[0][0] == sizes[0]
    assert_same_observed(read_observed(folder), data.observed)
    shutil.rmtree(folder)


def test_a_group_names_its_own_drivers_alone(tmp_path: Path) -> None:
    names = tuple(f"population-{k}" for k in range(50))
    data = made_up([3] * 4, driver=[49, 7, -1, 7], names=names)
    write_demonstrations(tmp_path, chunked(data, 2))
    file = pq.ParquetFile(tmp_path / OBSERVED)
    found = [file.read_row_group(group)["driver"].chunk(0).dictionary for group in (0, 1)]
    assert [each.to_pylist() for each in found] == [["population-7", "population-49"], [names[7]]]
    assert read_observed(tmp_path).labels() == [names[49], names[7], None, names[7]]


def test_what_fails_while_a_chunk_is_written_is_reported(
    tmp_path: Path, data: Demonstrations, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*args: Any, **kwargs: Any) -> None:
        raise OSError("no space left")

    monkeypatch.setattr(pq.ParquetWriter, "write_table", full)
    made = []

    def chunks() -> Iterator[Demonstrations]:
        for _ in range(100):
            made.append(1)
            yield data

    with pytest.raises(OSError, match="no space left"):
        write_demonstrations(tmp_path, chunks())
    assert len(made) == 2  # no more are made in vain
    assert list(tmp_path.iterdir()) == []


def test_a_chunk_is_written_while_the_next_is_made(tmp_path: Path, data: Demonstrations) -> None:
    threads, names = set(), set()

    def chunks() -> Iterator[Demonstrations]:
        for _ in range(3):
            names.update(each.name for each in threading.enumerate())
            threads.add(threading.current_thread())
            yield data

    write_demonstrations(tmp_path, chunks())
    assert threads == {threading.current_thread()}
    assert any(name.startswith("hmi-marl-write") for name in names)
    assert not any(each.name.startswith("hmi-marl-write") for each in threading.enumerate())


@pytest.fixture
def data() -> Demonstrations:
    return made_up([4, 2, 3], crash_step=[-1, 1, 0], driver=[0, -1, 0])


@pytest.fixture
def folder(tmp_path: Path, data: Demonstrations) -> Path:
    write_demonstrations(tmp_path, data)
    return tmp_path


def test_the_columns_are_the_documented_ones(folder: Path) -> None:
    keys = ["episode", "step", "driver", "seed", "crashed", "action", "alert"]
    observed = pq.read_table(folder / OBSERVED)
    assert observed.column_names == keys + column_names(LAYOUT)
    assert observed.num_rows == 4 + 2 + 3
    assert observed["driver"].to_pylist() == ["lisa"] * 4 + [None] * 2 + ["lisa"] * 3
    assert observed["step"].to_pylist() == [0, 1, 2, 3, 0, 1, 0, 1, 2]
    assert observed["crashed"].to_pylist() == [False] * 5 + [True] * 4
    truth = pq.read_table(folder / TRUTH)
    hidden = ["distracted", "accepted", "counter", "intended_action"]
    assert truth.column_names == [*keys[:2], *hidden, "beta", "alpha", "eta", "inflation"]


def test_version_and_making_are_stamped(folder: Path) -> None:
    stamp = json.loads(pq.read_schema(folder / OBSERVED).metadata[b"hmi-marl"])
    assert stamp["format"] == FORMAT
    assert stamp["version"] == hmi_marl.__version__
    assert stamp["about"] == {"hmi": "random:0.2"}
    assert [part["name"] for part in stamp["layout"]] == list(LAYOUT.slices)


def test_the_truth_leaves_no_trace_in_the_observed_file(
    tmp_path: Path, data: Demonstrations
) -> None:
    other = made_up([4, 2, 3], seed=7).truth
    assert other is not None
    files = []
    for name, truth in (("one", data.truth), ("other", other), ("none", None)):
        write_demonstrations(tmp_path / name, Demonstrations(data.observed, truth))
        files.append((tmp_path / name / OBSERVED).read_bytes())
    assert files[0] == files[1] == files[2]


def test_what_learns_does_not_need_the_truths_file(folder: Path, data: Demonstrations) -> None:
    (folder / TRUTH).write_bytes(b"not to be opened")
    assert_same_observed(read_observed(folder), data.observed)
    (folder / TRUTH).unlink()
    assert read_demonstrations(folder).truth is None


def test_a_dataset_takes_the_place_of_the_last(folder: Path) -> None:
    write_demonstrations(folder, made_up([2], with_truth=False))
    assert [path.name for path in folder.iterdir()] == [OBSERVED]
    assert len(read_demonstrations(folder)) == 1


def test_a_kill_in_between_leaves_the_last_dataset(folder: Path, data: Demonstrations) -> None:
    def interrupted() -> Any:
        yield made_up([4])
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_demonstrations(folder, interrupted())
    assert sorted(path.name for path in folder.iterdir()) == [OBSERVED, TRUTH]
    assert_same_observed(read_demonstrations(folder).observed, data.observed)


def test_chunks_must_go_together(tmp_path: Path, data: Demonstrations) -> None:
    with pytest.raises(ValueError, match="no demonstrations to write"):
        write_demonstrations(tmp_path, [])
    with pytest.raises(ValueError, match="all chunks of a dataset hold the truth"):
        write_demonstrations(tmp_path, [data, Demonstrations(data.observed)])
    with pytest.raises(ValueError, match="all chunks of a dataset hold the truth"):
        write_demonstrations(tmp_path, [Demonstrations(data.observed), data])
    other = Demonstrations(dataclasses.replace(data.observed, about={"hmi": "never"}))
    with pytest.raises(ValueError, match="one layout and one stamp"):
        write_demonstrations(tmp_path, [Demonstrations(data.observed), other])
    assert list(tmp_path.iterdir()) == []


def refused(folder: Path, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        read_demonstrations(folder)


def test_nothing_there_is_reported(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"no demonstrations at .* hmi-marl collect"):
        read_observed(tmp_path)


@pytest.mark.parametrize("name", [OBSERVED, TRUTH])
def test_a_file_that_was_cut_off_is_refused(folder: Path, name: str) -> None:
    content = (folder / name).read_bytes()
    for size in (0, 3, len(content) // 2, len(content) - 1):
        (folder / name).write_bytes(content[:size])
        refused(folder, f"{name} is no parquet file, or cut off")


def test_altered_numbers_are_found(folder: Path, data: Demonstrations) -> None:
    path = folder / OBSERVED
    content = path.read_bytes()
    found = 0
    for at in range(4, len(content) - 8, 31):
        altered = bytearray(content)
        altered[at] ^= 0x10
        path.write_bytes(altered)
        try:
            read = read_observed(folder)
        except ValueError:
            found += 1
        else:  # something that is not read here, such as the name of the program
            assert_same_observed(read, data.observed)
            assert read.about == data.observed.about
    assert found > 100


@pytest.mark.parametrize("name", [OBSERVED, TRUTH])
def test_a_changed_description_is_found(folder: Path, name: str) -> None:
    table = pq.read_table(folder / name)
    stamp = json.loads(table.schema.metadata[b"hmi-marl"])
    changed = json.dumps(stamp | {"version": "9"}).encode()
    kept = metadata_of(folder / name) | {b"hmi-marl": changed}
    pq.write_table(table.replace_schema_metadata(kept), folder / name)
    if name == OBSERVED:
        (folder / TRUTH).unlink()  # which would notice as well
    refused(folder, rf"{name} has a damaged stamp: its checksum differs; copy it again")


def with_metadata(path: Path) -> pa.Table:
    return pq.read_table(path).replace_schema_metadata(metadata_of(path))


def test_rows_that_do_not_belong_to_their_checksum_are_found(folder: Path) -> None:
    (folder / TRUTH).unlink()
    table = with_metadata(folder / OBSERVED)
    alerts = [1 - alert for alert in table["alert"].to_pylist()]
    pq.write_table(replace_rows(table, "alert", alerts), folder / OBSERVED)
    refused(folder, r"observed\.parquet is damaged: the checksum of its rows differs; copy it")


def test_checksums_do_not_depend_on_groups_of_rows(folder: Path, data: Demonstrations) -> None:
    (folder / TRUTH).unlink()
    table = with_metadata(folder / OBSERVED)
    for size in (1, 3, 1000):
        pq.write_table(table, folder / OBSERVED, row_group_size=size)
        assert_same_observed(read_observed(folder), data.observed)


def write_table(folder: Path, table: pa.Table, name: str = OBSERVED) -> None:
    write_signed(folder / name, table)


def test_foreign_files_and_other_formats_are_refused(folder: Path) -> None:
    table = pq.read_table(folder / OBSERVED)
    write_table(folder, table.replace_schema_metadata({}))
    refused(folder, "no demonstrations that can be read here: format None")
    for stamp, message in (
        ({"format": "hmi-marl demonstrations 1"}, "format 'hmi-marl demonstrations 1'"),
        ({"format": FORMAT}, "does not say how the data were made"),
        ({"format": FORMAT, "about": {}}, "its stamp has no layout"),
        ({"format": FORMAT, "about": {}, "layout": [{"name": "lidar"}]}, "damaged layout"),
        ({"format": FORMAT, "about": {}, "layout": 3}, "damaged layout"),
    ):
        write_table(folder, table.replace_schema_metadata({"hmi-marl": json.dumps(stamp)}))
        refused(folder, message)
    stamp = json.loads(table.schema.metadata[b"hmi-marl"])
    stamp["layout"][0]["size"] = "many"
    write_table(folder, table.replace_schema_metadata({"hmi-marl": json.dumps(stamp)}))
    refused(folder, "damaged layout: .*many")
    write_table(folder, table.replace_schema_metadata({"hmi-marl": "{"}))
    refused(folder, "damaged stamp")


def test_other_columns_and_types_are_refused(folder: Path) -> None:
    table = pq.read_table(folder / OBSERVED)
    write_table(folder, table.drop_columns("speed"))
    refused(folder, r"other columns than its stamp says \(missing: speed; foreign: none\)")
    write_table(folder, table.append_column("distracted", table["alert"]))
    refused(folder, r"missing: none; foreign: distracted")
    at = table.column_names.index("speed")
    double = pa.field("speed", pa.float64(), nullable=False)
    write_table(folder, table.set_column(at, double, table["speed"].cast(pa.float64())))
    refused(folder, "column speed is .*double not null, not .*float not null")


def test_hidden_parts_in_the_observed_file_are_refused(folder: Path) -> None:
    table = pq.read_table(folder / OBSERVED)
    stamp = json.loads(table.schema.metadata[b"hmi-marl"])
    part = {"name": "distracted", "size": 1, "low": 0.0, "high": 1.0, "meaning": "d"}
    stamp["layout"].append(part)
    field = pa.field("distracted", pa.float32(), nullable=False)
    hidden = table.append_column(field, table["alert"].cast(pa.float32()))
    write_table(folder, hidden.replace_schema_metadata({"hmi-marl": json.dumps(stamp)}))
    refused(folder, "in this order and no others, but got .*distracted")


def replace_rows(table: pa.Table, name: str, values: Any) -> pa.Table:
    at = table.column_names.index(name)
    return table.set_column(at, table.schema.field(name), pa.array(values, table[name].type))


@pytest.mark.parametrize(
    ("name", "row", "value", "message"),
    [
        ("step", 2, 3, "row 2 is step 3 of episode 0"),
        ("step", 0, 1, "row 0 is step 1 of episode 0"),
        ("episode", 4, 2, "row 4 is step 0 of episode 2"),
        ("episode", 8, 3, "row 8 is step 2 of episode 3"),
        ("driver", 1, "homer", "driver changes within an episode"),
        ("seed", 1, 5, "seed changes within an episode"),
        ("crashed", 7, False, "a crashed car is whole again"),
        ("action", 3, 5, "actions lies in 0 to 4, but got 5"),
        ("action", 3, -1, "actions lies in 0 to 4, but got -1"),
        ("alert", 3, 2, "alerts lies in 0 to 1, but got 2"),
        ("speed", 3, float("nan"), "speed is not finite everywhere"),
        ("position", 3, 7.0, "position lies in"),
        ("lane_0", 3, 0.5, "lane is one-hot"),
    ],
)
def test_rows_that_cannot_be_are_refused(
    folder: Path, name: str, row: int, value: Any, message: str
) -> None:
    table = pq.read_table(folder / OBSERVED)
    values = table[name].to_pylist()
    values[row] = value
    if name == "driver":
        values = pa.array(values).dictionary_encode()
    write_table(folder, replace_rows(table, name, values))
    refused(folder, message)


def test_rows_that_are_missing_or_out_of_order_are_refused(folder: Path) -> None:
    table = pq.read_table(folder / OBSERVED)
    write_table(folder, table.slice(1))
    refused(folder, "row 0 is step 1 of episode 0; episodes count from 0")
    write_table(folder, table.take([0, 1, 3]))
    refused(folder, "row 2 is step 3")
    write_table(folder, table.slice(0, 0))
    refused(folder, "holds no steps")
    seeds = [None] * 4 + table["seed"].to_pylist()[4:]
    write_table(folder, replace_rows(table, "seed", seeds))
    refused(folder, "some episodes have a seed and some have none")


def test_a_truth_of_another_dataset_is_refused(folder: Path, tmp_path: Path) -> None:
    write_demonstrations(tmp_path / "other", made_up([4, 2, 3], seed=3))
    shutil.copy(tmp_path / "other" / TRUTH, folder / TRUTH)
    refused(folder, "is not the truth of observed.parquet in the same folder")
    shutil.copy(folder / OBSERVED, folder / TRUTH)
    refused(folder, "truth.parquet has other columns")
    shutil.copy(tmp_path / "other" / TRUTH, tmp_path / "other" / OBSERVED)
    refused(tmp_path / "other", "holds no observed data")


@pytest.mark.parametrize(
    ("name", "row", "value", "message"),
    [
        ("beta", 1, 0.123, "traits change within an episode"),
        ("distracted", 1, 3, "distracted lies in 0 to 1"),
        ("step", 3, 4, "row 3 is step 4"),
        ("intended_action", 3, -1, "of other episodes|d, i and c are 0"),
    ],
)
def test_a_truth_that_cannot_be_is_refused(
    folder: Path, name: str, row: int, value: Any, message: str
) -> None:
    table = pq.read_table(folder / TRUTH)
    values = table[name].to_pylist()
    values[row] = value
    digest = hashlib.sha256((folder / OBSERVED).read_bytes()).hexdigest()
    belongs = {b"hmi-marl observed": digest.encode()}
    table = replace_rows(table, name, values)
    write_table(folder, table.replace_schema_metadata(table.schema.metadata | belongs), TRUTH)
    refused(folder, message)


def test_a_truth_of_shorter_episodes_is_refused(folder: Path) -> None:
    table = pq.read_table(folder / TRUTH)
    digest = hashlib.sha256((folder / OBSERVED).read_bytes()).hexdigest()
    belongs = {b"hmi-marl observed": digest.encode()}
    stamped = table.replace_schema_metadata(table.schema.metadata | belongs)
    write_table(folder, stamped.slice(0, 8), TRUTH)
    refused(folder, "its episodes are not those of observed.parquet")


def test_without_pyarrow_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [m for m in sys.modules if m.startswith("hmi_marl.demonstrations.")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(ModuleNotFoundError, match=r"needs pyarrow: pip install .*\[data\]"):
        import hmi_marl.demonstrations.parquet  # noqa: F401


def test_importing_the_command_line_needs_neither_pyarrow_nor_minari() -> None:
    code = (
        "import sys, hmi_marl\n"
        "absent = {'pyarrow', 'minari', 'h5py'}\n"
        "print(sorted(absent & set(sys.modules)))\n"
        "sys.modules |= dict.fromkeys(absent)  # as if they were not installed\n"
        "import hmi_marl.cli, hmi_marl.demonstrations.dataset, hmi_marl.demonstrations.recording\n"
        "hmi_marl.cli.parse(['collect'])\n"
    )
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
