"""Dataclasses from JSON content, checked by the types of their fields.

A field's type says what its JSON value must be: ``int`` a whole number (``true`` is none),
``float`` a finite number, ``tuple[X, ...]`` a list, ``bytes`` a text in base64, a dataclass a
mapping with exactly its fields. Ranges are checked by the dataclass, in ``__post_init__``.
"""

from __future__ import annotations

import math
import types
from base64 import b64decode
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from enum import StrEnum
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from hmi_marl.checks import check_choice, shown

T = TypeVar("T")


def read_as(kind: type[T], content: Any) -> T:
    """Make an instance of a dataclass from JSON content.

    Raises:
        ValueError: a field is missing, unknown, of another type, or out of its range; the message
            names it.
    """
    return _dataclass(kind, content, "")


def read_value(hint: Any, content: Any, name: str) -> Any:
    """Return JSON content as a value of the type ``hint``; lists become tuples where it says so.

    Raises:
        ValueError: it is of another type; the message calls it ``name``.
    """
    if hint is Any:
        return content
    if isinstance(hint, type) and is_dataclass(hint):
        return _dataclass(hint, content, name)
    if hint in _SIMPLE:
        what, fits = _SIMPLE[hint]
        if not fits(content):
            raise _wrong(name, what, content)
        return float(content) if hint is float else content
    if hint is bytes:
        return _bytes(content, name)
    if isinstance(hint, type) and issubclass(hint, StrEnum):
        return hint(check_choice(name, content, list(hint)))
    origin, arguments = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        return _one_of(arguments, content, name)
    if origin is Literal:
        return check_choice(name, content, arguments)
    if origin in (tuple, list, Sequence):
        return _several(origin, arguments, content, name)
    if hint is dict or origin in (dict, Mapping):
        if not isinstance(content, dict):
            raise _wrong(name, "a mapping", content)
        kind = arguments[1] if arguments else Any
        return {key: read_value(kind, value, f"{name}.{key}") for key, value in content.items()}
    raise TypeError(f"cannot read {name} of type {hint} from JSON")


def _dataclass(kind: type[T], content: Any, name: str) -> T:
    if not isinstance(content, dict):
        raise _wrong(name or "it", "a mapping", content)
    wanted = [field.name for field in fields(kind)]  # type: ignore[arg-type]
    if missing := [each for each in wanted if each not in content]:
        raise ValueError(f"{name or 'it'} lacks {', '.join(missing)}")
    if foreign := [each for each in content if each not in wanted]:
        raise ValueError(f"{name or 'it'} has unknown fields: {shown(foreign)}")
    hints, start = get_type_hints(kind), f"{name}." if name else ""
    values = {each: read_value(hints[each], content[each], start + each) for each in wanted}
    try:
        return kind(**values)
    except TypeError as error:
        raise ValueError(str(error)) from None


def _one_of(hints: tuple[Any, ...], content: Any, name: str) -> Any:
    hints = tuple(hint for hint in hints if get_origin(hint) is not Callable)  # none is in JSON
    for hint in hints:
        try:
            return read_value(hint, content, name)
        except ValueError as error:
            last = error
    if all(hint in _SIMPLE for hint in hints):
        raise _wrong(name, " or ".join(_SIMPLE[hint][0] for hint in hints), content)
    raise last


def _several(kind: Any, hints: tuple[Any, ...], content: Any, name: str) -> Any:
    if not isinstance(content, list):
        raise _wrong(name, "a list", content)
    if kind is not tuple or hints[-1] is Ellipsis:
        hints = (hints[0],) * len(content)
    if len(hints) != len(content):
        raise _wrong(name, f"a list of {len(hints)} items", content)
    items = zip(hints, content, strict=True)
    made = tuple if kind is tuple else list
    return made(read_value(hint, item, f"{name}[{k}]") for k, (hint, item) in enumerate(items))


def _bytes(content: Any, name: str) -> bytes:
    try:
        return b64decode(content, validate=True)
    except (TypeError, ValueError):
        raise _wrong(name, "bytes in base64", content) from None


def _wrong(name: str, what: str, content: Any) -> ValueError:
    return ValueError(f"{name} is {what}, not {shown(content)}")


def _is_whole(content: Any) -> bool:
    return isinstance(content, int) and not isinstance(content, bool)


def _is_number(content: Any) -> bool:
    return _is_whole(content) or (isinstance(content, float) and math.isfinite(content))


_SIMPLE: dict[Any, tuple[str, Callable[[Any], bool]]] = {
    bool: ("true or false", lambda content: isinstance(content, bool)),
    int: ("a whole number", _is_whole),
    float: ("a finite number", _is_number),
    str: ("a text", lambda content: isinstance(content, str)),
    type(None): ("null", lambda content: content is None),
}
