"""Results of playing, kept in the folder of a comparison, so that nothing is played twice.

What policies earn depends on their weights, the episodes, the settings of the teams, the code, and
the libraries that it calls. A file is named by a digest of all of these (its key), so a result is
found again exactly as long as none of them has changed. The kind of processor is no part of
it, though the last bit of a network's outputs may depend on them.

Files of other code, which nothing reads any more, lie in a folder of their own. All may be deleted.
"""

from __future__ import annotations

import json
import math
import platform
import types
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from functools import cache, partial
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray
from safetensors.numpy import load, save

import hmi_marl
from hmi_marl.agents.catalogue import learned_file, mixed_names
from hmi_marl.checks import shown
from hmi_marl.files import json_digest, make_folder, sha256, sha256_of, write_bytes
from hmi_marl.reading import parse_json, parse_tensors, read_bytes
from hmi_marl.workers import results

T = TypeVar("T")
R = TypeVar("R")
Key = Mapping[str, Any]
"""What a result depends on besides code and libraries, as JSON content."""
FOLDER = "played"
_SUFFIX = ".played"
_DIGITS = 64
"""Of the checksum with which a file begins."""
_MOST = 2**27
"""Bytes that are read at most."""


@dataclass(frozen=True)
class Kept:
    """Results that were kept.

    Args:
        folder: their folder, made when it is needed.
        kind: type of the results: float, int, str, arrays, and dataclasses or mappings from str to
            these.
    """

    folder: Path
    kind: Any

    def find(self, key: Key) -> Any:
        """Return the result of this key; None if there is none, or its file is damaged."""
        try:
            return self.read(key)
        except (OSError, ValueError):
            return None

    def read(self, key: Key) -> Any:
        """Return the result of this key.

        Raises:
            OSError: there is none.
            ValueError: its file is damaged, or of another key or kind.
        """
        path = self._path(key)
        content = read_bytes(path, _MOST)
        checksum, content = content[:_DIGITS], content[_DIGITS:]
        if sha256(content).encode() != checksum:
            raise ValueError(f"{path} is damaged: its checksum differs")
        metadata, arrays = parse_tensors(content, load)
        if metadata.get("key") != _digest(key):
            raise ValueError(f"{path} is of another key")
        try:
            return _decoded(self.kind, parse_json(metadata["result"]), arrays)
        except (KeyError, TypeError) as error:
            raise ValueError(f"{path} is of another kind: {error}") from None

    def keep(self, key: Key, result: Any) -> None:
        """Keep a result, in place of an earlier one.

        Nothing is kept where the code has been edited since it was loaded: by which code the result
        was played is not known then.
        """
        if _digest_of_code() != code_digest():
            return
        path, arrays = self._path(key), dict[str, NDArray[Any]]()
        metadata = {"key": _digest(key), "result": json.dumps(_encoded(result, arrays))}
        content = save(arrays, metadata)
        make_folder(path.parent)
        write_bytes(path, sha256(content).encode() + content)

    def _path(self, key: Key) -> Path:
        return self.folder / code_digest()[:12] / (_digest(key)[:32] + _SUFFIX)


def play_once(
    kept: Kept,
    play: Callable[[T], R],
    tasks: Sequence[T],
    keys: Sequence[Key],
    workers: int,
) -> Iterator[R]:
    """Yield what ``play`` returns for each task, in order; what was kept is not played again.

    Args:
        kept: where results are found, and kept by the process that played them, at once.
        play: see :func:`hmi_marl.workers.results`.
        tasks: what to play.
        keys: what the result of each depends on.
        workers: processes at a time.
    """
    known = [kept.find(key) for key in keys]
    missing = [
        (task, key) for task, key, found in zip(tasks, keys, known, strict=True) if found is None
    ]
    played = iter(results(partial(_play_and_keep, kept, play), missing, workers))
    for found in known:
        yield next(played) if found is None else found
    assert next(played, None) is None  # which also ends the processes


def _play_and_keep(kept: Kept, play: Callable[[T], R], what: tuple[T, Key]) -> R:
    task, key = what
    result = play(task)
    kept.keep(key, result)
    return result


def weights_key(name: str, seat: str) -> str:
    """Return checksums of a policy's card and weights; the name itself of one without weights.

    Raises:
        FileNotFoundError, ValueError: a learned policy that cannot be found, or a mixture.
    """
    if mixed_names(name):
        raise ValueError(f"what {name} earns is not kept: it depends on several files")
    weights = learned_file(name, seat)
    if weights is None:
        return name
    return sha256_of(weights.with_suffix(".json")) + sha256_of(weights)


@cache
def code_digest() -> str:
    """SHA-256 of this package's modules as this process has found them, and of the libraries."""
    return _digest_of_code()


def _digest_of_code() -> str:
    root = Path(hmi_marl.__file__).parent
    modules = {path.relative_to(root).as_posix(): path for path in root.rglob("*.py")}
    return json_digest(
        {
            "modules": {name: sha256(path.read_bytes()) for name, path in modules.items()},
            "libraries": [np.__version__, version("numba")],  # which is slow to import
            "python": [platform.python_version(), platform.machine()],
        }
    )


def _digest(key: Key) -> str:
    return json_digest({"code": code_digest(), "key": key})


def _encoded(value: Any, arrays: dict[str, NDArray[Any]]) -> Any:
    """JSON content of a result, whose arrays are put among ``arrays``."""
    if is_dataclass(value) and not isinstance(value, type):
        return {each.name: _encoded(getattr(value, each.name), arrays) for each in fields(value)}
    if isinstance(value, Mapping) and all(isinstance(key, str) for key in value):
        return {key: _encoded(item, arrays) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        name = str(len(arrays))
        arrays[name] = np.asarray(value, order="C")
        return name
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else repr(float(value))
    if value is None or (isinstance(value, (int, str)) and not isinstance(value, bool)):
        return value
    raise TypeError(f"a result of type {type(value).__name__} is not kept")


def _decoded(hint: Any, content: Any, arrays: Mapping[str, NDArray[Any]]) -> Any:
    """Result of the type ``hint`` from what :func:`_encoded` returned; or TypeError, KeyError."""
    origin, arguments = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType) and arguments[-1] is types.NoneType:
        return None if content is None else _decoded(arguments[0], content, arrays)
    if origin is np.ndarray and isinstance(content, str):
        return arrays[content]
    if isinstance(content, dict):
        if isinstance(hint, type) and is_dataclass(hint):
            hints, names = get_type_hints(hint), [each.name for each in fields(hint)]
            if list(content) != names:
                raise TypeError(f"{hint.__name__} has other fields")
            return hint(**{name: _decoded(hints[name], content[name], arrays) for name in names})
        if isinstance(origin, type) and issubclass(origin, Mapping):
            return {key: _decoded(arguments[1], item, arrays) for key, item in content.items()}
    if hint is float and (isinstance(content, float) or content in _NOT_FINITE):
        return float(content)
    if hint in (int, str) and type(content) is hint:
        return content
    raise TypeError(f"{shown(content)} is not of type {hint}")


_NOT_FINITE = ("nan", "inf", "-inf")
