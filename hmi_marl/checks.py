"""Checks of settings, declared at the fields.

Every error gives the field, its range and the value. A dataclass derived from :class:`Checked` runs
the checks in its annotations, such as :data:`Count` or :data:`Share`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any, Literal, SupportsIndex, get_args, get_origin, get_type_hints


def check_count(name: str, value: int, least: int = 1) -> int:
    """Return a number of things.

    Raises:
        TypeError: it is no whole number.
        ValueError: it is below ``least``.
    """
    if isinstance(value, bool) or not isinstance(value, SupportsIndex):
        raise TypeError(f"{name} is a whole number, not {value!r}")
    if value < least:
        raise ValueError(f"{name} is at least {least}, but got {value}")
    return value


def check_positive(name: str, value: float, zero: bool = False) -> float:
    """Return a finite number above 0, or with ``zero`` 0 too.

    Raises:
        ValueError: it is not finite, or too small.
    """
    if not (math.isfinite(value) and (value >= 0 if zero else value > 0)):
        range_ = "a number of at least 0" if zero else "a positive number"
        raise ValueError(f"{name} is {range_}, but got {value}")
    return value


def check_share(name: str, value: float, zero: bool = True, one: bool = True) -> float:
    """Return a number between 0 and 1; ``zero`` and ``one`` allow these ends.

    Raises:
        ValueError: it lies outside, or is not a number.
    """
    if not (0.0 < value < 1.0 or (zero and value == 0.0) or (one and value == 1.0)):
        range_ = f"{'[' if zero else '('}0, 1{']' if one else ')'}"
        raise ValueError(f"{name} lies in {range_}, but got {value}")
    return value


def check_choice(name: str, value: str, choices: Collection[str]) -> str:
    """Return one of several words.

    Raises:
        ValueError: it is none of them.
    """
    if value not in choices:
        raise ValueError(f"{name} is one of {', '.join(choices)}, not {value!r}")
    return value


def check_power_of_two(name: str, value: int) -> int:
    """Return 1, 2, 4, 8 and so on.

    Raises:
        TypeError, ValueError: it is no such number.
    """
    if check_count(name, value).bit_count() != 1:
        raise ValueError(f"{name} is a power of two such as 2, 4 or 8, but got {value}")
    return value


def check_threads(name: str, value: int | None) -> int | None:
    """Return a number of threads, or None for the default.

    Raises:
        TypeError, ValueError: it is no number of at least 1.
    """
    return None if value is None else check_count(name, value)


def check_device(name: str, value: str) -> str:
    """Return auto, cpu, cuda, or cuda:N.

    Raises:
        ValueError: it is none of them. Whether there is such a device is known when a run starts.
    """
    if not re.fullmatch(r"auto|cpu|cuda(:\d+)?", value):
        raise ValueError(f"{name} is auto, cpu, cuda or cuda:N, not {value!r}")
    return value


def check_mini_batches(num_mini_batches: int, num_teams: int) -> None:
    """Check that the teams of a batch can be split into mini-batches.

    Raises:
        ValueError: there are too few teams.
    """
    if num_mini_batches > num_teams:
        raise ValueError(
            f"cannot split {num_teams} teams into {num_mini_batches} mini-batches; "
            "lower --ppo.num-mini-batches or raise --num-teams"
        )


@dataclass(frozen=True)
class Check:
    """Check in a field's annotation: ``Annotated[int, Check(check_count)]``."""

    function: Callable[[str, Any], Any]
    """Returns the value to keep for a name and a value, or raises."""


Count = Annotated[int, Check(check_count)]
Device = Annotated[str, Check(check_device)]
PowerOfTwo = Annotated[int, Check(check_power_of_two)]
CountOrZero = Annotated[int, Check(partial(check_count, least=0))]
Positive = Annotated[float, Check(check_positive)]
PositiveOrZero = Annotated[float, Check(partial(check_positive, zero=True))]
Share = Annotated[float, Check(check_share)]


class Checked:
    """Base class of dataclasses with the checks of their fields in the annotations.

    A field of a :class:`~typing.Literal` type takes one of its words.
    """

    def __post_init__(self) -> None:
        for name, hint in get_type_hints(type(self), include_extras=True).items():
            metadata = getattr(hint, "__metadata__", ())
            checks = [each.function for each in metadata if isinstance(each, Check)]
            if get_origin(hint) is Literal:
                checks.append(partial(check_choice, choices=get_args(hint)))
            for check in checks:
                object.__setattr__(self, name, check(name, getattr(self, name)))
