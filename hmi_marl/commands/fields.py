"""Settings out of a command that has them beside its own options."""

from __future__ import annotations

from dataclasses import fields
from typing import Any, TypeVar

Settings = TypeVar("Settings")


def only(kind: type[Settings], command: Any) -> Settings:
    """The settings ``kind``, a dataclass, from a command that inherits their fields."""
    names = [field.name for field in fields(kind)]  # type: ignore[arg-type]
    return kind(**{name: getattr(command, name) for name in names})
