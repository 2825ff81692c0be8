"""Driver policies and trait models that the settings of a training name, and where they are."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

from hmi_marl.agents.catalogue import is_learned, mixed_names
from hmi_marl.agents.learned.cards import is_shipped
from hmi_marl.envs.config import DRIVER
from hmi_marl.training.runs.folder import POLICIES

S = TypeVar("S")
"""Settings of a training, a dataclass."""


def policies_read(settings: Any) -> tuple[Path, ...]:
    """Return the paths of the learned policies, without those that come with the package."""
    return tuple(
        Path(name).absolute() for _, names in _named(settings) for name in names if _is_a_file(name)
    )


def reading(settings: S, places: Sequence[Path]) -> S:
    """Return settings that read the policies of :func:`policies_read` at these places instead."""
    left, changed = iter(places), dict[str, str]()
    for setting, names in _named(settings):
        there = [str(next(left)) if _is_a_file(name) else name for name in names]
        mixed = mixed_names(getattr(settings, setting))
        changed[setting] = f"mixture:{','.join(there)}" if mixed else there[0]
    return replace(settings, **changed)  # type: ignore[type-var]


def models_read(settings: Any) -> tuple[Path, ...]:
    """Return the path of the settings' trait model, or none if it comes with the package."""
    return () if is_shipped(settings.traits) else (Path(settings.traits).absolute(),)


def with_models(settings: S, places: Sequence[Path]) -> tuple[S, tuple[Path, ...]]:
    """Return settings that read the trait model of :func:`models_read` at the first place instead.

    Returns:
        The settings, and the places that are left.
    """
    if not models_read(settings):
        return settings, tuple(places)
    moved = replace(settings, traits=str(places[0]))  # type: ignore[type-var]
    return moved, tuple(places[1:])


def _named(settings: Any) -> Iterator[tuple[str, tuple[str, ...]]]:
    """List the settings that name policies, each with the names, several in a mixture."""
    for setting in POLICIES:
        name = getattr(settings, setting, None)
        if name is not None:
            yield setting, mixed_names(name) or (name,)


def _is_a_file(name: str) -> bool:
    return is_learned(name, DRIVER) and not is_shipped(name)
