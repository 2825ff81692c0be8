import hashlib
import json
import math
from pathlib import Path

import numpy as np
import pytest

from hmi_marl.files import (
    json_value,
    make_folder,
    sha256,
    sha256_of,
    write_atomically,
    write_bytes,
    write_json,
    write_text,
)


def content(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.parametrize("error", [RuntimeError("out of ink"), KeyboardInterrupt()])
def test_a_failed_write_leaves_the_old_file(tmp_path: Path, error: BaseException) -> None:
    path = tmp_path / "table.txt"
    path.write_text("old")

    def fail(temporary: Path) -> None:
        temporary.write_text("half of the n")
        raise error

    with pytest.raises(type(error)):
        write_atomically(path, fail)
    assert path.read_text() == "old"
    assert content(tmp_path) == ["table.txt"]


def test_a_failed_first_write_leaves_nothing(tmp_path: Path) -> None:
    def fail(temporary: Path) -> None:
        raise RuntimeError

    with pytest.raises(RuntimeError):
        write_atomically(tmp_path / "table.txt", fail)
    assert content(tmp_path) == []


def test_the_old_file_stands_until_the_new_one_is_whole(tmp_path: Path) -> None:
    path = tmp_path / "table.txt"
    path.write_text("old")
    seen = []

    def write(temporary: Path) -> None:
        temporary.write_text("new")
        seen.append(path.read_text())

    write_atomically(path, write)
    assert seen == ["old"]
    assert path.read_text() == "new"
    assert content(tmp_path) == ["table.txt"]


def test_the_temporary_file_keeps_the_suffix_and_the_folder(tmp_path: Path) -> None:
    path, given = tmp_path / "clip.gif", []

    def write(temporary: Path) -> None:
        given.append(temporary)

    write_atomically(path, write)
    (temporary,) = given
    assert temporary != path
    assert temporary.suffix == ".gif"
    assert temporary.parent == tmp_path


def test_a_writer_may_replace_the_temporary_file(tmp_path: Path) -> None:
    # as ffmpeg does
    path = tmp_path / "clip.mp4"

    def write(temporary: Path) -> None:
        temporary.unlink()
        temporary.write_bytes(b"anew")

    write_atomically(path, write)
    assert path.read_bytes() == b"anew"


def test_folders_are_made(tmp_path: Path) -> None:
    write_text(tmp_path / "runs" / "table" / "table.txt", "here")
    assert (tmp_path / "runs" / "table" / "table.txt").read_text() == "here"


def test_others_may_read_what_was_written(tmp_path: Path) -> None:
    write_bytes(tmp_path / "page.html", b"<p>")
    assert (tmp_path / "page.html").stat().st_mode & 0o444 == 0o444


def test_bytes_are_written_as_they_are(tmp_path: Path) -> None:
    everything = bytes(range(256))
    write_bytes(tmp_path / "raw", everything)
    assert (tmp_path / "raw").read_bytes() == everything


def test_text_is_utf_8_with_its_own_line_ends(tmp_path: Path) -> None:
    write_text(tmp_path / "traits.txt", "β\nη\r\n")
    assert (tmp_path / "traits.txt").read_bytes() == b"\xce\xb2\n\xce\xb7\r\n"


def test_json_comes_back_as_it_was(tmp_path: Path) -> None:
    path, known = tmp_path / "table.json", {"mean": -80.25, "name": "β", "low": None}
    write_json(path, known)
    text = path.read_text("utf-8")
    assert json.loads(text) == known
    assert text.endswith("}\n")


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_json_refuses_what_is_no_json_and_leaves_the_old_file(tmp_path: Path, value: float) -> None:
    path = tmp_path / "table.json"
    path.write_text("{}")
    with pytest.raises(ValueError, match="not JSON compliant"):
        write_json(path, {"mean": value})
    assert path.read_text() == "{}"
    assert content(tmp_path) == ["table.json"]


def test_checksums_are_sha_256(tmp_path: Path) -> None:
    # FIPS 180-2, the example of one block
    expected = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    (tmp_path / "abc").write_bytes(b"abc")
    assert sha256(b"abc") == sha256_of(tmp_path / "abc") == expected
    large = bytes(range(256)) * 10_000  # more than is read at once
    (tmp_path / "large").write_bytes(large)
    assert sha256_of(tmp_path / "large") == hashlib.sha256(large).hexdigest()


def test_a_folder_is_made_and_left_empty(tmp_path: Path) -> None:
    for _ in range(2):  # there already the second time
        make_folder(tmp_path / "runs" / "table")
        assert content(tmp_path / "runs" / "table") == []


def test_a_folder_that_cannot_be_made_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(OSError, match=r"cannot write to .*file"):
        make_folder(tmp_path / "file")
    with pytest.raises(OSError, match=r"cannot write to .*below: Not a directory"):
        make_folder(tmp_path / "file" / "below")


def test_arrays_become_lists_and_unknown_numbers_none() -> None:
    values = {"a": np.array([1.0, np.nan]), "b": math.inf, "c": np.float64("nan"), "d": (1, 2.5)}
    assert json_value(values) == {"a": [1.0, None], "b": None, "c": None, "d": [1, 2.5]}
