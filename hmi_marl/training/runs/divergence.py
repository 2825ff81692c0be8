"""Checks for learning that diverges: numbers that are not finite end a run at once."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

import torch


def check_finite(losses: Mapping[str, float], rate: float, setting: str) -> None:
    """Check losses and other numbers that are finite unless learning diverges.

    Args:
        losses: numbers by name.
        rate: learning rate.
        setting: its name among the settings.

    Raises:
        FloatingPointError: one is not; the message names them and the learning rate.
    """
    if odd := [name for name, value in losses.items() if not math.isfinite(value)]:
        raise FloatingPointError(
            f"{', '.join(odd)} not finite with {setting} at {rate:.3g}; lower {setting}"
        )


def are_finite(tensors: Iterable[torch.Tensor]) -> bool:
    """Whether all numbers are finite."""
    return all(bool(torch.isfinite(tensor).all()) for tensor in tensors)
