"""State of a run in a file, to resume it from.

A checkpoint is one safetensors file. Its metadata hold JSON: the state's numbers, the digest of the
run's settings, and a SHA-256 checksum over the whole file, in which the checksum's own digits count
as zeros. So a single changed bit is found, and a checkpoint of another run is not taken.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import load as load_tensors
from safetensors.torch import save as save_tensors

from hmi_marl.checks import Checked, CountOrZero, Seconds, StepsOrZero
from hmi_marl.files import write_bytes
from hmi_marl.reading import MOST_STATE_VALUES, parse_json, parse_tensors, read_bytes
from hmi_marl.text import quoted
from hmi_marl.training.runs.folder import Row
from hmi_marl.typed_json import read_as

FORMAT = "hmi-marl checkpoint 2"
_KEY = "hmi_marl"
"""Name of the JSON in the file's metadata."""
_MOST_BYTES = 4 * 2**30
_NO_DIGEST = "0" * 64
_DIGEST = re.compile(rb'sha256\\": \\"([0-9a-f]{64})\\"')
"""The checksum as it stands in the file, JSON within JSON."""
_DIGEST_BEFORE = 512
"""The checksum stands within so many bytes from the start of the file."""


@dataclass
class Checkpoint:
    """State of a run: one safetensors file with JSON in its header, written atomically."""

    phase: int = 0
    """Index of the current phase; the number of phases if the run is finished."""
    iteration: int = 0
    """Batches learned from in that phase."""
    steps: int = 0
    """Environment steps taken in the whole run, over all processes."""
    seconds: float = 0.0
    """Time spent in the whole run [s]."""
    tensors: dict[str, dict[str, torch.Tensor]] = field(default_factory=dict)
    """Weights and optimizer's state of each learner, by its name."""
    curve: list[dict[str, Any]] = field(default_factory=list)
    """A row for each batch."""
    settings: str = ""
    """Digest of the run's settings; see :func:`hmi_marl.training.runs.folder.settings_digest`."""

    def save(self, path: Path) -> None:
        """Write the state, atomically."""
        flat = {
            f"{learner}/{name}": tensor.detach().cpu().contiguous()
            for learner, tensors in self.tensors.items()
            for name, tensor in tensors.items()
        }
        numbers = {name: getattr(self, name) for name in _NUMBERS}
        header = asdict(_Header(format=FORMAT, sha256=_NO_DIGEST, **numbers))
        content = save_tensors(flat, {_KEY: json.dumps(header, allow_nan=False)})
        found = _DIGEST.search(content, 0, _DIGEST_BEFORE)
        assert found is not None
        digest = _digest(content, found.start(1))
        write_bytes(path, content[: found.start(1)] + digest + content[found.end(1) :])

    @classmethod
    def load(cls, path: Path, settings: str | None = None, phases: int | None = None) -> Checkpoint:
        """Read a state.

        Args:
            path: file that :meth:`save` wrote.
            settings: digest of the settings of the run that is to be resumed; None for any run.
            phases: number of its phases; None for any number.

        Raises:
            OSError: the file cannot be read.
            ValueError: it is damaged, no such checkpoint, or one of another run.
        """
        content = read_bytes(path, _MOST_BYTES)
        try:
            header, tensors = _read(content)
        except ValueError as error:
            raise ValueError(
                f"{path} is a damaged checkpoint: {error}; remove its folder, and run again"
            ) from None
        if header is None:
            raise ValueError(
                f"{path} is not a checkpoint that can be read here; remove its folder, and run "
                "again, or resume it by the version of hmi-marl that wrote it"
            )
        if settings is not None and header.settings != settings:
            raise ValueError(
                f"{path} is the checkpoint of a run with other settings than the run.json beside "
                "it; remove the folder, and run again"
            )
        if phases is not None and header.phase > phases:
            raise ValueError(
                f"{path} is a damaged checkpoint: phase {header.phase} of {phases}; remove its "
                "folder, and run again"
            )
        return cls(tensors=tensors, **{name: getattr(header, name) for name in _NUMBERS})


@contextmanager
def fitting(path: Path) -> Iterator[None]:
    """Restore something from the checkpoint at ``path`` within; ValueError if it does not fit."""
    try:
        yield
    except (IndexError, KeyError, RuntimeError, TypeError, ValueError) as error:
        reason = quoted(error)
        raise ValueError(
            f"{path} is a damaged checkpoint, which does not fit this run: {reason}"
        ) from error


@dataclass(frozen=True)
class _Header(Checked):
    """Everything but the tensors."""

    format: str
    sha256: str
    settings: str
    phase: CountOrZero
    iteration: StepsOrZero
    steps: StepsOrZero
    seconds: Seconds
    curve: list[Row]


_NUMBERS = ("settings", "phase", "iteration", "steps", "seconds", "curve")


def _read(content: bytes) -> tuple[_Header | None, dict[str, dict[str, torch.Tensor]]]:
    """Read header and tensors; no header if it is a whole file, but no such checkpoint."""
    place = _DIGEST.search(content, 0, _DIGEST_BEFORE)
    if place and _digest(content, place.start(1)) != place[1]:  # before anything is made of it
        raise ValueError("its checksum differs")
    metadata, flat = parse_tensors(content, load_tensors, MOST_STATE_VALUES)
    found = parse_json(metadata.get(_KEY, "{}"), MOST_STATE_VALUES)
    if not isinstance(found, dict) or found.get("format") != FORMAT:
        return None, {}
    header = read_as(_Header, found)
    if place is None:
        raise ValueError("it has no checksum")
    tensors: dict[str, dict[str, torch.Tensor]] = {}
    for full_name, tensor in flat.items():
        learner, slash, name = full_name.partition("/")
        if not slash:
            raise ValueError(f"tensor {full_name!r} belongs to no learner")
        tensors.setdefault(learner, {})[name] = tensor
    return header, tensors


def _digest(content: bytes, at: int) -> bytes:
    """SHA-256 of the content with zeros in place of the digits at ``at``, in hexadecimal."""
    digest, view = hashlib.sha256(), memoryview(content)
    for part in (view[:at], _NO_DIGEST.encode(), view[at + len(_NO_DIGEST) :]):
        digest.update(part)
    return digest.hexdigest().encode()
