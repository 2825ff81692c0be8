"""Trained agents that come with the package, by name: ``trained:homer``, ``trained:driver``.

Each has a folder in ``hmi_marl/trained`` with a card and its weights; ``INDEX.json`` there holds
the checksum of every file. Only unaltered files that it lists are loaded.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hmi_marl.files import sha256_of
from hmi_marl.names import HELP, suggest, unknown

FORMAT = "hmi-marl trained 1"
PREFIX = "trained:"
INDEX = "INDEX.json"
FOLDER = Path(__file__).parents[2] / "trained"
_REMEDY = "install hmi-marl again, or name the folder of a training run"


@dataclass(frozen=True)
class Shipped:
    """One trained agent."""

    name: str
    what: str
    """Description in one line."""
    kind: str
    """File name of its card without the suffix: driver, vehicle_ai, traits, ..."""
    files: Mapping[str, str]
    """SHA-256 of each file by its path in the folder of all agents; the card is the ``.json``."""

    @property
    def card(self) -> str:
        """Path of the card in the folder of all agents."""
        return next(path for path in self.files if path.endswith(".json"))


def is_shipped(name: str | Path) -> bool:
    """Return whether a name stands for an agent that comes with the package."""
    return str(name).lower().startswith(PREFIX)


def shipped_agents(folder: Path = FOLDER) -> dict[str, Shipped]:
    """Return all trained agents by name.

    Raises:
        FileNotFoundError: there is no index.
        ValueError: the index has another format, or is damaged.
    """
    path = folder / INDEX
    try:
        content: Any = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise FileNotFoundError(
            f"no trained agents came with this package: {path} is missing; {_REMEDY}"
        ) from None
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise ValueError(f"{path} is damaged ({error}); {_REMEDY}") from None
    found = content.get("format") if isinstance(content, dict) else None
    if found != FORMAT:
        raise ValueError(f"{path} is no index of trained agents: format {found!r}; {_REMEDY}")
    try:
        return {
            name: Shipped(name, str(about["what"]), str(about["kind"]), dict(about["files"]))
            for name, about in content["agents"].items()
        }
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path} is damaged ({error!r}); {_REMEDY}") from None


def shipped_names(kind: str) -> tuple[str, ...]:
    """Return the names of the agents of one kind; none if the index cannot be read."""
    try:
        agents = shipped_agents()
    except (OSError, ValueError):
        return ()
    return tuple(name for name, agent in agents.items() if agent.kind == kind)


def find_shipped(name: str | Path, kind: str, folder: Path = FOLDER) -> Path:
    """Return the path of a trained agent's card after checking all of its files.

    Args:
        name: name with its prefix; case does not matter.
        kind: kind of the agent: driver, vehicle_ai, traits, ...
        folder: folder of all agents.

    Raises:
        FileNotFoundError: a file is missing.
        ValueError: an unknown name or another kind of agent (the message names the nearest), or
            an altered file.
    """
    agents = shipped_agents(folder)
    wanted = str(name).lower().removeprefix(PREFIX)
    alike = [PREFIX + each for each, agent in agents.items() if agent.kind == kind]
    where = HELP if kind in ("driver", "vehicle_ai") else str(folder / INDEX)
    if wanted not in agents:
        raise ValueError(unknown("trained agent", str(name), alike, where))
    agent = agents[wanted]
    if agent.kind != kind:
        raise ValueError(
            f"{PREFIX}{wanted} is of kind {agent.kind} ({agent.what}), not {kind}; "
            f"{suggest(PREFIX + wanted, alike, where)}"
        )
    for path, digest in agent.files.items():
        try:
            found = sha256_of(folder / path)
        except FileNotFoundError:
            raise FileNotFoundError(f"{folder / path} is missing; {_REMEDY}") from None
        if found != digest:
            raise ValueError(
                f"{folder / path} is not the file that came with the package (its checksum "
                f"differs from that in {INDEX}); {_REMEDY}"
            )
    return folder / agent.card
