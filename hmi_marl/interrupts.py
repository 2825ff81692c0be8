"""Signals that end the ``hmi-marl`` command, each reported in one line.

Ctrl-C (SIGINT) ends it with status 130, SIGTERM with 143. While the package is imported the process
ends at once. Later they are raised as exceptions, so that files are left whole and no process stays
behind; a second signal, or one that was raised where Python ignores errors, ends it at once.

Only a process that was started as the command handles signals. In a program that imports the
package they stay as they are.

Until :func:`end_at_once` is called, SIGINT makes Python itself print a traceback. So the package
imports this module before anything else, and it imports next to nothing.
"""

from __future__ import annotations

import os
import signal
import sys

TYPE_CHECKING = False  # typing takes longer to import than all of this
if TYPE_CHECKING:
    from collections.abc import Callable
    from types import FrameType, TracebackType
    from typing import NoReturn

_REPORTS: dict[int, str] = {signal.SIGINT: "interrupted", signal.SIGTERM: "terminated"}
_received: list[int] = []
"""Signals that have been raised, for the command ends with the first of them."""


class Terminated(KeyboardInterrupt):
    """SIGTERM, which ends the same blocks as an interrupt does."""


def is_command() -> bool:
    """Whether this process was started as ``hmi-marl`` or ``python -m hmi_marl``."""
    given = sys.orig_argv
    by_name = ("-m", "hmi_marl") in zip(given, given[1:])  # noqa: B905, RUF007
    names = (part.replace("\\", "/").rpartition("/")[2] for part in given[:2])
    return by_name or any(name in ("hmi-marl", "hmi-marl.exe") for name in names)


def end_at_once() -> None:
    """Let a signal end this process at once, if it is the command; for the time of imports."""
    if is_command():
        _handle(_end)


class raised:  # noqa: N801  # reads as "with interrupts.raised():"; contextlib is not imported yet
    """Raise signals as exceptions within the block, if this process is the command.

    Afterwards they are ignored: what is left to do is to end.
    """

    def __enter__(self) -> None:
        self._handled = False
        if is_command():
            sys.unraisablehook = _ignored
            self._handled = _handle(_raise)

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._handled:
            _handle(signal.SIG_IGN)


def _handle(handler: Callable[[int, FrameType | None], object] | signal.Handlers) -> bool:
    """Let a handler have the signals; False in a thread other than the main one, which cannot."""
    try:
        for number in _REPORTS:
            signal.signal(number, handler)
    except ValueError:
        return False
    return True


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
