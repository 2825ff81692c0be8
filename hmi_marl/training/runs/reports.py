"""Reports of a run to a listener: its progress, and every state from which it can go on.

A run that learns on another machine than the command that asked for it is heard by one; otherwise
there is none.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Protocol


class Listener(Protocol):
    """Hears of a run in this process."""

    def begin(self, name: str, total: int, done: int, unit: str) -> None:
        """Hear that ``total`` steps in this ``unit`` begin, of which so many are ``done``."""

    def phase(self, name: str) -> None:
        """Hear the name of what is done now."""

    def advance(self, count: int, row: Mapping[str, float]) -> None:
        """Hear of ``count`` more steps, and of a row of the curve if there is one."""

    def saved(self, folder: Path) -> None:
        """Hear that the run could now go on from what is in its folder."""


_listener: Listener | None = None


@contextmanager
def heard_by(listener: Listener) -> Iterator[None]:
    """Let ``listener`` hear of the run within; there is one run in a process at a time."""
    global _listener
    _listener, before = listener, _listener
    try:
        yield
    finally:
        _listener = before


def listener() -> Listener | None:
    """Return who hears of the run in this process; None for no one."""
    return _listener
