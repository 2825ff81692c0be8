import errno
import multiprocessing
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from hmi_marl import locks, ownership
from hmi_marl.ownership import OWNER, FolderInUseError, check_free, owned

HOLD = """
import sys
from pathlib import Path
from hmi_marl.ownership import owned
with owned(Path(sys.argv[1])):
    print("owned", flush=True)
    sys.stdin.read()
"""


@pytest.fixture
def other(tmp_path):
    """A process that owns the folder."""
    command = [sys.executable, "-c", HOLD, str(tmp_path)]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen(command, **pipes) as process:
        assert process.stdout.readline().strip() == b"owned"
        yield process
        process.kill()


def test_a_folder_is_owned_once_and_left_as_it_was(tmp_path):
    folder = tmp_path / "new" / "run"
    with owned(folder):
        about = (folder / OWNER).read_text()
        assert about.startswith(f"process {os.getpid()} on ")
        with owned(folder), owned(folder.parent), owned(folder / "below"):
            pass
        assert (folder / OWNER).read_text() == about
    assert list(folder.iterdir()) == [folder / "below"]
    assert list((folder / "below").iterdir()) == []


def test_the_second_owner_is_told_who_the_first_is_and_what_to_do(tmp_path, other):
    told = rf"{tmp_path} is in use by process {other.pid} on .*; wait until it has ended, or choose"
    with pytest.raises(FolderInUseError, match=told), owned(tmp_path):
        raise AssertionError
    with pytest.raises(FolderInUseError, match=told):
        check_free(tmp_path)
    with owned(tmp_path.parent):
        check_free(tmp_path.parent)
    other.stdin.close()  # it goes on to its end
    assert other.wait() == 0
    check_free(tmp_path)
    with owned(tmp_path):
        pass


@pytest.mark.skipif(sys.platform == "win32", reason="kills as POSIX does")
def test_it_is_free_when_its_owner_is_killed(tmp_path, other):
    os.kill(other.pid, signal.SIGKILL)
    other.wait()
    assert (tmp_path / OWNER).is_file()
    check_free(tmp_path)
    with owned(tmp_path):
        assert (tmp_path / OWNER).read_text().startswith(f"process {os.getpid()} ")
    assert list(tmp_path.iterdir()) == []


def test_another_thread_is_another_owner(tmp_path):
    errors = []

    def try_it():
        try:
            with owned(tmp_path):
                pass
        except FolderInUseError as error:
            errors.append(str(error))

    with owned(tmp_path):
        thread = threading.Thread(target=try_it)
        thread.start()
        thread.join()
    assert len(errors) == 1
    assert f"is in use by another thread of process {os.getpid()}" in errors[0]


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
@pytest.mark.filterwarnings("ignore:This process .* is multi-threaded:DeprecationWarning")
def test_a_forked_child_does_not_keep_the_folder(tmp_path):
    context = multiprocessing.get_context("fork")
    go_on = context.Event()
    with owned(tmp_path):
        child = context.Process(target=go_on.wait, args=(60,))
        child.start()
    with owned(tmp_path):  # the child lives, and would still hold an inherited lock
        assert child.is_alive()
        go_on.set()
        child.join()


def own_in_a_worker(folder: Path, depth: int) -> None:
    with owned(folder):
        (folder / f"{depth}").touch()
    check_free(folder)
    if depth:
        own_in_a_child(folder, depth - 1)


def own_in_a_child(folder: Path, depth: int) -> int | None:
    child = multiprocessing.get_context("spawn").Process(
        target=own_in_a_worker, args=(folder, depth)
    )
    child.start()
    child.join()
    return child.exitcode


def test_workers_write_into_the_folder_that_the_process_before_them_owns(tmp_path):
    with owned(tmp_path):
        assert own_in_a_child(tmp_path, 1) == 0
        assert (tmp_path / OWNER).is_file()
    assert {"0", "1"} == {path.name for path in tmp_path.iterdir()}


def test_a_file_removed_by_its_last_owner_is_not_locked(tmp_path, monkeypatch):
    still_there, answers = ownership._is_still_there, [False]

    def removed_once(path: Path, file: int) -> bool:
        if answers and not answers.pop():
            path.unlink()
        return still_there(path, file)

    monkeypatch.setattr(ownership, "_is_still_there", removed_once)
    with owned(tmp_path):
        assert (tmp_path / OWNER).is_file()


@pytest.mark.skipif(sys.platform == "win32", reason="replaces the locks of POSIX")
def test_a_file_system_without_locks_is_told_in_one_line(tmp_path, monkeypatch, capsys):
    def refuse(file: int, how: int) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(locks.fcntl, "flock", refuse)
    with owned(tmp_path), owned(tmp_path):
        pass
    told = capsys.readouterr().err
    assert told.startswith(f"hmi-marl: cannot lock {tmp_path} (No locks available); let no other")
    assert told.count("\n") == 1


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="root writes anywhere")
def test_a_folder_that_cannot_be_written_to_is_refused(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(OSError, match="cannot write to"), owned(tmp_path):
        pass
    with pytest.raises(OSError, match="cannot write to"):
        check_free(tmp_path / "below")


def test_a_file_in_the_way_is_refused_early(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(OSError, match=r"cannot write to .*file is not a folder"):
        check_free(tmp_path / "file" / "run")
    check_free(tmp_path / "new" / "run")
    assert not (tmp_path / "new").exists()


def test_folders_made_for_a_block_that_fails_are_removed(tmp_path):
    with pytest.raises(ValueError, match="no"), owned(tmp_path / "a" / "b"):
        raise ValueError("no")
    assert list(tmp_path.iterdir()) == []
    kept = tmp_path / "a" / "b" / "kept"
    with pytest.raises(FileExistsError), owned(kept.parent):
        kept.mkdir() or kept.mkdir()
    assert [path.name for path in (tmp_path / "a" / "b").iterdir()] == ["kept"]
