"""Read files that others may have made: bounded in time and memory, with errors of one line.

Whatever a file holds, reading it raises ``ValueError`` or ``OSError``, which name the file. A pipe,
a device or a socket is refused without reading from it, sizes are checked before anything is read,
and JSON is bounded in its number of values and in its depth. Nothing is ever unpickled.
"""

from __future__ import annotations

import json
import math
import os
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from io import BufferedReader
from pathlib import Path
from typing import Any, TypeVar

from safetensors import SafetensorError

from hmi_marl.text import quoted

T = TypeVar("T")
JSON_BYTES = 16 * 2**20
"""Largest JSON file by default [bytes]; cards and settings have some thousands."""
MOST_VALUES = 2_000_000
"""Most values in JSON content by default: a few hundred MiB in Python."""
MOST_STATE_VALUES = 20_000_000
"""Most values in the state of a run, whose curve has a row for each batch."""
_MOST_DEPTH = 64
"""Most levels of JSON content, so that code which descends into it needs no check of its own."""
_MOST_DIGITS = 20
"""Digits of the largest whole number in JSON: seeds have up to 64 bits."""
_SAFE_OPENING = getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_NOCTTY", 0)
"""Flags that open a pipe without waiting for its writer; regular files don't notice."""


@contextmanager
def opened(path: Path) -> Iterator[BufferedReader]:
    """Open a regular file, or a link to one, for reading.

    Raises:
        OSError: it cannot be opened.
        ValueError: it is a pipe, a device or a socket.
    """
    with open(path, "rb", opener=lambda name, flags: os.open(name, flags | _SAFE_OPENING)) as file:
        if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            raise ValueError(f"{path} is a pipe, a device or a socket; name a regular file")
        yield file


def read_bytes(path: Path, limit: int) -> bytes:
    """Return the content of a regular file of at most ``limit`` bytes.

    Raises:
        OSError: it cannot be read.
        ValueError: no regular file, a larger one, or one that grows meanwhile.
    """
    with opened(path) as file:
        size = os.fstat(file.fileno()).st_size
        if size > limit:
            raise ValueError(f"{path} has {size} bytes, more than the {limit} that are read here")
        content = file.read(size + 1) or b""
    if len(content) > size:
        raise ValueError(f"{path} grows while it is read; try again when it is whole")
    return content


def read_json(path: Path, limit: int = JSON_BYTES, most_values: int = MOST_VALUES) -> Any:
    """Return the content of a JSON file of at most ``limit`` bytes.

    Raises:
        OSError: it cannot be read.
        ValueError: see :func:`read_bytes` and :func:`parse_json`.
    """
    content = read_bytes(path, limit)
    try:
        return parse_json(content, most_values)
    except ValueError as error:
        raise ValueError(f"{path} is no JSON file that can be read here: {error}") from None


def parse_json(content: bytes | str, most_values: int = MOST_VALUES) -> Any:
    """Return JSON content. All numbers in it are finite, and whole ones have up to 20 digits.

    Raises:
        ValueError: no JSON in UTF-8; ``NaN`` or ``Infinity``, which JSON does not have; a number
            out of range; too many values; or values nested too deeply.
    """
    text = content.decode("utf-8") if isinstance(content, bytes) else content
    # A value stands before a comma or a closing bracket, so there are no more than these.
    if text.count(",") + text.count("[") + text.count("{") >= most_values:
        raise ValueError(f"more than {most_values} values")
    try:
        found = json.loads(text, parse_float=_finite, parse_int=_whole, parse_constant=_refuse)
    except RecursionError:
        found = _TOO_DEEP
    if found is _TOO_DEEP or not _is_shallow(found):
        raise ValueError(f"values nested more than {_MOST_DEPTH} levels deep")
    return found


def parse_tensors(
    content: bytes, load: Callable[[bytes], dict[str, T]], most_values: int = MOST_VALUES
) -> tuple[dict[str, str], dict[str, T]]:
    """Return metadata and tensors of a safetensors file.

    Args:
        content: the file.
        load: ``safetensors.numpy.load`` or ``safetensors.torch.load``.
        most_values: see :func:`parse_json`; of the header.

    Raises:
        ValueError: it is no such file, or a damaged one.
    """
    size = int.from_bytes(content[:_HEADER_AT], "little")
    if not 2 <= size <= len(content) - _HEADER_AT:
        raise ValueError("cut off, or something else")
    header = parse_json(content[_HEADER_AT : _HEADER_AT + size], most_values)
    metadata = header.get("__metadata__", {}) if isinstance(header, dict) else None
    if not isinstance(metadata, dict) or not all(isinstance(v, str) for v in metadata.values()):
        raise ValueError("its header is something else")
    try:
        return metadata, load(content)
    except (SafetensorError, AttributeError, KeyError, TypeError) as error:
        # The last three: numbers of a type that NumPy or torch does not have.
        raise ValueError(quoted(error)) from None


_HEADER_AT = 8
"""Bytes before the header of a safetensors file, which hold its size."""
_TOO_DEEP = object()


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{text[:_MOST_DIGITS]} is out of range")
    return value


def _whole(text: str) -> int:
    if len(text.lstrip("-")) > _MOST_DIGITS:
        raise ValueError(f"a whole number of more than {_MOST_DIGITS} digits")
    return int(text)


def _refuse(name: str) -> float:
    raise ValueError(f"{name} is no number in JSON")


def _is_shallow(content: Any) -> bool:
    level = [content] if isinstance(content, (dict, list)) else []
    for _ in range(_MOST_DEPTH):
        values = (each.values() if isinstance(each, dict) else each for each in level)
        level = [item for items in values for item in items if isinstance(item, (dict, list))]
        if not level:
            return True
    return False
