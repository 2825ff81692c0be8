"""What was learned, in files: a JSON card beside safetensors weights. Nothing is ever unpickled."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load as load_tensors
from safetensors.numpy import save as save_tensors

from hmi_marl.agents.learned.network import Weights
from hmi_marl.agents.learned.shipped import find_shipped, is_shipped
from hmi_marl.files import write_bytes, write_json

Shapes = Mapping[str, tuple[int, ...]]


def check_shapes(shapes: Shapes, weights: Weights, what: str) -> None:
    """Raise ``ValueError`` unless these are weights of these names and shapes, all finite."""
    if set(weights) != set(shapes):
        odd = sorted(set(weights) ^ set(shapes))
        raise ValueError(f"the weights do not fit the {what}'s card: {', '.join(odd)}")
    for name, shape in shapes.items():
        if weights[name].shape != shape:
            raise ValueError(f"{name} has shape {weights[name].shape}, but the card says {shape}")
        if not np.isfinite(weights[name]).all():
            raise ValueError(f"{name} is not finite everywhere")


def write_card(path: Path, form: str, card: dict[str, Any], weights: Weights) -> Path:
    """Write the weights beside ``path``, and there the card with their checksum.

    Args:
        path: of the card, a ``.json``.
        form: the format's name, which :func:`read_card` asks for.
        card: what the weights are, as JSON has it.
        weights: kept in single precision.
    """
    content = save_tensors(
        {name: np.asarray(values, np.float32, order="C") for name, values in weights.items()}
    )
    write_bytes(path.with_suffix(".safetensors"), content)
    about = {"format": form, "sha256": hashlib.sha256(content).hexdigest()}
    write_json(path, about | card)
    return path


def read_card(path: Path, form: str, what: str) -> dict[str, Any]:
    """A card as it was written, with ``sha256`` of its weights; nothing else in it is checked.

    Raises:
        FileNotFoundError: no such file.
        ValueError: no card of this format.
    """
    try:
        content: Any = json.loads(path.read_text(encoding="utf-8"))
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise ValueError(f"{path} is no JSON file: {error}") from None
    found = content.get("format") if isinstance(content, dict) else None
    if found != form:
        raise ValueError(f"{path} is not a {what} that can be read here: format {found!r}")
    return dict(content)


def find_card(place: str | Path, kind: str, what: str, remedy: str) -> Path:
    """The card of a model: in a run's folder, the file itself, or one that comes with the package.

    Args:
        place: the run's folder, the ``.json`` itself, or ``trained:NAME``.
        kind: the card's name without its suffix.
        what: the model is.
        remedy: the command that learns one.

    Raises:
        FileNotFoundError: there is none.
        ValueError: see :func:`hmi_marl.agents.learned.shipped.find_shipped`.
    """
    path = find_shipped(place, kind) if is_shipped(place) else Path(place)
    path = path / f"{kind}.json" if path.is_dir() else path
    if not path.is_file():
        raise FileNotFoundError(f"no {what} at {place}; learn one with {remedy}")
    return path


def read_weights(path: Path, digest: str) -> dict[str, NDArray[np.float32]]:
    """The weights beside a card.

    Args:
        path: of the card.
        digest: the checksum that it tells.

    Raises:
        FileNotFoundError: they are not there.
        ValueError: other weights than the card was written with, or damaged ones.
    """
    weights_path = path.with_suffix(".safetensors")
    try:
        content = weights_path.read_bytes()
    except FileNotFoundError:
        raise FileNotFoundError(f"{path} has lost its weights, {weights_path.name}") from None
    if hashlib.sha256(content).hexdigest() != digest:
        raise ValueError(f"{weights_path} is not the file that {path.name} was written with")
    try:
        return load_tensors(content)
    except (SafetensorError, KeyError) as error:  # KeyError: of numbers that NumPy does not know
        raise ValueError(f"{weights_path} is no safetensors file: {error}") from None
