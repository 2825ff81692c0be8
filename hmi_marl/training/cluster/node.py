"""A task on a node of a cluster: it learns in a temporary folder and sends its files back.

The worker that Ray starts keeps itself small: what is learned runs in a process of its own, as it
does without Ray, with the same number of threads and the same randomness. Its messages are pairs of
a name and arguments: ``begin``, ``phase``, ``advance`` and ``saved``, see :mod:`reports
<hmi_marl.training.runs.reports>`, and at last ``ended``, ``failed`` or ``lost``.
"""

from __future__ import annotations

import pickle
import shutil
import signal
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib.metadata import PackageNotFoundError, version
from multiprocessing import get_context
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from hmi_marl.training.cluster.parcels import Changes, Files, put
from hmi_marl.training.run_tasks import RunTask
from hmi_marl.training.runs.reports import heard_by
from hmi_marl.workers import begin_worker, environment, threads_each

Message = tuple[str, tuple[Any, ...]]
PACKAGES = ("hmi-marl", "numba", "numpy", "rsl-rl-lib", "torch")
"""Packages whose versions must be the same on all nodes for results to be."""
PATIENCE = 1.0
"""Longest wait for messages [s], after which a worker can be stopped."""
_NO_GPU = {"CUDA_VISIBLE_DEVICES": ""}
_QUIET_THREADS = {"OMP_WAIT_POLICY": "PASSIVE"}


def versions() -> dict[str, str]:
    """Versions of :data:`PACKAGES` on this machine, without that of the build such as ``+cpu``."""
    found = {}
    for package in PACKAGES:
        try:
            found[package] = version(package).partition("+")[0]
        except PackageNotFoundError:
            found[package] = "none"
    return found


def difference(there: Mapping[str, str], here: Mapping[str, str]) -> str | None:
    """Name the first package whose version there is another than here; None if all are the same."""
    odd = [name for name in here if there.get(name, "none") != here[name]]
    return None if not odd else f"{odd[0]} {there.get(odd[0], 'none')}, not {here[odd[0]]} as here"


class Worker:
    """A task on this node. Ray makes an actor of it.

    Args:
        task: its paths are those of the machine that sent it.
        state: files of the run's folder there.
        needed: versions of :data:`PACKAGES` there.
        reads: files of each of the folders or policies that the task reads.
    """

    def __init__(
        self, task: RunTask, state: Files, needed: Mapping[str, str], *reads: Files
    ) -> None:
        self._task, self._state, self._needed, self._reads = task, state, needed, reads
        self._place: Path | None = None
        self._process: BaseProcess | None = None
        self._reader: Connection | None = None

    def news(self) -> list[Message]:
        """Return the messages since the last call, waiting up to ``PATIENCE`` for the first."""
        if self._reader is None:
            odd = difference(versions(), self._needed)
            if odd is not None:
                return [("failed", (ValueError(f"a node has {odd}; install the same there"),))]
            self._reader = self._begin()
        found: list[Message] = []
        while self._reader.poll(0 if found else PATIENCE):
            try:
                found.append(self._reader.recv())
            except (EOFError, OSError):
                found.append(("lost", (self._how_it_ended(),)))
            if found[-1][0] in ("ended", "failed", "lost"):
                self.stop()
                break
            if found[-1][0] == "saved":
                break  # at once, since it may be needed elsewhere
        return found

    def stop(self) -> None:
        """End the process and remove its folder."""
        if self._process is not None:
            self._process.kill()
            self._process.join()
        if self._place is not None:
            shutil.rmtree(self._place, ignore_errors=True)

    def _begin(self) -> Connection:
        task = self._task
        self._place = Path(tempfile.mkdtemp(prefix="hmi-marl-"))
        folder = self._place / "run" / task.folder.absolute().name
        put(folder, self._state)
        reads = []
        for number, (path, files) in enumerate(zip(task.reads, self._reads, strict=True)):
            put(self._place / f"read-{number}", files)
            reads.append(self._place / f"read-{number}" / path.name)
        task = replace(task, folder=folder, reads=tuple(reads))
        context = get_context("spawn")
        reader, writer = context.Pipe(duplex=False)
        gpus = {} if task.gpu else _NO_GPU
        with environment(threads_each(1) | _QUIET_THREADS | gpus):
            arguments = (task, tuple(self._state), writer)
            self._process = context.Process(target=_work, args=arguments, daemon=False)
            self._process.start()
        writer.close()
        self._state = {}  # it is on the disk now
        return reader

    def _how_it_ended(self) -> str:
        assert self._process is not None
        self._process.join()
        status = self._process.exitcode or 0
        return signal.Signals(-status).name if status < 0 else f"status {status}"


class _Outbox:
    """Sends what it hears of a run to the worker that started this process."""

    def __init__(self, writer: Connection, folder: Path, known: Sequence[str]) -> None:
        self._writer = writer
        self._changes = Changes(folder, dict.fromkeys(known, b""))

    def begin(self, name: str, total: int, done: int, unit: str) -> None:
        self._writer.send(("begin", (name, total, done, unit)))

    def phase(self, name: str) -> None:
        self._writer.send(("phase", (name,)))

    def advance(self, count: int, row: Mapping[str, float]) -> None:
        self._writer.send(("advance", (count, dict(row))))

    def saved(self, folder: Path) -> None:
        self._writer.send(("saved", (self._changes.take(),)))


def _work(task: RunTask, known: Sequence[str], writer: Connection) -> None:
    begin_worker()
    outbox = _Outbox(writer, task.folder, known)
    try:
        with heard_by(outbox):
            task.go()
        outbox.saved(task.folder)
        writer.send(("ended", ()))
    except Exception as error:
        writer.send(("failed", (_sendable(error), str(task.folder))))


def _sendable(error: Exception) -> Exception:
    """Return an error as it can be read on another machine."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        return RuntimeError(f"{type(error).__name__}: {error}")
    return error
