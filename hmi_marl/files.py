"""Atomic writing of files, SHA-256 checksums, and values as JSON has them.

A file that is written appears under its name whole or not at all, also after a power cut: its bytes
are on the disk before it takes its name. As with ``open(path, "w")`` a new file gets the mode that
the umask leaves, an existing one keeps its own, and a symbolic link stays a link to what it names.
"""

from __future__ import annotations

import errno
import hashlib
import json
import math
import os
import re
import secrets
import stat
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hmi_marl.locks import lock
from hmi_marl.reading import opened

_PART = ".part"
"""Mark of temporary files, before the suffix."""
_OLD = 24 * 3600.0
"""Age at which a temporary file is left over where files cannot be locked [s]."""


def make_folder(folder: Path) -> None:
    """Make ``folder`` if there is none, and check that files can be written there.

    Raises:
        OSError: they cannot.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        raise OSError(f"cannot write to {folder}: {error.strerror}") from error


def write_atomically(path: Path, write: Callable[[Path], object]) -> None:
    """Let ``write`` make a temporary file in the folder of ``path``, then move it there.

    The temporary name keeps the suffix, by which image libraries choose their format. Temporary
    files that dead processes left behind for the same path are removed.

    Raises:
        OSError: the file cannot be written, for example since the disk is full; it names ``path``.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError) as error:
        reason = f"{error.filename} is not a folder"
        raise NotADirectoryError(errno.ENOTDIR, reason, str(path)) from error
    target = Path(os.path.realpath(path))
    mode = _mode_of(target)
    _remove_left_over(target)
    try:
        with _temporary(target, 0o666 if mode is None else mode | 0o200) as temporary:
            write(temporary)
            if mode is not None:
                temporary.chmod(mode)
            _keep(temporary)
            temporary.replace(target)
        _keep(target.parent)
    except OSError as error:
        about_another = error.filename is not None and _PART not in str(error.filename)
        if error.errno is None or about_another:
            raise
        raise OSError(error.errno, os.strerror(error.errno), str(path)) from error


def _mode_of(target: Path) -> int | None:
    """Mode of the file that is to be replaced; None if there is none."""
    try:
        found = target.lstat()
    except FileNotFoundError:
        return None
    if stat.S_ISLNK(found.st_mode):  # what is left when links lead back to themselves
        raise OSError(errno.ELOOP, os.strerror(errno.ELOOP), str(target))
    if stat.S_ISDIR(found.st_mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(target))
    if not stat.S_ISREG(found.st_mode):
        raise OSError(
            errno.EINVAL, "cannot replace a pipe, a device or a socket by a file", str(target)
        )
    if not os.access(target, os.W_OK):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(target))
    return stat.S_IMODE(found.st_mode)


def _named(target: Path, token: str) -> str:
    return f".{target.stem[:60]}-{token}{_PART}{target.suffix}"


@contextmanager
def _temporary(target: Path, mode: int) -> Iterator[Path]:
    """Make an empty file next to ``target``, locked as long as this process works on it."""
    while True:
        path = target.with_name(_named(target, secrets.token_hex(6)))
        handle = os.open(path, os.O_CREAT | os.O_EXCL | os.O_RDWR, mode)
        _lock(handle, wait=True)
        with suppress(FileNotFoundError):
            if os.path.samestat(path.stat(), os.fstat(handle)):
                break  # else it was taken for a left-over one before it was locked
        os.close(handle)
    if sys.platform == "win32":  # where open files can be neither replaced nor removed
        os.close(handle)
    try:
        yield path
    finally:
        path.unlink(missing_ok=True)
        if sys.platform != "win32":
            os.close(handle)


def _remove_left_over(target: Path) -> None:
    """Remove the temporary files of ``target`` that no living process has locked.

    A lock ends with its process, however that ends. Where files cannot be locked, those are removed
    that are older than a day.
    """
    before, after = (re.escape(part) for part in _named(target, "\n").split("\n"))
    ours = re.compile(f"{before}[0-9a-f]{{12}}{after}")
    for name in os.listdir(target.parent):
        if not ours.fullmatch(name):
            continue
        path = target.with_name(name)
        with suppress(OSError):  # removed meanwhile, or another user's
            handle = os.open(path, os.O_RDWR)
            try:
                free = _lock(handle, wait=False)
                if free or (free is None and time.time() - path.stat().st_mtime > _OLD):
                    path.unlink()
            finally:
                os.close(handle)


def _lock(handle: int, wait: bool) -> bool | None:
    """Lock an open file, and return whether that was possible; None if there are no locks.

    On Windows there are none of files that are to be replaced.
    """
    if sys.platform == "win32":
        return None
    try:
        return lock(handle, wait)
    except OSError:
        return None


def _keep(path: Path) -> None:
    """Have a file, or the names in a folder, written to the disk."""
    folder = path.is_dir()
    if folder and sys.platform == "win32":  # where folders cannot be opened
        return
    handle = os.open(path, os.O_RDONLY if folder else os.O_RDWR)
    try:
        os.fsync(handle)
    except OSError as error:
        if not folder or error.errno not in (errno.EINVAL, errno.ENOTSUP):
            raise  # some file systems keep no names on demand
    finally:
        os.close(handle)


def write_bytes(path: Path, content: bytes) -> None:
    """Write ``content``, atomically."""
    write_atomically(path, lambda temporary: temporary.write_bytes(content))


def write_text(path: Path, text: str) -> None:
    """Write ``text`` as UTF-8, atomically; bytes of file names that are not UTF-8 as escapes."""
    write_bytes(path, text.encode("utf-8", "backslashreplace"))


def write_json(path: Path, content: Any) -> None:
    """Write ``content`` as indented JSON, atomically."""
    write_text(path, json.dumps(content, indent=2, allow_nan=False) + "\n")


def sha256(content: bytes) -> str:
    """SHA-256 checksum of ``content`` in hexadecimal digits."""
    return hashlib.sha256(content).hexdigest()


def sha256_of(path: Path) -> str:
    """SHA-256 checksum of a regular file in hexadecimal digits.

    Raises:
        OSError, ValueError: see :func:`hmi_marl.reading.opened`.
    """
    with opened(path) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


_CHECKSUM = "sha256"
"""Name under which JSON content keeps its own checksum."""


def with_checksum(content: Mapping[str, Any]) -> dict[str, Any]:
    """Return JSON content with a checksum over all of it; see :func:`without_checksum`."""
    return {**content, _CHECKSUM: json_digest(content)}


def without_checksum(content: Any) -> dict[str, Any]:
    """Return JSON content that :func:`with_checksum` returned as it was before.

    Raises:
        ValueError: anything in it has changed, or it is something else.
    """
    if not isinstance(content, dict) or _CHECKSUM not in content:
        raise ValueError("it has no checksum")
    before = {name: value for name, value in content.items() if name != _CHECKSUM}
    if content[_CHECKSUM] != json_digest(before):
        raise ValueError("its checksum differs")
    return before


def json_digest(content: Mapping[str, Any]) -> str:
    """Return the SHA-256 of JSON content, whatever the order of its names and the spaces in it."""
    as_read = json.loads(json.dumps(content))  # keys are texts, which can be sorted
    return sha256(json.dumps(as_read, sort_keys=True).encode())


def json_value(value: Any) -> Any:
    """Convert ``value`` to JSON content.

    A dataclass becomes a dict, an array a list, a number that is not finite None, and anything
    that JSON does not know its repr.
    """
    if is_dataclass(value) and not isinstance(value, type):
        return {field.name: json_value(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, Mapping):
        return {str(key): json_value(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [json_value(item) for item in value]
    if isinstance(value, (np.generic, np.ndarray)):
        return json_value(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value if value is None or isinstance(value, (bool, int, float, str)) else repr(value)
