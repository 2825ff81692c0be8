"""Worker processes of one thread each, which end with the process that started them.

Several threads in each of several processes would only slow each other down.
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import get_context, parent_process, resource_tracker
from queue import SimpleQueue
from typing import Any, TypeVar

from hmi_marl.checks import WORKERS

Task = TypeVar("Task")
Result = TypeVar("Result")

_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
_QUIET_TRACKER = {"PYTHONWARNINGS": "ignore::UserWarning:multiprocessing.resource_tracker"}
"""Environment of the process that removes locks left by killed processes, and warns of each."""
_PR_SET_PDEATHSIG = 1
"""Number in Linux's <sys/prctl.h>."""


def threads_each(count: int) -> dict[str, str]:
    """Environment variables of processes that use so many threads each; read when they start."""
    return dict.fromkeys(_THREADS, str(count))


def cores() -> int:
    """Return the number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def check_threads_here(threads: int | None) -> None:
    """Check that this machine has a core for each of so many threads.

    Raises:
        ValueError: it has not.
    """
    most = max(os.cpu_count() or 1, cores())
    if threads is not None and threads > most:
        raise ValueError(f"threads is at most {most}, the cores of this machine, but got {threads}")


def check_workers(workers: int | None) -> int:
    """Return the number of workers, by default that of the cores, or raise if there are none."""
    if workers is None:
        return cores()
    return WORKERS("workers", workers)


@contextmanager
def pool(
    workers: int, begin: Callable[..., object] | None = None, *arguments: Any
) -> Iterator[ProcessPoolExecutor]:
    """A pool of up to ``workers`` fresh processes, each of which first calls ``begin(*arguments)``.

    Its processes start when tasks are submitted, see :func:`without_interrupts`. At the end,
    submitted tasks that have not begun are dropped; at an error, those that have begun too, for
    they may take hours.

    Raises:
        ChildProcessError: a process was killed.
    """
    with environment(threads_each(1)):
        executor = ProcessPoolExecutor(
            workers, get_context("spawn"), initializer=_begin, initargs=(begin, arguments)
        )
        try:
            yield executor
        except BaseException as error:
            for process in list((executor._processes or {}).values()):
                process.kill()
            if isinstance(error, BrokenProcessPool):
                raise ChildProcessError(
                    "a worker process was killed, perhaps for want of memory; start the command "
                    "again, with fewer --workers if memory is short"
                ) from None
            raise
        finally:
            executor.shutdown(cancel_futures=True)


def calls(
    function: Callable[..., Result],
    tasks: Sequence[tuple[Any, ...]],
    workers: int,
    begin: Callable[..., object] | None = None,
    *arguments: Any,
) -> Iterator[Result]:
    """Yield ``function`` of every task's arguments, in their order, from a :func:`pool`.

    The first error of any task ends the others.
    """
    with pool(max(1, min(workers, len(tasks))), begin, *arguments) as workshop:
        with without_interrupts():
            futures = [workshop.submit(function, *task) for task in tasks]
            # A pool watches the processes that it had at the latest submission, so one more.
            workshop.submit(_nothing)
        ended: SimpleQueue[Future[Result]] = SimpleQueue()
        for future in futures:
            future.add_done_callback(ended.put)
        for future in futures:
            while not future.done():
                ended.get().result()  # raises the error of any that failed
            yield future.result()


@contextmanager
def environment(variables: Mapping[str, str]) -> Iterator[None]:
    """Run a block with these environment variables."""
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def results(
    function: Callable[[Task], Result], tasks: Sequence[Task], workers: int
) -> Iterator[Result]:
    """Yield ``function`` of every task, in their order; with one worker, in this process."""
    if workers == 1:
        yield from map(function, tasks)
    else:
        yield from calls(function, [(task,) for task in tasks], workers)


@contextmanager
def without_interrupts() -> Iterator[None]:
    """Start processes within that get no Ctrl-C of their own.

    They would print a traceback each. The process that starts them gets it, if need be at the end
    of the block, and ends them. Locks that processes share are made within, too.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield  # they ignore it as soon as they begin
        return
    with environment(_QUIET_TRACKER):
        resource_tracker.ensure_running()  # here, since it unblocks signals when it starts
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def begin_worker() -> None:
    """Leave interrupts to the process that started this one, and end with it, however it ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if not _is_killed_with_parent():
        threading.Thread(target=_end_with_parent, daemon=True).start()


def _nothing() -> None:
    pass


def _begin(then: Callable[..., object] | None, arguments: tuple[Any, ...]) -> None:
    begin_worker()
    if then is not None:
        then(*arguments)


def _is_killed_with_parent() -> bool:
    """Ask Linux to kill this process when its parent has ended; return whether it will."""
    if not sys.platform.startswith("linux"):
        return False
    try:
        asked = ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL) == 0
    except (AttributeError, OSError):
        return False
    parent = parent_process()
    if asked and parent is not None and os.getppid() != parent.pid:
        os._exit(1)  # it has ended before it was asked
    return asked


def _end_with_parent() -> None:
    """End this worker when its parent has ended: there is no process left to take its result."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
