"""Files made to do harm: refused within 2 s and 300 MiB, all in one process with that limit."""

from __future__ import annotations

import json
import os
import re
import stat
import sys
from pathlib import Path

import fresh
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import torch
from demonstrations import LAYOUT, made_up
from model_cards import with_card
from parquet_files import write_signed
from trait_models import save_driver

from hmi_marl.demonstrations.parquet import OBSERVED, write_demonstrations
from hmi_marl.demonstrations.step_file import observed_schema
from hmi_marl.files import sha256_of, write_text
from hmi_marl.reading import parse_json, parse_tensors, read_bytes, read_json
from hmi_marl.training.runs.checkpoint import Checkpoint

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="pipes and limits of Linux")


def test_pipes_and_devices_are_refused_without_waiting(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to("/dev/zero")
    for name in ("pipe", "link"):
        for read in (read_json, sha256_of, lambda path: read_bytes(path, 10)):
            with pytest.raises(ValueError, match=f"{name} is a pipe, a device or a socket; name a"):
                read(tmp_path / name)
        with pytest.raises(ValueError, match="is a pipe, a device or a socket"):
            Checkpoint.load(tmp_path / name)
    with pytest.raises(IsADirectoryError):
        read_json(tmp_path)
    with pytest.raises(FileNotFoundError):
        read_json(tmp_path / "nowhere")


def test_nothing_replaces_a_pipe(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to(tmp_path / "pipe")
    for name in ("pipe", "link"):
        with pytest.raises(OSError, match="cannot replace a pipe, a device or a socket"):
            write_text(tmp_path / name, "x")
    assert stat.S_ISFIFO((tmp_path / "pipe").stat().st_mode)


def test_a_file_of_the_limit_is_read_and_a_larger_one_is_not(tmp_path: Path) -> None:
    (tmp_path / "ten").write_bytes(b"0123456789")
    assert read_bytes(tmp_path / "ten", 10) == b"0123456789"
    with pytest.raises(ValueError, match="ten has 10 bytes, more than the 9 that are read here"):
        read_bytes(tmp_path / "ten", 9)
    with pytest.raises(ValueError, match="grows while it is read"):
        read_bytes(Path("/proc/self/status"), 10**6)  # whose size is said to be 0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[" * 100_000, "nested more than 64 levels"),
        ("[" * 65 + "]" * 65, "nested more than 64 levels"),
        ('{"a":' * 900 + "1" + "}" * 900, "nested more than 64 levels"),
        ("[1, Infinity]", "Infinity is no number in JSON"),
        ("NaN", "NaN is no number in JSON"),
        ("1e999", "1e999 is out of range"),
        ("1" * 21, "a whole number of more than 20 digits"),
        ("-" + "1" * 10_000, "a whole number of more than 20 digits"),
        ("[" + "0," * 2_000_000 + "0]", "more than 2000000 values"),
        (b"\xff", "can't decode byte 0xff"),
        ("", "Expecting value"),
    ],
    ids=lambda text: str(text)[:12],
)
def test_json_is_bounded(text: str | bytes, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        parse_json(text)


def test_json_within_the_bounds_is_read() -> None:
    assert parse_json(json.dumps(2**64 - 1)) == 2**64 - 1
    assert parse_json("[" * 64 + "]" * 64)
    assert parse_json('{"a": 1, "a": 2}') == {"a": 2}  # as JSON has it
    assert parse_json("3") == 3
    assert parse_json(b'"\\ud800"') == "\ud800"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "cut off, or something else"),
        (b"\xff" * 8, "cut off, or something else"),
        ((2**40).to_bytes(8, "little") + b"{}", "cut off, or something else"),
        ((2).to_bytes(8, "little") + b"[]", "its header is something else"),
        ((20).to_bytes(8, "little") + b'{"__metadata__":  3}', "its header is something else"),
    ],
    ids=str,
)
def test_headers_of_weights_are_checked_first(content: bytes, message: str) -> None:
    def load(content: bytes) -> dict[str, object]:
        raise AssertionError("read before it is checked")

    with pytest.raises(ValueError, match=message):
        parse_tensors(content, load)


SMALL = {"activation": "relu", "rnn_hidden_dim": 0}
LIMITED = """
import json, resource, sys, time
from pathlib import Path
from hmi_marl.agents.learned.policy import load_policy, read_policy
from hmi_marl.agents.learned.trait_model import load_traits
from hmi_marl.demonstrations.parquet import read_observed
from hmi_marl.envs.config import TeamConfig
from hmi_marl.training.runs.checkpoint import Checkpoint
from hmi_marl.training.runs.folder import read_settings

pages = int(Path("/proc/self/statm").read_text().split()[0])
limit = pages * resource.getpagesize() + 2**30  # addresses; threads take many
resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
folder, found = Path(sys.argv[1]), {}
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
readers = {
    "driver.json": read_policy,
    "observed.parquet": lambda path: read_observed(path.parent),
    "checkpoint.safetensors": Checkpoint.load,
    "run.json": read_settings,
}
for path in sorted(folder.glob("*/*")):
    if path.name not in readers:
        continue
    began = time.monotonic()
    try:
        readers[path.name](path)
        outcome = "read"
    except BaseException as error:
        outcome = f"{type(error).__name__}: {error}"
    found[path.parent.name] = outcome, time.monotonic() - began
print(json.dumps([found, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before]))
"""


def policy_with(folder: Path, **changed: object) -> None:
    save_driver(folder)
    with_card(folder / "driver.json", **changed)


def parquet_with(folder: Path, change: str, value: object) -> None:
    write_demonstrations(folder, made_up([3], with_truth=False))
    table = pq.read_table(folder / OBSERVED)
    stamp = json.loads(table.schema.metadata[b"hmi-marl"])
    stamp["layout"][0][change] = value
    stamped = table.replace_schema_metadata({"hmi-marl": json.dumps(stamp)})
    write_signed(folder / OBSERVED, stamped)


def parquet_of_many_rows(folder: Path, one_long: bool) -> None:
    """Some kilobytes that stand for gigabytes: rows all alike, or one long episode among many."""
    folder.mkdir()
    write_demonstrations(folder, made_up([3], with_truth=False))
    stamp = pq.read_schema(folder / OBSERVED).metadata
    count = 20_000 if one_long else 1_000_000
    schema = observed_schema(LAYOUT).with_metadata(stamp)
    columns = {field.name: np.zeros(count, np.int8) for field in schema}
    if one_long:
        half = count // 2
        columns["episode"] = np.maximum(np.arange(count) - half + 1, 0)
        columns["step"] = np.where(np.arange(count) < half, np.arange(count), 0)
    arrays = []
    for field in schema:
        if field.name == "driver":
            codes = pa.array(np.zeros(count, np.int32))
            arrays.append(pa.DictionaryArray.from_arrays(codes, pa.array(["x"])))
        else:
            arrays.append(pa.array(columns[field.name]).cast(field.type))
    write_signed(
        folder / OBSERVED,
        pa.table(arrays, schema=schema),
        compression="zstd",
        use_dictionary=["driver"],
    )


@pytest.mark.slow  # a process of its own
def test_files_made_to_fill_the_memory_are_refused_soon(tmp_path: Path) -> None:
    sparse = tmp_path / "sparse weights"
    save_driver(sparse)
    os.truncate(sparse / "driver.safetensors", 2**38)
    pipe = tmp_path / "pipe"
    save_driver(pipe)
    (pipe / "driver.safetensors").unlink()
    os.mkfifo(pipe / "driver.safetensors")
    zero = tmp_path / "zero"
    save_driver(zero)
    (zero / "driver.safetensors").unlink()
    (zero / "driver.safetensors").symlink_to("/dev/zero")
    policy_with(tmp_path / "wide", network={"hidden_dims": [10**9] * 50_000} | SMALL)
    policy_with(tmp_path / "many", network={"hidden_dims": [1] * 10**6} | SMALL)
    policy_with(tmp_path / "endless", reads=[["speed", 10**18]])
    parquet_with(tmp_path / "columns", "size", 10**9)
    parquet_with(tmp_path / "named", "name", [1])
    parquet_of_many_rows(tmp_path / "rows", one_long=False)
    parquet_of_many_rows(tmp_path / "long", one_long=True)
    (tmp_path / "settings").mkdir()
    (tmp_path / "settings" / "run.json").write_text("[" + "[]," * 3_000_000 + "[]]")
    for name, size in (("cut", 2**20), ("huge", 2**40)):
        (tmp_path / name).mkdir()
        path = tmp_path / name / "checkpoint.safetensors"
        Checkpoint(tensors={"driver": {"x": torch.zeros(4)}}).save(path)
        os.truncate(path, size)
    # Arrow's own pool reserves a GiB of addresses.
    printed = fresh.run("-c", LIMITED, tmp_path, ARROW_DEFAULT_MEMORY_POOL="system")
    found, memory = json.loads(printed)
    assert memory < 300 * 2**10  # [KiB]
    assert set(found) == {path.name for path in tmp_path.iterdir()}
    expected = {
        "sparse weights": "more than the",
        "pipe": "is a pipe, a device or a socket",
        "zero": "is a pipe, a device or a socket",
        "wide": "driver.json|is not the file|do not fit",
        "many": "more than 200000 values",
        "endless": "reads|layer0.weight has shape",
        "columns": "fewer than its layout of",
        "named": r"layout\[0\].name is a text, not \[1\]",
        "rows": "of memory, over 1000 times its size",
        "long": "of memory, over 1000 times its size",
        "settings": "more than 2000000 values",
        "cut": "its checksum differs",
        "huge": "more than the",
    }
    for name, (outcome, seconds) in found.items():
        assert outcome.startswith("ValueError: "), (name, outcome)
        assert str(tmp_path) in outcome, (name, outcome)
        assert re.search(expected[name], outcome), (name, outcome)
        assert seconds < 2, (name, seconds)
