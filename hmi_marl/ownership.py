"""Ownership of folders: only one command at a time writes into a folder.

The owner holds a lock of the operating system on the file ``.owner`` in the folder. The lock ends
with its process, however that ends. The file says which process it is, and is removed when the
owner is done; one that a kill left behind is free for the next owner.
"""

from __future__ import annotations

import json
import os
import platform
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from multiprocessing import parent_process
from pathlib import Path

from hmi_marl.files import make_folder
from hmi_marl.locks import lock

OWNER = ".owner"
"""File in a folder that its owner locks."""
_FOLDERS = "HMI_MARL_OWNED_FOLDERS"
"""Environment variable that tells worker processes which folders those before them own."""
_held: dict[Path, tuple[int, int | None]] = {}
"""Owned folders: the thread that owns each, and its open file; None where there are no locks."""


class FolderInUseError(OSError):
    """Another process, or another thread of this one, writes into a folder."""


@contextmanager
def owned(folder: Path) -> Iterator[None]:
    """Own ``folder`` for a block, and make it if there is none.

    Within the block the same thread may own it again, as when an experiment writes into the folder
    that its command owns, and so may its worker processes, which end with it. Folders that were
    made for a block that fails, and are empty then, are removed. Where the file system knows no
    locks, a line on stderr says so.

    Raises:
        FolderInUseError: it has another owner, which the message names.
        OSError: it cannot be written to.
    """
    missing = [each for each in (folder, *folder.parents) if not each.exists()]
    try:
        make_folder(folder)
        place, thread = folder.resolve(), threading.get_ident()
        if place not in _held and _is_an_ancestors(place):
            yield
        elif place not in _held:
            with _holding(folder, place, thread):
                yield
        elif _held[place][0] == thread:
            yield
        else:
            raise _in_use(folder, f"another thread of process {os.getpid()}")
    except BaseException:
        with suppress(OSError):  # those that are not empty stay
            for each in missing:
                each.rmdir()
        raise


@contextmanager
def _holding(folder: Path, place: Path, thread: int) -> Iterator[None]:
    _held[place] = thread, _lock(folder)
    os.environ[_FOLDERS] = json.dumps([*_of_processes_before(), str(place)])
    try:
        yield
    finally:
        left = [each for each in _of_processes_before() if each != str(place)]
        if left:
            os.environ[_FOLDERS] = json.dumps(left)
        else:
            os.environ.pop(_FOLDERS, None)
        _, file = _held.pop(place)
        if file is not None:
            _unlock(folder / OWNER, file)


def _is_an_ancestors(place: Path) -> bool:
    """Whether this is a worker of a process that owns a folder."""
    return parent_process() is not None and str(place) in _of_processes_before()


def _of_processes_before() -> list[str]:
    folders: list[str] = json.loads(os.environ.get(_FOLDERS, "[]"))
    return folders


def check_free(folder: Path) -> None:
    """Check that no other process owns ``folder`` now, and that it could be written to.

    This refuses early, and makes and writes nothing. Only :func:`owned` keeps others away.

    Raises:
        FolderInUseError: it has an owner, which the message names.
        OSError: it cannot be written to.
    """
    there = next(each for each in (folder, *folder.absolute().parents) if each.exists())
    if not there.is_dir() or not os.access(there, os.W_OK | os.X_OK):
        reason = "no permission" if there.is_dir() else f"{there} is not a folder"
        raise OSError(f"cannot write to {folder}: {reason}")
    try:
        file = os.open(folder / OWNER, os.O_RDWR)
    except OSError:
        return  # there is no owner, or what is wrong will be said when the folder is owned
    try:
        place = folder.resolve()
        if place not in _held and not _is_an_ancestors(place) and not lock(file):
            raise _in_use(folder, _read(file))
    finally:
        os.close(file)


def _lock(folder: Path) -> int | None:
    """Lock a folder; return its open file, or None if its file system knows no locks."""
    path = folder / OWNER
    while True:
        file = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
        try:
            if not lock(file):
                raise _in_use(folder, _read(file))
        except FolderInUseError:
            os.close(file)
            raise
        except OSError as error:
            os.close(file)
            print(
                f"hmi-marl: cannot lock {folder} ({error.strerror}); let no other command write "
                "there at the same time",
                file=sys.stderr,
            )
            return None
        if _is_still_there(path, file):
            break
        os.close(file)  # its last owner removed it after it was opened here
    about = f"process {os.getpid()} on {platform.node()} since {time.strftime('%Y-%m-%d %H:%M:%S')}"
    os.ftruncate(file, 0)
    os.write(file, about.encode())
    return file


def _unlock(path: Path, file: int) -> None:
    """End the lock, and remove its file while no other process can have locked it."""
    with suppress(OSError):  # it stays, which does no harm; Windows removes no open file
        if _is_still_there(path, file):
            path.unlink()
    os.close(file)
    if sys.platform == "win32":
        with suppress(OSError):
            path.unlink()


def _is_still_there(path: Path, file: int) -> bool:
    try:
        return os.path.samestat(path.stat(), os.fstat(file))
    except FileNotFoundError:
        return False


def _read(file: int) -> str:
    os.lseek(file, 0, os.SEEK_SET)
    return os.read(file, 200).decode("utf-8", "replace").strip() or "another process"


def _in_use(folder: Path, owner: str) -> FolderInUseError:
    return FolderInUseError(
        f"{folder} is in use by {owner}; wait until it has ended, or choose another --out"
    )


def _forget() -> None:
    """Close the locks that a forked child got from its parent, whose they stay."""
    for _, file in _held.values():
        if file is not None:
            os.close(file)
    _held.clear()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget)
