"""How long parts of some work took."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager


class Stopwatch:
    """How long parts took, by name."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def timing(self, part: str) -> Iterator[None]:
        """Time what is done within."""
        began = time.monotonic()
        yield
        self.seconds[part] = time.monotonic() - began
