"""Evidence models in files: ``evidence.json`` and ``evidence.safetensors`` in a run's folder."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from hmi_marl.agents.adaptive.evidence_model import PARTS, EvidenceCard, EvidenceModel
from hmi_marl.agents.learned.cards import (
    check_shapes,
    find_card,
    read_card,
    read_weights,
    write_card,
)
from hmi_marl.agents.learned.network import NetworkConfig, Weights

FORMAT = "hmi-marl evidence 2"
KIND = "evidence"
NAME = f"{KIND}.json"


def save_evidence(folder: Path, card: EvidenceCard, weights: Weights) -> Path:
    """Write an evidence model into ``folder``; returns its card.

    Raises:
        ValueError: weights that do not fit the card.
    """
    check_shapes(card.shapes, weights, "evidence model")
    ordered = {name: weights[name] for name in card.shapes}
    return write_card(folder / NAME, FORMAT, asdict(card), ordered)


def load_evidence(place: str | Path) -> EvidenceModel:
    """The evidence model that a run learned.

    Args:
        place: the run's folder, the ``.json`` itself, or ``trained:NAME``.

    Raises:
        FileNotFoundError: there is none.
        ValueError: not an evidence model of ours, of a later format, damaged, or altered since it
            was written; the message says which.
    """
    path = find_card(place, KIND, "evidence model", "hmi-marl reproduce adapt")
    content = read_card(path, FORMAT, "evidence model")
    try:
        fields = {name: content[name] for name in EvidenceCard.__dataclass_fields__}
        fields |= {part: NetworkConfig(**fields[part]) for part in PARTS}
        card, digest = EvidenceCard(**fields), str(content["sha256"])
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path} is a damaged evidence card: {error}") from None
    weights = read_weights(path, digest)
    try:
        return EvidenceModel(card, weights)
    except ValueError as error:
        raise ValueError(f"{path.with_suffix('.safetensors')}: {error}") from None
