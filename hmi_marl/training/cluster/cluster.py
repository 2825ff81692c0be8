"""A Ray cluster on which tasks are learned, seen from the command that asks for them.

The command owns the folders. A task is taken up by any node that is free, from the files of its
folder, and each state from which it could go on is sent back and written there. So nodes share no
folder, and when a node dies its tasks go on elsewhere from the latest state, with the same results.
"""

from __future__ import annotations

import signal
import socket
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tqdm import tqdm

from hmi_marl.checks import Checked, Threads
from hmi_marl.extras import needing
from hmi_marl.ownership import owned
from hmi_marl.text import quoted
from hmi_marl.training.cluster.node import PACKAGES, Message, Worker, difference, versions
from hmi_marl.training.cluster.parcels import Files, put, read_by_others, state_in
from hmi_marl.training.run_tasks import RunTask
from hmi_marl.training.runs.progress import Bar
from hmi_marl.workers import cores, environment

LOCAL, AUTO = "local", "auto"
"""Addresses of a cluster that is started on this machine for the time of a command, and of the one
that runs on it."""
MOST_LOSSES = 3
"""Losses of a task in a row, without a new state in between, that end the command."""
_ANSWER = 60.0
"""Longest wait for an answer of a node [s]."""
_CONNECT = 10.0
"""Longest wait for a connection to an address [s]; Ray itself tries for minutes."""
_SIGNALS = (signal.SIGINT, signal.SIGTERM)


@dataclass(frozen=True)
class Cluster(Checked):
    """Cluster that this process is connected to, see :func:`connected`."""

    at_once: Threads | None = None
    """Most tasks at a time; by default as many as the cluster has cores."""

    def learn(self, tasks: Sequence[RunTask], quiet: bool = False) -> None:
        """Learn every task that is not learned yet, and resume those that were cut off.

        Raises:
            ChildProcessError: a task was lost too often, such as for want of memory.
            FolderInUseError: another process writes into a task's folder.
            Exception: what a task raised, which ends the others.
        """
        _Learning(tasks, self.at_once, quiet).go()


@contextmanager
def connected(address: str | None, at_once: int | None = None) -> Iterator[Cluster | None]:
    """Connect to a Ray cluster within, and check that its nodes have the versions used here.

    Args:
        address: ``auto`` for the one that runs on this machine, ``HOST:PORT`` of its head,
            ``ray://HOST:PORT`` of its server for clients, or ``local`` for one that is started
            here; None for no cluster.
        at_once: see :class:`Cluster`.

    Raises:
        ConnectionError: there is no cluster at the address.
        ModuleNotFoundError: Ray is not installed.
        ValueError: a node has other versions of this package or of those that results depend on.
    """
    if address is None:
        yield None
        return
    if address not in (LOCAL, AUTO):
        _check_reachable(address)
    ray = _ray()
    before = ray.is_initialized()
    try:
        if not before:
            _connect(address, at_once)
        _check_nodes()
        yield Cluster(at_once)
    finally:
        if not before:
            ray.shutdown()


def _ray() -> Any:
    """Import Ray, which takes a second and which only this module uses; it has few types."""
    with needing("training on a cluster"):
        import ray
        import ray.util.scheduling_strategies
    return ray


def _connect(address: str, at_once: int | None) -> None:
    how: dict[str, Any] = {"log_to_driver": False, "logging_level": "ERROR"}
    if address == LOCAL:
        how |= {"num_cpus": at_once or cores(), "include_dashboard": False}
    try:
        # Ray takes over SIGTERM, which this process may handle itself.
        with _same_signals(), environment({"RAY_USAGE_STATS_ENABLED": "0"}):
            _ray().init(address, **how)
    except (ConnectionError, RuntimeError, ValueError) as error:
        if address == AUTO:
            raise ConnectionError(
                "this machine is in no Ray cluster; start one with `ray start --head`"
            ) from None
        raise ConnectionError(
            f"cannot connect to the Ray cluster at {address}, perhaps for want of its token, which "
            f"RAY_AUTH_MODE=token and RAY_AUTH_TOKEN give: {quoted(error)}"
        ) from None


def _check_reachable(address: str) -> None:
    """Raise ``ConnectionError`` if nothing listens at an address, ``ValueError`` if it is none."""
    host, colon, port = address.removeprefix("ray://").rpartition(":")
    if not colon or not port.isdecimal() or not 0 < int(port) < 2**16 or not host:
        raise ValueError(
            f"a Ray cluster is auto, local, HOST:PORT or ray://HOST:PORT, not {address!r}"
        )
    try:
        socket.create_connection((host.strip("[]"), int(port)), _CONNECT).close()
    except OSError as error:
        reason = error.strerror or str(error)
        raise ConnectionError(
            f"no Ray cluster at {address}: {reason}; `ray start --head` prints its address"
        ) from None


@contextmanager
def _same_signals() -> Iterator[None]:
    """Leave the handlers of signals as they are."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    handlers = {number: signal.getsignal(number) for number in _SIGNALS}
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)


def _check_nodes() -> None:
    """Raise ``ValueError`` if a node has other versions than this process, or does not answer."""
    ray, here = _ray(), versions()
    ask, affinity = ray.remote(_versions_there(PACKAGES)), ray.util.scheduling_strategies
    answers = []
    for node in ray.nodes():
        if node["Alive"] and node["Resources"].get("CPU"):
            there = affinity.NodeAffinitySchedulingStrategy(node["NodeID"], soft=False)
            how = {"num_cpus": 0, "max_retries": 0, "scheduling_strategy": there}
            answers.append((node["NodeManagerHostname"], ask.options(**how).remote()))
    for name, answer in answers:
        try:
            odd = difference(ray.get(answer, timeout=_ANSWER), here)
        except ray.exceptions.GetTimeoutError:
            raise ValueError(f"node {name} does not answer within {_ANSWER:g} s") from None
        except ray.exceptions.RayError:
            continue  # it has just died
        if odd is not None:
            raise ValueError(f"node {name} has {odd}; install the same there")


def _versions_there(packages: Sequence[str]) -> Callable[[], dict[str, str]]:
    """Return a function that works where this package is not installed: Ray sends its code."""

    def ask() -> dict[str, str]:
        from importlib.metadata import PackageNotFoundError, version

        found = {}
        for package in packages:
            try:
                found[package] = version(package).partition("+")[0]
            except PackageNotFoundError:
                found[package] = "none"
        return found

    return ask


class _Learning:
    """Tasks of one call, waiting for nodes or on them."""

    def __init__(self, tasks: Sequence[RunTask], at_once: int | None, quiet: bool) -> None:
        self._ray = _ray()
        self._at_once, self._quiet = at_once, quiet
        self._waiting = deque(_Taken(task, quiet) for task in tasks)
        self._running: dict[Any, _Taken] = {}
        """Tasks by the news that they are asked for."""
        self._no_core = False
        """Whether it was said that there is no core."""
        self._sent: dict[Path, Any] = {}
        """What tasks read, sent to the cluster once."""

    def go(self) -> None:
        try:
            while self._waiting or self._running:
                self._start()
                self._listen()
        finally:
            self._stop()

    def _start(self) -> None:
        """Start what waits, while there are cores for it."""
        there = int(self._ray.cluster_resources().get("CPU", 0))
        if not there and not self._no_core:
            tqdm.write("hmi-marl: no node has a core; waiting until one joins", file=sys.stderr)
        self._no_core = not there
        at_once = self._at_once or max(1, there)
        while self._waiting and len(self._running) < at_once:
            taken = self._waiting.popleft()
            lines = {each.line for each in self._running.values()}
            taken.line = next(line for line in range(len(lines) + 1) if line not in lines)
            task = taken.task
            taken.own()
            kind = self._ray.remote(
                num_cpus=1, num_gpus=int(task.gpu), max_restarts=0, max_task_retries=0
            )(Worker)
            reads = [self._send(path) for path in task.reads]
            taken.worker = kind.remote(task, state_in(task.folder), versions(), *reads)
            self._running[taken.worker.news.remote()] = taken

    def _send(self, path: Path) -> Any:
        if path not in self._sent:
            self._sent[path] = self._ray.put(read_by_others(path))
        return self._sent[path]

    def _listen(self) -> None:
        """Take the news of the tasks that have some."""
        for news in self._ray.wait(list(self._running), timeout=1.0)[0]:
            taken = self._running.pop(news)
            try:
                lost = taken.take(self._ray.get(news))
            except self._ray.exceptions.RayError as error:
                if isinstance(error, self._ray.exceptions.RayTaskError):
                    raise  # a fault of the worker itself
                lost = type(error).__name__
            except BaseException:
                self._end(taken)
                raise
            if lost:
                self._end(taken)
                taken.note_loss(lost)
                self._waiting.append(taken)
            elif taken.ended:
                self._end(taken)
            else:
                self._running[taken.worker.news.remote()] = taken

    def _end(self, taken: _Taken) -> None:
        with suppress(Exception):  # it may be gone
            self._ray.kill(taken.worker)
        taken.close()

    def _stop(self) -> None:
        """End what still runs; each removes its temporary folder if it can be reached."""
        left = list(self._running.values())
        with suppress(Exception):
            stopped = [taken.worker.stop.remote() for taken in left]
            if stopped:
                self._ray.wait(stopped, num_returns=len(stopped), timeout=5.0)
        for taken in left:
            self._end(taken)


class _Taken:
    """Task with what is known of it here; hears the messages of its worker."""

    def __init__(self, task: RunTask, quiet: bool) -> None:
        self.task, self.line, self.ended = task, 0, False
        self.worker: Any = None
        self._quiet, self._losses = quiet, 0
        self._owned = ExitStack()
        self._bar: Bar | None = None

    def take(self, messages: Sequence[Message]) -> str:
        """Act on messages; return how the task was lost, or nothing if it was not.

        Raises:
            Exception: what the task raised.
        """
        for name, arguments in messages:
            if name == "lost":
                return str(arguments[0])
            getattr(self, f"_{name}")(*arguments)
        return ""

    def note_loss(self, how: str) -> None:
        """Say that the task goes on elsewhere.

        Raises:
            ChildProcessError: it was lost too often.
        """
        self._losses += 1
        name = self.task.folder.name
        if self._losses == MOST_LOSSES:
            raise ChildProcessError(
                f"{name} was lost {MOST_LOSSES} times in a row ({how}), perhaps for want of "
                "memory on the nodes; the same command continues it"
            )
        line = f"hmi-marl: the node or process of {name} was lost ({how}); it goes on elsewhere"
        tqdm.write(line, file=sys.stderr)

    def own(self) -> None:
        """Own the folder of the task, until it is closed."""
        self._owned.enter_context(owned(self.task.folder))

    def close(self) -> None:
        """Leave the bar as it is, and the folder to others."""
        self._close_bar()
        self._owned.__exit__(*sys.exc_info())  # removes what is empty, after an error

    def _close_bar(self) -> None:
        if self._bar is not None:
            self._bar.close()

    def _begin(self, name: str, total: int, done: int, unit: str) -> None:
        self._close_bar()
        self._bar = Bar(name, total, done, unit, self._quiet, self.line)

    def _phase(self, name: str) -> None:
        if self._bar is not None:
            self._bar.phase(name)

    def _advance(self, count: int, row: Mapping[str, float]) -> None:
        if self._bar is not None:
            self._bar.advance(count, row)

    def _saved(self, files: Files) -> None:
        put(self.task.folder, files)
        self._losses = 0

    def _ended(self) -> None:
        self.ended = True

    def _failed(self, error: Exception, there: str = "") -> None:
        if there:  # the folder on the node, which means nothing here
            here = str(self.task.folder)
            error.args = tuple(
                each.replace(there, here) if isinstance(each, str) else each for each in error.args
            )
        raise error
