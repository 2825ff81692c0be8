"""Learned policies in files: a JSON card beside safetensors weights. Nothing is ever unpickled."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load as load_tensors
from safetensors.numpy import save as save_tensors

from hmi_marl.agents.learned import LearnedPolicy, PolicyCard, check_weights
from hmi_marl.agents.network import NetworkConfig, Weights
from hmi_marl.envs.config import AGENTS, TeamConfig
from hmi_marl.files import write_bytes, write_json

FORMAT = "hmi-marl policy 1"


def save_policy(folder: Path, card: PolicyCard, weights: Weights) -> Path:
    """Write ``<seat>.safetensors`` and ``<seat>.json`` into ``folder``; returns the latter.

    Raises:
        ValueError: weights that do not fit the card.
    """
    check_weights(card, weights)
    content = save_tensors(
        {name: np.ascontiguousarray(weights[name], np.float32) for name in card.shapes}
    )
    path = folder / f"{card.seat}.json"
    write_bytes(path.with_suffix(".safetensors"), content)
    about = {"format": FORMAT, "sha256": hashlib.sha256(content).hexdigest()}
    write_json(path, about | asdict(card))
    return path


def find_policy(place: Path, seat: str) -> Path:
    """The card of the seat's policy: in a run's folder, or the file itself.

    Raises:
        FileNotFoundError: there is none; the message says what is there.
    """
    path = place / f"{seat}.json" if place.is_dir() else place
    if path.suffix == ".safetensors":
        path = path.with_suffix(".json")
    if not path.is_file():
        there = [agent for agent in AGENTS if (place / f"{agent}.json").is_file()]
        found = f"; it holds one for {' and '.join(there)}" if there else ""
        raise FileNotFoundError(f"no policy for the seat of {seat} at {place}{found}")
    return path


def read_policy(path: Path) -> tuple[PolicyCard, dict[str, NDArray[np.float32]]]:
    """A policy's card and weights.

    Raises:
        FileNotFoundError: no such file.
        ValueError: not a policy of ours, of a later format, damaged, or altered since it was
            written; the message says which.
    """
    card, digest = _read_card(path)
    weights_path = path.with_suffix(".safetensors")
    try:
        content = weights_path.read_bytes()
    except FileNotFoundError:
        raise FileNotFoundError(f"{path} has lost its weights, {weights_path.name}") from None
    if hashlib.sha256(content).hexdigest() != digest:
        raise ValueError(f"{weights_path} is not the file that {path.name} was written with")
    try:
        weights = load_tensors(content)
    except (SafetensorError, KeyError) as error:  # KeyError: of numbers that NumPy does not know
        raise ValueError(f"{weights_path} is no safetensors file: {error}") from None
    try:
        check_weights(card, weights)
    except ValueError as error:
        raise ValueError(f"{weights_path}: {error}") from None
    return card, weights


def _read_card(path: Path) -> tuple[PolicyCard, str]:
    try:
        content: Any = json.loads(path.read_text(encoding="utf-8"))
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise ValueError(f"{path} is no JSON file: {error}") from None
    form = content.get("format") if isinstance(content, dict) else None
    if form != FORMAT:
        raise ValueError(f"{path} is not a policy that can be read here: format {form!r}")
    try:
        fields = {name: content[name] for name in PolicyCard.__dataclass_fields__}
        fields["network"] = NetworkConfig(**fields["network"])
        return PolicyCard(**fields), str(content["sha256"])
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path} is a damaged policy card: {error}") from None


def load_policy(
    place: str | Path, seat: str, config: TeamConfig, greedy: bool = True
) -> LearnedPolicy:
    """The policy that a run learnt for a seat, ready to sit there.

    Args:
        place: a run's folder, or a policy's ``.json``.
        seat: "driver" or "vehicle_ai".
        config: of the teams it will act in.
        greedy: take the likeliest action, else draw.

    Raises:
        FileNotFoundError, ValueError: see :func:`find_policy` and :func:`read_policy`; also a
            policy for the other seat, or one that reads what is not shown here.
    """
    path = find_policy(Path(place), seat)
    card, weights = read_policy(path)
    if card.seat != seat:
        raise ValueError(f"{path} is a policy for the seat of {card.seat}, not of {seat}")
    try:
        return LearnedPolicy(card, weights, config, greedy)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
