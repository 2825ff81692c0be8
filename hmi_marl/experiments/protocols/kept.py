"""Results of playing, kept in the folder of a comparison, so that nothing is played twice.

What policies earn depends on their weights, the episodes, the settings of the teams and the code.
A file is named by a digest of all of these (its key), so a result is found again exactly as long as
none of them has changed.
"""

from __future__ import annotations

import json
import math
import types
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray
from safetensors.numpy import load, save

import hmi_marl
from hmi_marl.files import json_digest, make_folder, sha256, sha256_of, write_bytes
from hmi_marl.reading import parse_json, parse_tensors, read_bytes
from hmi_marl.workers import results

T = TypeVar("T")
R = TypeVar("R")
Key = Mapping[str, Any]
"""What a result depends on besides the code, as JSON content."""
FOLDER = "played"
_SUFFIX = ".played"
_MOST = 2**27
"""Bytes that are read at most."""


@dataclass(frozen=True)
class Kept:
    """Results that were kept.

    Args:
        folder: their folder, made when it is needed.
        kind: type of the results: numbers, texts, arrays, and dataclasses or mappings of these.
    """

    folder: Path
    kind: Any

    def find(self, key: Key) -> Any:
        """Return the result of this key; None if there is none, or its file is damaged."""
        path = self._path(key)
        if not path.exists():
            return None
        try:
            metadata, arrays = parse_tensors(read_bytes(path, _MOST), load)
            return _decoded(self.kind, parse_json(metadata["result"]), arrays)
        except (KeyError, OSError, TypeError, ValueError):
            return None

    def keep(self, key: Key, result: Any) -> None:
        """Keep a result, in place of an earlier one."""
        arrays: dict[str, NDArray[Any]] = {}
        content = json.dumps(_encoded(result, arrays))
        make_folder(self.folder)
        write_bytes(self._path(key), save(arrays, {"result": content}))

    def _path(self, key: Key) -> Path:
        return self.folder / (json_digest({"code": code_digest(), "key": key})[:40] + _SUFFIX)


def play_once(
    kept: Kept,
    play: Callable[[T], R],
    tasks: Sequence[T],
    keys: Sequence[Key],
    workers: int,
) -> Iterator[R]:
    """Yield what ``play`` returns for each task, in order; what was kept is not played again.

    Args:
        kept: where results are found, and kept as soon as they are there.
        play: see :func:`hmi_marl.workers.results`.
        tasks: what to play.
        keys: what the result of each depends on.
        workers: processes at a time.
    """
    known = [kept.find(key) for key in keys]
    missing = [task for task, result in zip(tasks, known, strict=True) if result is None]
    played = iter(results(play, missing, workers) if missing else ())
    for key, result in zip(keys, known, strict=True):
        if result is None:
            found = next(played)
            kept.keep(key, found)
            yield found
        else:
            yield result


def weights_key(place: str, seat: str) -> str:
    """Return the checksum of a run's policy in a seat, or the name if it is of the catalogue."""
    files = [Path(place) / f"{seat}.{suffix}" for suffix in ("json", "safetensors")]
    return "".join(map(sha256_of, files)) if files[0].is_file() else place


@cache
def code_digest() -> str:
    """SHA-256 of all modules of this package, by their names and contents."""
    root = Path(hmi_marl.__file__).parent
    listed = {path.relative_to(root).as_posix(): path for path in root.rglob("*.py")}
    return json_digest({name: sha256(path.read_bytes()) for name, path in listed.items()})


def _encoded(value: Any, arrays: dict[str, NDArray[Any]]) -> Any:
    """JSON content of a result, whose arrays are put among ``arrays``."""
    if is_dataclass(value) and not isinstance(value, type):
        return {each.name: _encoded(getattr(value, each.name), arrays) for each in fields(value)}
    if isinstance(value, Mapping):
        return {key: _encoded(item, arrays) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        name = str(len(arrays))
        arrays[name] = np.ascontiguousarray(value)
        return name
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else repr(float(value))
    return value.item() if isinstance(value, np.generic) else value


def _decoded(hint: Any, content: Any, arrays: Mapping[str, NDArray[Any]]) -> Any:
    """Result of the type ``hint`` from what :func:`_encoded` returned."""
    origin, arguments = get_origin(hint), get_args(hint)
    if isinstance(hint, type) and is_dataclass(hint):
        hints = get_type_hints(hint)
        return hint(**{name: _decoded(hints[name], content[name], arrays) for name in content})
    if origin in (Union, types.UnionType):
        (kind,) = (each for each in arguments if each is not types.NoneType)
        return None if content is None else _decoded(kind, content, arrays)
    if origin is np.ndarray:
        return arrays[content]
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return {key: _decoded(arguments[1], item, arrays) for key, item in content.items()}
    return hint(content)
