"""Arrays of an object's own after it was copied to another process."""

from __future__ import annotations

from typing import Any

import numpy as np


def writeable(value: Any) -> Any:
    """Return ``value`` with copies in place of arrays that compiled loops cannot write to.

    joblib hands large arrays to its workers as read-only memory maps, and small ones at odd
    addresses.
    """
    if isinstance(value, np.ndarray):
        return value if value.flags.behaved else np.array(value)
    if isinstance(value, tuple):
        parts = map(writeable, value)
        return type(value)(*parts) if hasattr(value, "_fields") else tuple(parts)
    if type(value) is dict:
        return {name: writeable(each) for name, each in value.items()}
    return value


class OwnArrays:
    """Base class of objects whose arrays are written into, also after they were copied."""

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Load a copy, with arrays of its own."""
        self.__dict__.update(writeable(state))
