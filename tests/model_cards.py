"""Cards of models with other content, and with the checksums that belong to it."""

import json
from pathlib import Path
from typing import Any

from hmi_marl.files import sha256, with_checksum, without_checksum


def card_bytes(content: dict[str, Any]) -> bytes:
    """JSON of a card, with its checksum."""
    return json.dumps(with_checksum(content)).encode()


def with_card(path: Path, **changed: Any) -> Path:
    """Change fields of a card; return its path."""
    card = without_checksum(json.loads(path.read_text("utf-8")))
    path.write_bytes(card_bytes(card | changed))
    return path


def with_weights(path: Path, content: bytes) -> Path:
    """Put other weights next to a card, with their checksum in the card; return its path."""
    path.with_suffix(".safetensors").write_bytes(content)
    return with_card(path, weights_sha256=sha256(content))
