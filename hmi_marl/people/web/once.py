"""Forms that are sent twice, by a double click or a retry: the second finds what the first made."""

from __future__ import annotations

import secrets
import threading
from collections import OrderedDict
from collections.abc import Callable
from typing import Generic, TypeVar

FIELD = "once"
"""Name of the hidden field with the token of a form."""
_KNOWN = 1000
"""Most tokens that are remembered."""

Made = TypeVar("Made")


class Once(Generic[Made]):
    """Make one thing for each form that was shown."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._made: OrderedDict[str, Made] = OrderedDict()

    @staticmethod
    def token() -> str:
        """Return a token for a form's hidden field."""
        return secrets.token_urlsafe(16)

    def make(self, token: str, make: Callable[[], Made]) -> Made:
        """Return what was made for a token, or make it; without a token it is made anew."""
        if not token:
            return make()
        with self._lock:
            if token not in self._made:
                self._made[token] = make()
                if len(self._made) > _KNOWN:
                    self._made.popitem(last=False)
            return self._made[token]

    def forget(self, made: Made) -> None:
        """Forget something that is gone, so that its form makes another."""
        with self._lock:
            for token in [each for each, value in self._made.items() if value == made]:
                del self._made[token]
