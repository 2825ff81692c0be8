"""Sharing a loop over worlds among threads.

These are plain Python threads, which sleep while there is nothing to do. A forked child starts
threads of its own. No other library's thread count changes, and BLAS and torch keep their cores.

The worlds are taken in small parts, by whichever thread is free. Where another library keeps a core
busy (OpenMP's threads wait actively for a while after each parallel loop), the calling thread takes
more of the parts and waits for no helper that has not begun.
"""

from __future__ import annotations

import os
import threading
import time
from collections import deque
from collections.abc import Callable
from queue import SimpleQueue
from statistics import median
from typing import Any

import numba
import numpy as np
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic
from numpy.typing import NDArray

from hmi_marl.envs.worlds.batched.compiler import WITHOUT_COMPILER, compiled

WORTH_A_THREAD = 16
"""Worlds below which another thread costs more time than it saves."""
_SMALLEST, _LARGEST = 8, 32
"""Worlds that a thread takes at a time."""
_PARTS = 32
"""Parts for each thread, if they are not too small or too large: with few, threads wait at the end;
with many, each phase of a step displaces another's code from the processor's cache more often."""


def _add_compiled(typing_context: Any, array: Any, place: Any, amount: Any) -> Any:
    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kind, _, _ = signature.args
        data = cgutils.create_struct_proxy(kind)(context, builder, arguments[0]).data
        where = builder.gep(data, [arguments[1]])
        return builder.atomic_rmw("add", where, arguments[2], "seq_cst")

    number = types.int64
    return number(array, number, number), codegen


def _add_in_python(array: NDArray[np.int64], place: int, amount: int) -> int:
    before = int(array[place])
    array[place] += amount
    return before


_add: Any = _add_in_python if WITHOUT_COMPILER else intrinsic(_add_compiled)
"""Add to an element of an int64 array, safe among threads; returns what it was before."""


@compiled
def take(progress, finished, count):
    """Return (first, last) of the next part of ``count`` worlds; empty when all are taken.

    Args:
        progress: see :func:`new_progress`.
        finished: worlds of the part that the caller has just done, 0 at first.
    """
    part = progress[2]
    _add(progress, 1, finished)
    first = _add(progress, 0, part)
    return min(first, count), min(first + part, count)


@compiled
def _stop(progress, count):
    """Leave no world to take; returns how many had been taken, or more."""
    return _add(progress, 0, count)


@compiled
def _finished(progress):
    return _add(progress, 1, 0)


def new_progress(count: int = 0, threads: int = 1) -> NDArray[np.int64]:
    """Return the progress of a loop over so many worlds, int64 of shape (3,).

    Its numbers are how many worlds have been taken, how many are finished, and how many a thread
    takes at a time.
    """
    part = count // (_PARTS * threads) if threads > 1 else _LARGEST
    return np.array([0, 0, min(max(part, _SMALLEST), _LARGEST)], np.int64)


def available() -> int:
    """Return how many threads this process may use: its cores, or NUMBA_NUM_THREADS if set."""
    return int(numba.config.NUMBA_NUM_THREADS)  # type: ignore[attr-defined]


class _Helpers:
    """Threads that wait for work, started when first needed."""

    def __init__(self) -> None:
        self._work: SimpleQueue[Callable[[], None]] = SimpleQueue()
        self._started = 0
        self._starting = threading.Lock()

    def submit(self, work: Callable[[], None], helpers: int) -> int:
        """Let up to so many threads do ``work`` as soon as they get to it; returns how many.

        There are fewer where the system allows no more threads.
        """
        with self._starting:
            while self._started < helpers:
                thread = threading.Thread(target=self._serve, name="hmi-marl", daemon=True)
                try:
                    thread.start()
                except RuntimeError:  # the process may have no more
                    helpers = self._started
                    break
                self._started += 1
        for _ in range(helpers):
            self._work.put(work)
        return helpers

    def _serve(self) -> None:
        while True:
            self._work.get()()


_helpers = _Helpers()


def _start_anew() -> None:
    global _helpers
    _helpers = _Helpers()  # threads do not come along in a fork


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_start_anew)


def share(loop: Callable[..., None], count: int, threads: int, *arguments: Any) -> None:
    """Run ``loop(progress, *arguments)`` over ``count`` worlds in up to ``threads`` threads.

    Args:
        loop: asks :func:`take` for worlds until there are none left.
        count: of worlds.
        threads: at most, the caller's included.

    Raises:
        BaseException: an interrupt, or what a loop raised. No thread touches the worlds any more.
    """
    helpers = min(threads, count // WORTH_A_THREAD) - 1
    progress = new_progress(count, helpers + 1)
    if helpers < 1 or WITHOUT_COMPILER:
        loop(progress, *arguments)
        return
    ended: SimpleQueue[BaseException | None] = SimpleQueue()

    def help_out() -> None:
        error = None
        try:
            loop(progress, *arguments)
        except BaseException as caught:
            error = caught
        ended.put(error)

    waiting = helpers
    try:
        waiting = _helpers.submit(help_out, helpers)
        loop(progress, *arguments)
        while _finished(progress) < count:
            error = ended.get()
            waiting -= 1
            if error is not None:
                raise error
    except BaseException:  # an interrupt, mostly: helpers finish the parts that they have begun
        begun = min(_stop(progress, count), count)
        while waiting and _finished(progress) < begun:
            ended.get()
            waiting -= 1
        raise


class Pace:
    """Choose between one thread and several by which was faster lately.

    On a busy machine, or where another library's threads wait actively on the other cores, a
    helper that is put off in the middle of its part costs more than it saves. So now and then a few
    steps are taken the other way, and the faster way is kept.
    """

    TRIAL, BETWEEN = 5, 500
    """Steps of a trial, and from one trial to the next: trials cost at most about 1 %."""

    def __init__(self) -> None:
        self._together = True
        self._step = 0
        self._spent: dict[bool, deque[float]] = {
            together: deque(maxlen=self.TRIAL) for together in (False, True)
        }

    def threads(self, most: int) -> int:
        """Return how many threads to use for the next step: ``most`` or 1."""
        on_trial = self.TRIAL <= self._step < 2 * self.TRIAL
        return most if self._together != on_trial else 1

    def run(self, loop: Callable[..., None], count: int, most: int, *arguments: Any) -> None:
        """Run a loop as :func:`share` does, on ``most`` threads or one, and note its time."""
        threads, start = self.threads(most), time.perf_counter()
        share(loop, count, threads, *arguments)
        self.note(threads, time.perf_counter() - start)

    def note(self, threads: int, seconds: float) -> None:
        """Record the time of a step with so many threads."""
        self._spent[threads > 1].append(seconds)
        self._step += 1
        together, alone = self._spent[True], self._spent[False]
        if self._step == 2 * self.TRIAL and together and alone:
            self._together = median(together) <= median(alone)
        elif self._step == self.BETWEEN:
            self._step = 0
