"""Settings that no user can make, for tests of what happens if learning goes wrong all the same."""

import copy
from typing import Any, TypeVar

Settings = TypeVar("Settings")


def unchecked(settings: Settings, **values: Any) -> Settings:
    """Copy of frozen settings with other values, whatever their ranges."""
    other = copy.copy(settings)
    for name, value in values.items():
        object.__setattr__(other, name, value)
    return other
