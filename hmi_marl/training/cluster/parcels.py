"""Files of a run on their way between machines that share no folder."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path, PurePosixPath

from hmi_marl.files import write_bytes
from hmi_marl.training.runs.folder import CHECKPOINT

Files = Mapping[str, bytes]
"""Contents by path within a folder, parts separated by slashes."""


def state_in(folder: Path) -> Files:
    """Read what a run goes on from: the files of its folder, without those of folders in it."""
    if not folder.is_dir():
        return {}
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir()) if _travels(path)}


def read_by_others(path: Path) -> Files:
    """Read what others need of a folder that something was learned or recorded in, or of a policy.

    Args:
        path: a folder, or one file, with which all files of the same stem go, such as weights.

    Returns:
        Files by path within the folder that ``path`` is in.
    """
    if path.is_dir():
        state = state_in(path).items()
        return {f"{path.name}/{name}": content for name, content in state if name != CHECKPOINT}
    return {
        each.name: each.read_bytes()
        for each in sorted(path.parent.glob(f"{path.stem}.*"))
        if _travels(each)
    }


def put(folder: Path, files: Files) -> None:
    """Write files into a folder, the checkpoint last: a run goes on from it and from the others.

    Raises:
        ValueError: a path that leads out of the folder.
    """
    for name in sorted(files, key=lambda name: (name == CHECKPOINT, name)):
        parts = PurePosixPath(name).parts
        if not parts or name.startswith("/") or ".." in parts or "\\" in name:
            raise ValueError(f"{name!r} is no path within the folder of a run")
        write_bytes(folder.joinpath(*parts), files[name])


class Changes:
    """Files of a folder that have changed since they were taken last.

    Args:
        known: files that the receiver has, as they are there now.
    """

    def __init__(self, folder: Path, known: Files) -> None:
        self._folder = folder
        self._seen = {name: _stamp(folder / name) for name in known}

    def take(self) -> Files:
        """Return the files that are new or have changed, in folders within as well."""
        changed = {}
        for path in sorted(self._folder.rglob("*")):
            name = path.relative_to(self._folder).as_posix()
            if _travels(path) and self._seen.get(name) != (stamp := _stamp(path)):
                self._seen[name], changed[name] = stamp, path.read_bytes()
        return changed


def _travels(path: Path) -> bool:
    """Whether a file is part of what a run left: no lock, and nothing half written."""
    return path.is_file() and not path.name.startswith(".")


def _stamp(path: Path) -> tuple[int, int, int]:
    about = path.stat()
    return about.st_ino, about.st_size, about.st_mtime_ns
