"""Sharing a loop over worlds among threads.

These are plain Python threads, which sleep while there is nothing to do. A forked child starts
threads of its own. No other library's thread count changes, and BLAS and torch keep their cores.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from functools import partial
from queue import SimpleQueue
from typing import Any

import numba

WORTH_A_THREAD = 16
"""Worlds below which starting another thread costs more time than it saves."""


def available() -> int:
    """Return how many threads this process may use: its cores, or NUMBA_NUM_THREADS if set."""
    return int(numba.config.NUMBA_NUM_THREADS)  # type: ignore[attr-defined]


class _Helpers:
    """Threads that wait for parts of loops, started when first needed."""

    def __init__(self) -> None:
        self._parts: SimpleQueue[Callable[[], None]] = SimpleQueue()
        self._started = 0
        self._starting = threading.Lock()

    def submit(self, part: Callable[[], None], threads: int) -> None:
        """Let one of at least ``threads`` threads run ``part``."""
        with self._starting:
            while self._started < threads:
                threading.Thread(target=self._work, name="hmi-marl", daemon=True).start()
                self._started += 1
        self._parts.put(part)

    def _work(self) -> None:
        while True:
            self._parts.get()()


_helpers = _Helpers()


def _start_anew() -> None:
    global _helpers
    _helpers = _Helpers()  # threads and locks do not come along in a fork


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_start_anew)


def share(loop: Callable[..., None], count: int, threads: int, *arguments: Any) -> None:
    """Run ``loop(first, last, *arguments)`` over 0 to ``count`` in up to ``threads`` parts.

    Raises:
        Exception: whatever a part raised, once all parts have ended.
    """
    parts = max(1, min(threads, count // WORTH_A_THREAD))
    if parts == 1:
        loop(0, count, *arguments)
        return
    edges = [count * part // parts for part in range(parts + 1)]
    ended: SimpleQueue[BaseException | None] = SimpleQueue()

    def run(first: int, last: int) -> None:
        try:
            loop(first, last, *arguments)
        except BaseException as error:
            ended.put(error)
        else:
            ended.put(None)

    for part in range(1, parts):
        _helpers.submit(partial(run, edges[part], edges[part + 1]), parts - 1)
    run(edges[0], edges[1])
    errors = [error for error in (ended.get() for _ in range(parts)) if error is not None]
    if errors:
        raise errors[0]
