"""Folders whose files belong together: ``INDEX.json`` holds the SHA-256 of each, and one of itself.

Such a folder is replaced at once (:func:`replaced`), so that its files are never of two makings.
"""

from __future__ import annotations

import re
import shutil
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path, PurePosixPath
from typing import Any

from hmi_marl.checks import shown
from hmi_marl.files import sha256_of, with_checksum, without_checksum, write_json
from hmi_marl.reading import read_json

INDEX = "INDEX.json"


def write_index(folder: Path, form: str, content: Mapping[str, Any]) -> None:
    """Write the index of a folder, of the format ``form``."""
    write_json(folder / INDEX, with_checksum({"format": form, **content}))


def read_index(folder: Path, form: str, what: str, remedy: str) -> dict[str, Any]:
    """Read the index of a folder.

    Args:
        folder, form: the folder, and the format that its index has to have.
        what: name of what is indexed, for error messages.
        remedy: end of the messages, which says what to do.

    Raises:
        FileNotFoundError: there is none.
        ValueError: it has another format, or is damaged.
    """
    path = folder / INDEX
    try:
        content = read_json(path)
    except ValueError as error:
        raise ValueError(f"{path} is damaged ({error}); {remedy}") from None
    found = content.get("format") if isinstance(content, dict) else None
    if found != form:
        raise ValueError(f"{path} is no index of {what}: format {shown(found)}; {remedy}")
    try:
        return without_checksum(content)
    except ValueError as error:
        raise ValueError(f"{path} is damaged ({error}); {remedy}") from None


def digests(paths: Iterable[Path], folder: Path) -> dict[str, str]:
    """Return the SHA-256 of files by their paths in a folder."""
    return {path.relative_to(folder).as_posix(): sha256_of(path) for path in paths}


def check_digests(files: Mapping[str, str]) -> None:
    """Check that an index names files below its folder, each with a checksum.

    Raises:
        ValueError: a path leads elsewhere, or a checksum is none.
    """
    for path, digest in files.items():
        parts = PurePosixPath(path).parts
        if not parts or {"..", "/"} & set(parts) or "\\" in path or ":" in path:
            raise ValueError(f"{shown(path)} is no file in the folder of its index")
        if not re.fullmatch("[0-9a-f]{64}", digest):
            raise ValueError(f"{shown(digest)} is no SHA-256 checksum")


def check_files(folder: Path, files: Mapping[str, str], origin: str, remedy: str) -> None:
    """Check that files are as their index says.

    Args:
        folder, files: the folder, and the checksums in its index.
        origin: relative clause for error messages: "that came with the package".
        remedy: end of the messages, which says what to do.

    Raises:
        FileNotFoundError: one is missing.
        ValueError: one has changed.
    """
    for path, digest in files.items():
        try:
            found = sha256_of(folder / path)
        except FileNotFoundError:
            raise FileNotFoundError(f"{folder / path} is missing; {remedy}") from None
        if found != digest:
            raise ValueError(
                f"{folder / path} is not the file {origin} (its checksum differs from that in "
                f"{INDEX}); {remedy}"
            )


@contextmanager
def replaced(*folders: Path) -> Iterator[list[Path]]:
    """Yield empty folders, which take the place of ``folders`` when the block ends: all, or none.

    What is there stays until then, and also if the block or the replacement fails.
    """
    with ExitStack() as stack:
        made = []
        for folder in folders:
            put_back(folder)
            folder.parent.mkdir(parents=True, exist_ok=True)
            near = tempfile.TemporaryDirectory(prefix=f".{folder.name}-", dir=folder.parent)
            made.append(Path(stack.enter_context(near)) / folder.name)
            made[-1].mkdir()
        yield made
        _put(folders, made)


def put_back(folder: Path) -> None:
    """Put a folder back whose replacement was cut off by the end of its process."""
    if not folder.exists() and _aside(folder).is_dir():
        _aside(folder).replace(folder)


def _put(folders: Sequence[Path], made: Sequence[Path]) -> None:
    there = [folder for folder in folders if folder.exists()]
    for folder in there:
        if _aside(folder).exists():  # left over by a process that was killed
            shutil.rmtree(_aside(folder))
    try:
        for folder, new in zip(folders, made, strict=True):
            if folder in there:
                folder.replace(_aside(folder))
            new.replace(folder)
    except BaseException:
        for folder in folders:
            if _aside(folder).exists():
                shutil.rmtree(folder, ignore_errors=True)
                _aside(folder).replace(folder)
            elif folder not in there:
                shutil.rmtree(folder, ignore_errors=True)
        raise
    for folder in there:
        shutil.rmtree(_aside(folder), ignore_errors=True)


def _aside(folder: Path) -> Path:
    """Where what a folder held lies during its replacement."""
    return folder.with_name(f".{folder.name}-before")
