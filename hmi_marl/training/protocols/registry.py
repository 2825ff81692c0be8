"""The protocols by name: one line registers one. ``train``, ``compare`` and the docs read them.

A protocol of your own is a frozen dataclass derived from :class:`TrainSettings` with ``phases()``,
registered before the command runs; with ``for_comparison()`` it can be compared with the others.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from hmi_marl.registry import Registry
from hmi_marl.training.protocols.alternating import Alternating
from hmi_marl.training.protocols.fine_tune import FineTune
from hmi_marl.training.protocols.joint import Joint, Simultaneous
from hmi_marl.training.protocols.settings import TrainSettings
from hmi_marl.training.protocols.two_stage import TwoStage

PROTOCOLS: Registry[type[TrainSettings]] = Registry("protocol", "hmi-marl train --help")


def register(name: str, protocol: type[TrainSettings]) -> None:
    """Register a protocol. The first line of its docstring is its line of help.

    Raises:
        ValueError: there is a protocol of this name, or the class has no docstring.
    """
    if not protocol.__doc__:
        raise ValueError(f"{protocol.__name__} needs a docstring: its first line is shown as help")
    PROTOCOLS.register(name, protocol.__doc__.splitlines()[0], protocol)


register("two-stage", TwoStage)
register("joint", Joint)
register("simultaneous", Simultaneous)
register("alternating", Alternating)
register("fine-tune", FineTune)


def name_of(protocol: type[TrainSettings]) -> str:
    """Name under which a protocol is registered."""
    return next(name for name, entry in PROTOCOLS.items() if entry.value is protocol)


def compared() -> dict[str, tuple[type[TrainSettings], Mapping[str, Any]]]:
    """Protocols and variants that can be compared: class and settings by name."""
    return {
        name + suffix: (entry.value, settings)
        for name, entry in PROTOCOLS.items()
        for suffix, settings in entry.value.variants.items()
        if entry.value.for_comparison.__func__ is not TrainSettings.for_comparison.__func__  # type: ignore[attr-defined]
    }
