"""Mutations of files, to try readers with: of their bytes, and of JSON in them.

``hostile(content, seed)`` changes bytes; ``hostile_json(value, seed)`` changes one place in JSON
content. Both follow from the seed. ``try_reader`` counts what a reader does with a mutated file,
and ``contents`` compares what it reads.
"""

from __future__ import annotations

import copy
import json
import random
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

REFUSED, READ, WRONG = "refused", "read", "wrong"
"""Outcomes: an error that a reader may raise, none, or another error."""
MOST_SECONDS = 2.0


def hostile(content: bytes, seed: int) -> bytes:
    """Flip bits, cut, insert, repeat, overwrite or swap parts of a file."""
    rng, changed = random.Random(seed), bytearray(content)
    for _ in range(rng.choice((1, 1, 1, 2, 8))):
        at = rng.randrange(len(changed) + 1)
        length = rng.choice((1, 2, 4, 8, 64, 1024))
        match rng.randrange(7):
            case 0 | 1 if at < len(changed):
                changed[at] ^= 1 << rng.randrange(8)
            case 2:
                del changed[at : at + length]
            case 3:
                changed[at:at] = rng.randbytes(length)
            case 4:
                changed[at:at] = changed[max(0, at - length) : at] * rng.choice((1, 3, 50))
            case 5:
                changed[at : at + length] = bytes([rng.choice((0, 0x7F, 0xFF))]) * length
            case _:
                del changed[at:]
    return bytes(changed)


DEEP: Any = "[" * 100_000 + "]" * 100_000
"""Written into JSON as it stands."""
RAW = (
    DEEP,
    "[" * 70 + "]" * 70,
    '{"a":' * 500 + "1" + "}" * 500,
    "Infinity",
    "-Infinity",
    "NaN",
    "1e999",
    "-1" + "0" * 400,
    "1" * 5000,
    "[" + "0," * 300_000 + "0]",
    '"' + "x" * 1_000_000 + '"',
    '"\\ud800"',
    '"\\u0000\\n\\u001b[31m"',
)
"""JSON, or nearly, for one value."""
VALUES = (
    None,
    True,
    0,
    -1,
    2**31,
    2**63,
    10**9,
    1.5,
    -0.0,
    1e308,
    "",
    "x",
    "../../etc/passwd",
    "/dev/zero",
    [],
    [[]],
    [1],
    ["x", -1],
    {},
    {"": None},
    {"x": {"y": [1]}},
)


def hostile_json(value: Any, seed: int) -> str:
    """Change one place of JSON content: another value, a missing, another or a repeated key."""
    rng, changed = random.Random(seed), copy.deepcopy(value)
    holder, key = rng.choice(list(_places(changed)))
    mark = "hostile value"
    match rng.randrange(6):
        case 0:
            del holder[key]
        case 1 if isinstance(holder, dict):
            holder[str(key) + "x"] = holder.pop(key)
        case 2:
            holder[key] = [holder[key], holder[key]]
        case 3:
            holder[key] = mark
        case _:
            holder[key] = rng.choice(VALUES)
    return json.dumps(changed).replace(f'"{mark}"', rng.choice(RAW))


def _places(value: Any) -> Iterator[tuple[Any, Any]]:
    """Every place in JSON content, as its container and key or index."""
    items = value.items() if isinstance(value, dict) else enumerate(value)
    for key, item in list(items):
        yield value, key
        if isinstance(item, (dict, list)):
            yield from _places(item)


def contents(value: object) -> object:
    """Everything in what a reader returned, for comparison: a whole tree, with bytes of arrays."""
    if isinstance(value, Mapping):
        return {key: contents(each) for key, each in value.items()}
    if isinstance(value, (list, tuple)):
        return [contents(each) for each in value]
    if is_dataclass(value) and not isinstance(value, type):
        return {each.name: contents(getattr(value, each.name)) for each in fields(value)}
    if hasattr(value, "detach"):  # a tensor
        value = value.detach().numpy()
    if isinstance(value, np.ndarray):
        return str(value.dtype), value.shape, value.tobytes()
    return repr(value)


def try_reader(
    read: Callable[[], object],
    mutate: Callable[[int], object],
    seeds: range,
    original: object = None,
) -> tuple[Counter[str], list[str]]:
    """Let a reader read mutated files; return the numbers of outcomes, and what went wrong.

    Args:
        read: reads the file.
        mutate: writes the mutated file of a seed.
        seeds: mutations to try.
        original: ``contents`` of the unaltered file, which is all that may be read; None if what is
            in it may have changed.
    """
    counts: Counter[str] = Counter()
    wrong = []
    for seed in seeds:
        mutate(seed)
        began = time.monotonic()
        try:
            found = read()
            if original is not None and contents(found) != original:
                raise AssertionError("other content was read")
            counts[READ] += 1
        except (ValueError, OSError) as error:
            outcome = REFUSED if "\n" not in str(error) and len(str(error)) < 2000 else WRONG
            counts[outcome] += 1
            if outcome == WRONG:
                wrong.append(f"mutation {seed}: message of {len(str(error))}: {error!s:.300}")
        except BaseException as error:
            if isinstance(error, KeyboardInterrupt):
                raise
            counts[WRONG] += 1
            wrong.append(f"mutation {seed}: {error!r:.300}")
        if (spent := time.monotonic() - began) > MOST_SECONDS:
            counts[WRONG] += 1
            wrong.append(f"mutation {seed}: {spent:.1f} s")
    return counts, wrong
