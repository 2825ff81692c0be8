"""Learned policies in files: a card and weights, one pair for each seat."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hmi_marl.agents.learned.cards import read_card, read_weights, write_card
from hmi_marl.agents.learned.network import NetworkConfig, Weights
from hmi_marl.agents.learned.policy import LearnedPolicy, PolicyCard, check_weights
from hmi_marl.agents.learned.shipped import find_shipped, is_shipped
from hmi_marl.envs.config import AGENTS, TeamConfig

FORMAT = "hmi-marl policy 2"


def save_policy(folder: Path, card: PolicyCard, weights: Weights) -> Path:
    """Write ``<seat>.safetensors`` and ``<seat>.json`` into ``folder``; returns the latter.

    Raises:
        ValueError: weights that do not fit the card.
    """
    check_weights(card, weights)
    ordered = {name: weights[name] for name in card.shapes}
    return write_card(folder / f"{card.seat}.json", FORMAT, asdict(card), ordered)


def find_policy(place: Path, seat: str) -> Path:
    """The card of the seat's policy: in a run's folder, the file itself, or a shipped one.

    Raises:
        FileNotFoundError: there is none; the message says what is there.
        ValueError: see :func:`hmi_marl.agents.learned.shipped.find_shipped`.
    """
    if is_shipped(place):
        return find_shipped(place, seat)
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
    content = read_card(path, FORMAT, "policy")
    try:
        fields = {name: content[name] for name in PolicyCard.__dataclass_fields__}
        fields["network"] = NetworkConfig(**fields["network"])
        card, digest = PolicyCard(**fields), str(content["sha256"])
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path} is a damaged policy card: {error}") from None
    weights = read_weights(path, digest)
    try:
        check_weights(card, weights)
    except ValueError as error:
        raise ValueError(f"{path.with_suffix('.safetensors')}: {error}") from None
    return card, weights


def load_policy(
    place: str | Path, seat: str, config: TeamConfig, greedy: bool = True
) -> LearnedPolicy:
    """The policy that a run learned for a seat, ready to sit there.

    Args:
        place: a run's folder, a policy's ``.json``, or ``trained:NAME``.
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
