"""Checks of settings, declared at the fields.

A dataclass derived from :class:`Checked` checks its fields by their annotations: :class:`Whole` and
:class:`Real` give a number's range, as in ``Annotated[int, Whole(1, 50)]``. Every number has both
ends, since what is far too large overflows somewhere else, or takes all memory. The same objects
check the arguments of functions: ``Whole(1, 50)("lanes", lanes)``. Errors take one line, which
names the field, its range and the value.
"""

from __future__ import annotations

import functools
import math
import numbers
import re
from collections.abc import Callable, Collection
from dataclasses import dataclass, fields, is_dataclass
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np

_SHOWN = 60
"""Most characters of a value in an error."""


def shown(value: object) -> str:
    """Return a value in one short line, for errors."""
    if isinstance(value, numbers.Integral) and abs(int(value)) >= 10**20:
        number = int(value)  # whose digits Python may refuse to write
        return f"about {'-' if number < 0 else ''}10^{round(math.log10(abs(number)))}"
    try:
        text = " ".join(repr(value).split())
    except ValueError:  # Python refuses to write very long numbers
        text = f"a {type(value).__name__}"
    return text if len(text) <= _SHOWN else f"{text[: _SHOWN - 3]}..."


class Check:
    """Check in a field's annotation: ``Annotated[str, Check(check_name)]``.

    Args:
        function: returns the value to keep for a name and a value, or raises.
        allowed: what it allows, in words, for the documentation.
    """

    def __init__(self, function: Callable[[str, Any], Any], allowed: str = "") -> None:
        self._function, self._allowed = function, allowed

    def __call__(self, name: str, value: Any) -> Any:
        """Return the value to keep."""
        return self._function(name, value)

    def __str__(self) -> str:
        return self._allowed


@dataclass(frozen=True)
class Whole(Check):
    """A whole number of Python or NumPy from ``least`` to ``most``; becomes an int."""

    least: int
    most: int
    unit: str = ""

    def __call__(self, name: str, value: Any) -> int:
        """Return the number as an int.

        Raises:
            TypeError: it is no whole number, or a bool.
            ValueError: it is out of range.
        """
        if isinstance(value, bool) or not isinstance(value, numbers.Integral):
            raise TypeError(f"{name} is a whole number, not {shown(value)}")
        if not self.least <= int(value) <= self.most:
            raise ValueError(f"{name} lies in {self}, but got {shown(value)}")
        return int(value)

    def __str__(self) -> str:
        return f"{self.least} to {self.most}{self.unit and ' '}{self.unit}"


@dataclass(frozen=True)
class Real(Check):
    """A number of Python or NumPy in [low, high]; becomes a float."""

    low: float
    high: float
    unit: str = ""
    above: bool = False
    """Whether ``low`` itself is left out."""
    below: bool = False
    """Whether ``high`` itself is left out."""
    or_zero: bool = False
    """Whether 0 is allowed as well."""

    def __call__(self, name: str, value: Any) -> float:
        """Return the number as a float.

        Raises:
            TypeError: it is no real number, or a bool.
            ValueError: it is out of range, or NaN.
        """
        if isinstance(value, bool) or not isinstance(value, numbers.Real):
            raise TypeError(f"{name} is a number, not {shown(value)}")
        number: Any = value  # compared as it is: a large int has no float
        fits = self.low <= number <= self.high or (self.or_zero and number == 0)
        if not fits or (self.above and value == self.low) or (self.below and value == self.high):
            raise ValueError(f"{name} lies in {self}, but got {shown(value)}")
        return float(value)  # in range, so that no large int overflows

    def __str__(self) -> str:
        ends = (
            f"{'(' if self.above else '['}{self.low:g}, {self.high:g}{')' if self.below else ']'}"
        )
        return f"{ends}{self.unit and ' '}{self.unit}{' or is 0' if self.or_zero else ''}"


@dataclass(frozen=True)
class Names(Check):
    """One or more different names of ``choices``."""

    choices: tuple[str, ...]
    needed: str = ""
    """Name that has to be among them, to compare with; empty if none has."""

    def __call__(self, name: str, value: tuple[str, ...]) -> tuple[str, ...]:
        """Return the names.

        Raises:
            ValueError: one is unknown or named twice, there are none, or the needed one is missing.
        """
        wrong = [each for each in value if each not in self.choices]
        if wrong:
            raise ValueError(f"{name}: {shown(wrong[0])} is none of {', '.join(self.choices)}")
        if not value or len(set(value)) < len(value):
            raise ValueError(f"{name} are one or more different ones of {', '.join(self.choices)}")
        if self.needed and self.needed not in value:
            raise ValueError(f"{name} need {self.needed!r} among them, to compare with")
        return value

    def __str__(self) -> str:
        return f"{self.needed} and others by name" if self.needed else "one or more by name"


COUNT = Whole(1, 1_000_000)
"""Range of most numbers of things."""
SHARE = Real(0.0, 1.0)
WORKERS = Whole(1, 1024)
"""Range of numbers of threads and processes."""
SECONDS = Real(0.0, 1e9)

Count = Annotated[int, COUNT]
CountOrZero = Annotated[int, Whole(0, 1_000_000)]
STEPS = Whole(1, 10**12)
Steps = Annotated[int, STEPS]
StepsOrZero = Annotated[int, Whole(0, 10**12)]
Units = Annotated[int, Whole(1, 65_536)]
"""Size of a layer or a vector."""
UnitsOrZero = Annotated[int, Whole(0, 65_536)]
Threads = Annotated[int, WORKERS]
Share = Annotated[float, SHARE]
OpenShare = Annotated[float, Real(0.0, 1.0, above=True, below=True)]
LearningRate = Annotated[float, Real(0.0, 10.0, above=True)]
Weight = Annotated[float, Real(0.0, 1e6)]
"""Weight of a part of a loss."""
Factor = Annotated[float, Real(1e-6, 1e6)]
Seconds = Annotated[float, SECONDS]


def check_choice(name: str, value: str, choices: Collection[str]) -> str:
    """Return one of several words.

    Raises:
        ValueError: it is none of them.
    """
    if not isinstance(value, str) or value not in choices:
        raise ValueError(f"{name} is one of {', '.join(choices)}, not {shown(value)}")
    return value


def check_flag(name: str, value: bool) -> bool:
    """Return True or False of Python or NumPy.

    Raises:
        TypeError: it is neither.
    """
    if not isinstance(value, (bool, np.bool_)):
        raise TypeError(f"{name} is True or False, not {shown(value)}")
    return bool(value)


def check_power_of_two(name: str, value: int) -> int:
    """Return 1, 2, 4, 8 and so on, up to 1024.

    Raises:
        TypeError, ValueError: it is no such number.
    """
    if WORKERS(name, value).bit_count() != 1:
        raise ValueError(f"{name} is a power of two such as 2, 4 or 8, but got {value}")
    return int(value)


PowerOfTwo = Annotated[int, Check(check_power_of_two, "a power of two, 1 to 1024")]


def check_device(name: str, value: str) -> str:
    """Return auto, cpu, cuda, or cuda:N.

    Raises:
        ValueError: it is none of them. Whether there is such a device is known when a run starts.
    """
    if not isinstance(value, str) or not re.fullmatch(r"auto|cpu|cuda(:\d+)?", value):
        raise ValueError(f"{name} is auto, cpu, cuda or cuda:N, not {shown(value)}")
    return value


Device = Annotated[str, Check(check_device, "auto, cpu, cuda or cuda:N")]


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


def check_value(name: str, hint: Any, value: Any) -> Any:
    """Check a value by a type's annotation, and return it as it is to be kept.

    Looks into ``Annotated``, unions with None and tuples. Words of a ``Literal``, bools and
    dataclasses are checked too, everything else is kept as it is.

    Raises:
        TypeError, ValueError: it does not fit.
    """
    kind = get_origin(hint)
    if kind is Annotated:
        hint, *checks = get_args(hint)
        value = check_value(name, hint, value)
        for check in checks:
            value = check(name, value) if isinstance(check, Check) else value
        return value
    if kind is Literal:
        return check_choice(name, value, get_args(hint))
    if kind in (Union, UnionType):
        others = [each for each in get_args(hint) if each is not NoneType]
        only = len(others) == 1 and value is not None
        return check_value(name, others[0], value) if only else value
    if kind is tuple and any(allowed(part) for part in get_args(hint)):
        return _check_tuple(name, get_args(hint), value)
    if hint is bool:
        return check_flag(name, value)
    if is_dataclass(hint) and isinstance(hint, type) and not isinstance(value, hint):
        raise TypeError(f"{name} is a {hint.__name__}, not {shown(value)}")
    return value


def allowed(hint: Any) -> str:
    """Return what an annotation's checks allow, in words; empty if it has none."""
    kind, parts = get_origin(hint), get_args(hint)
    if kind is Annotated:
        own = [str(each) for each in parts[1:] if isinstance(each, Check)]
        return ", ".join(filter(None, [allowed(parts[0]), *own]))
    if kind is Literal:
        return ", ".join(map(str, parts))
    words = [allowed(part) for part in parts if part not in (NoneType, Ellipsis)]
    if not any(words):
        return ""
    if kind is tuple:
        return f"each {words[0]}" if Ellipsis in parts else f"({'; '.join(words)})"
    return " or ".join([*filter(None, words), *(["None"] if NoneType in parts else [])])


def _check_tuple(name: str, parts: tuple[Any, ...], value: Any) -> tuple[Any, ...]:
    if not isinstance(value, (tuple, list)):
        if str in get_args(parts[0])[:1]:
            raise TypeError(f"{name} takes a tuple of names, not {shown(value)}")
        raise TypeError(f"{name} is a tuple of numbers, not {shown(value)}")
    if parts[-1] is Ellipsis:
        return tuple(check_value(f"each of {name}", parts[0], each) for each in value)
    if len(value) != len(parts):
        raise ValueError(f"{name} has {len(parts)} numbers, but got {shown(value)}")
    return tuple(
        check_value(f"{name}[{k}]", part, each)
        for k, (part, each) in enumerate(zip(parts, value, strict=True))
    )


class Checked:
    """Base class of dataclasses that check their fields by their annotations."""

    def __post_init__(self) -> None:
        for name, hint in _hints(type(self)).items():  # type: ignore[arg-type]
            value = check_value(self._named(name), hint, getattr(self, name))
            object.__setattr__(self, name, value)

    def _named(self, field: str) -> str:
        """Return the name of a field in errors."""
        return field


@functools.cache
def _hints(kind: Any) -> dict[str, Any]:
    """Annotations of a dataclass's fields."""
    hints = get_type_hints(kind, include_extras=True)
    return {each.name: hints[each.name] for each in fields(kind) if each.init}
