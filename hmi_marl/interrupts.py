"""Signals that end the ``hmi-marl`` command, each reported in one line.

Ctrl-C (SIGINT) ends it with status 130, SIGTERM with 143. While the package is imported the process
ends at once. Later they are raised as exceptions, so that files are left whole and no process stays
behind; a second signal, or one that was raised where Python ignores errors, ends it at once.

Only a process that was started as the command handles signals. In a program that imports the
package they stay as they are.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from types import FrameType
from typing import NoReturn

_REPORTS: dict[int, str] = {signal.SIGINT: "interrupted", signal.SIGTERM: "terminated"}
_received: list[int] = []
"""Signals that have been raised, for the command ends with the first of them."""


class Terminated(KeyboardInterrupt):
    """SIGTERM, which ends the same blocks as an interrupt does."""


def is_command() -> bool:
    """Whether this process was started as ``hmi-marl`` or ``python -m hmi_marl``."""
    given = sys.orig_argv
    by_name = ("-m", "hmi_marl") in pairwise(given)
    return by_name or any(Path(part).stem == "hmi-marl" for part in given[:2])


def end_at_once() -> None:
    """Let a signal end this process at once, if it is the command; for the time of imports."""
    if is_command() and threading.current_thread() is threading.main_thread():
        for number in _REPORTS:
            signal.signal(number, _end)


@contextmanager
def raised() -> Iterator[None]:
    """Raise signals as exceptions within the block, if this process is the command.

    Afterwards they are ignored: what is left to do is to end.
    """
    if not is_command() or threading.current_thread() is not threading.main_thread():
        yield
        return
    sys.unraisablehook = _ignored
    for number in _REPORTS:
        signal.signal(number, _raise)
    try:
        yield
    finally:
        for number in _REPORTS:
            signal.signal(number, signal.SIG_IGN)


def was_stopped() -> bool:
    """Whether a signal was raised, whatever error it has become on its way."""
    return bool(_received)


def report() -> int:
    """Print the line for the signal that was raised, and return the exit status."""
    number = _received[0] if _received else signal.SIGINT
    begin = "\n" if sys.stderr.isatty() else ""  # below the bar of a process that was ended
    print(f"{begin}hmi-marl: {_REPORTS[number]}", file=sys.stderr)
    return 128 + number


def _raise(number: int, frame: FrameType | None) -> NoReturn:
    _received.append(number)
    if len(_received) > 1:
        _end(_received[0])
    raise Terminated if number == signal.SIGTERM else KeyboardInterrupt


def _end(number: int, frame: FrameType | None = None) -> NoReturn:
    os.write(
        2, f"hmi-marl: {_REPORTS[number]}\n".encode()
    )  # print may be what the signal came in between
    os._exit(128 + number)


def _ignored(error: sys.UnraisableHookArgs) -> None:
    """End at a signal that was raised in a finalizer or a callback, where errors are ignored."""
    if issubclass(error.exc_type, KeyboardInterrupt) and _received:
        _end(_received[0])
    sys.__unraisablehook__(error)
