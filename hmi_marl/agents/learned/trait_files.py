"""Trait models in files: ``traits.json`` and ``traits.safetensors`` in a run's folder."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from hmi_marl.agents.learned.cards import (
    check_shapes,
    find_card,
    read_card,
    read_weights,
    write_card,
)
from hmi_marl.agents.learned.network import NetworkConfig, Weights
from hmi_marl.agents.learned.trait_model import PARTS, TraitCard, TraitModel

FORMAT = "hmi-marl traits 2"
KIND = "traits"
NAME = f"{KIND}.json"


def save_traits(folder: Path, card: TraitCard, weights: Weights) -> Path:
    """Write a trait model into ``folder``; returns its card.

    Raises:
        ValueError: weights that do not fit the card.
    """
    check_shapes(card.shapes, weights, "trait model")
    ordered = {name: weights[name] for name in card.shapes}
    return write_card(folder / NAME, FORMAT, asdict(card), ordered)


def load_traits(place: str | Path) -> TraitModel:
    """The trait model that a run learned.

    Args:
        place: the run's folder, the ``.json`` itself, or ``trained:NAME``.

    Raises:
        FileNotFoundError: there is none.
        ValueError: not a trait model of ours, of a later format, damaged, or altered since it was
            written; the message says which.
    """
    path = find_card(place, KIND, "trait model", "hmi-marl traits train")
    content = read_card(path, FORMAT, "trait model")
    try:
        fields = {name: content[name] for name in TraitCard.__dataclass_fields__}
        fields |= {part: NetworkConfig(**fields[part]) for part in PARTS}
        card, digest = TraitCard(**fields), str(content["sha256"])
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path} is a damaged trait model card: {error}") from None
    weights = read_weights(path, digest)
    try:
        return TraitModel(card, weights)
    except ValueError as error:
        raise ValueError(f"{path.with_suffix('.safetensors')}: {error}") from None
