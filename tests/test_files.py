import errno
import hashlib
import json
import math
import os
import stat
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from hmi_marl import files
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


@pytest.mark.parametrize(("umask", "mode"), [(0o022, 0o644), (0o027, 0o640), (0o077, 0o600)])
def test_a_new_file_gets_the_mode_that_the_umask_leaves(
    tmp_path: Path, umask: int, mode: int
) -> None:
    before = os.umask(umask)
    try:
        write_bytes(tmp_path / "page.html", b"<p>")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "page.html").stat().st_mode) == mode


@pytest.mark.parametrize("mode", [0o600, 0o664, 0o755])
def test_an_existing_file_keeps_its_mode(tmp_path: Path, mode: int) -> None:
    path, seen = tmp_path / "page.html", []
    path.touch()
    path.chmod(mode)

    def write(temporary: Path) -> None:
        temporary.write_text("new")
        seen.append(stat.S_IMODE(temporary.stat().st_mode))

    write_atomically(path, write)
    assert path.read_text() == "new"
    assert stat.S_IMODE(path.stat().st_mode) == mode
    assert seen[0] & ~(mode | 0o200) == 0  # nobody else may read it in between either


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write to everything")
def test_a_write_protected_file_is_not_replaced(tmp_path: Path) -> None:
    path = tmp_path / "kept.json"
    path.write_text("old")
    path.chmod(0o444)
    with pytest.raises(PermissionError, match=r"kept\.json"):
        write_text(path, "new")
    assert path.read_text() == "old"


def test_a_link_stays_and_what_it_names_is_written(tmp_path: Path) -> None:
    (tmp_path / "disk").mkdir()
    (tmp_path / "runs").mkdir()
    target = tmp_path / "disk" / "table.txt"
    for name, link in (("near", target), ("far", Path("../disk/table.txt")), ("hop", Path("far"))):
        path = tmp_path / "runs" / name
        path.symlink_to(link)
        write_text(path, name)  # the first time there is no target yet
        assert path.is_symlink()
        assert path.readlink() == link
        assert target.read_text() == name
    assert content(tmp_path / "runs") == ["far", "hop", "near"]
    assert content(tmp_path / "disk") == ["table.txt"]


def test_links_that_lead_nowhere_are_errors(tmp_path: Path) -> None:
    (tmp_path / "one").symlink_to("other")
    (tmp_path / "other").symlink_to("one")
    (tmp_path / "gone").symlink_to(tmp_path / "nowhere" / "file")
    (tmp_path / "folder").symlink_to(tmp_path)
    for name in ("one", "gone", "folder"):
        with pytest.raises(OSError, match=f"'{tmp_path}"):
            write_text(tmp_path / name, "x")
        assert (tmp_path / name).is_symlink()


def test_a_file_is_on_the_disk_before_it_has_its_name_and_its_name_after(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    steps: list[str] = []
    sync, replace = os.fsync, Path.replace

    def kept(handle: int) -> None:
        folder = stat.S_ISDIR(os.fstat(handle).st_mode)
        steps.append("folder" if folder else f"file of {os.fstat(handle).st_size}")
        sync(handle)

    def moved(self: Path, target: Path) -> Path:
        steps.append("name")
        return replace(self, target)

    monkeypatch.setattr(os, "fsync", kept)
    monkeypatch.setattr(Path, "replace", moved)
    write_bytes(tmp_path / "weights", b"12345")
    assert steps == ["file of 5", "name", "folder"]


WRITER = """
import os, sys, time
from pathlib import Path
from hmi_marl.files import write_atomically

def write(temporary):
    temporary.write_text("half of")
    print(temporary.name, flush=True)
    time.sleep(600)

write_atomically(Path(sys.argv[1]), write)
"""


def test_what_a_dead_process_left_behind_is_removed_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "table.txt"
    others = {".table.txt", ".table-0123456789ab.txt", ".other-0123456789ab.part.txt"}
    for name in others:
        (tmp_path / name).touch()
    with subprocess.Popen(
        [sys.executable, "-c", WRITER, str(path)], stdout=subprocess.PIPE, text=True
    ) as writer:
        try:
            assert writer.stdout is not None
            half = writer.stdout.readline().strip()
            write_text(path, "mine")  # while the other one is alive
            assert set(content(tmp_path)) == {half, "table.txt", *others}
        finally:
            writer.kill()
    assert (tmp_path / half).read_text() == "half of"
    write_text(path, "mine again")
    assert set(content(tmp_path)) == {"table.txt", *others}


def test_a_writer_within_another_of_the_same_file_loses_nothing(tmp_path: Path) -> None:
    path = tmp_path / "table.txt"

    def write(temporary: Path) -> None:
        write_text(path, "inner")
        temporary.write_text("outer")

    write_atomically(path, write)
    assert path.read_text() == "outer"
    assert content(tmp_path) == ["table.txt"]


def test_without_locks_only_old_files_are_taken_as_left_over(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(files, "_lock", lambda handle, wait: None)
    new, old = (tmp_path / f".table-{digit * 12}.part.txt" for digit in "ab")
    for path in (new, old):
        path.touch()
    os.utime(old, (0, 0))
    write_text(tmp_path / "table.txt", "x")
    assert content(tmp_path) == [new.name, "table.txt"]


@contextmanager
def small_disk(size: int) -> Iterator[None]:
    """The kernel refuses to let a file grow beyond this, as it does on a full disk."""
    resource = pytest.importorskip("resource")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_full_disk_names_the_file_that_was_to_be_written(tmp_path: Path) -> None:
    path = tmp_path / "table.txt"
    path.write_text("old")
    with small_disk(1000), pytest.raises(OSError, match=rf"'{path}'$") as raised:
        write_text(path, "x" * 2000)
    assert raised.value.errno == errno.EFBIG
    assert path.read_text() == "old"
    assert content(tmp_path) == ["table.txt"]


def test_errors_about_other_files_keep_their_names(tmp_path: Path) -> None:
    def write(temporary: Path) -> None:
        (tmp_path / "input").read_text()

    with pytest.raises(FileNotFoundError, match="/input'"):
        write_atomically(tmp_path / "table.txt", write)

    def refuse(temporary: Path) -> None:
        raise OSError("out of ink")

    with pytest.raises(OSError, match="out of ink"):
        write_atomically(tmp_path / "table.txt", refuse)


def test_names_as_long_as_they_may_be_can_be_written(tmp_path: Path) -> None:
    for name in ("x" * 255, "ä" * 125 + ".txt"):
        write_text(tmp_path / name, "x")
    assert len(content(tmp_path)) == 2


def test_bytes_are_written_as_they_are(tmp_path: Path) -> None:
    everything = bytes(range(256))
    write_bytes(tmp_path / "raw", everything)
    assert (tmp_path / "raw").read_bytes() == everything


def test_text_is_utf_8_with_its_own_line_ends(tmp_path: Path) -> None:
    write_text(tmp_path / "traits.txt", "β\nη\r\n")
    assert (tmp_path / "traits.txt").read_bytes() == b"\xce\xb2\n\xce\xb7\r\n"
    write_text(tmp_path / "traits.txt", os.fsdecode(b"runs/\xff"))  # a file name that is no text
    assert (tmp_path / "traits.txt").read_bytes() == rb"runs/\udcff"


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
