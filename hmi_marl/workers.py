"""Worker processes of one thread each.

Several threads in each of several processes would only slow each other down.
"""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import active_children, get_context, parent_process
from typing import Any, TypeVar

from hmi_marl.checks import WORKERS

Task = TypeVar("Task")
Result = TypeVar("Result")

_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


def threads_each(count: int) -> dict[str, str]:
    """Environment variables of processes that use so many threads each; read when they start."""
    return dict.fromkeys(_THREADS, str(count))


def cores() -> int:
    """Return the number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


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

    At the end, submitted tasks that have not begun are dropped.
    """
    with environment(threads_each(1)):
        executor = ProcessPoolExecutor(
            workers, get_context("spawn"), initializer=_begin, initargs=(begin, arguments)
        )
        try:
            yield executor
        except KeyboardInterrupt:
            for process in active_children():
                process.terminate()  # their tasks may take hours
            raise
        finally:
            executor.shutdown(cancel_futures=True)


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
        return
    with pool(min(workers, len(tasks))) as workshop:
        for future in [workshop.submit(function, task) for task in tasks]:
            yield future.result()


def begin_worker() -> None:
    """Let this process end quietly at an interrupt, and with the process that started it."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # without a traceback
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _begin(then: Callable[..., object] | None, arguments: tuple[Any, ...]) -> None:
    begin_worker()
    if then is not None:
        then(*arguments)


def _end_with_parent() -> None:
    """End this worker when its parent has ended: there is no process left to take its result."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
