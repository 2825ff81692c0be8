"""Trained agents that come with the package, by name: ``trained:homer``, ``trained:driver``.

They lie in ``hmi_marl/trained``, a folder each with a card and its weights; ``INDEX.json`` there
holds the checksum of every file. Only what it lists is loaded, and only if it is as it was shipped.
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
_REMEDY = "install hmi-marl again, or name a run of your own by its folder"


@dataclass(frozen=True)
class Shipped:
    """One agent."""

    name: str
    what: str
    """What it is, in a line."""
    kind: str
    """Its card's name without the suffix: driver, vehicle_ai, traits, ..."""
    files: Mapping[str, str]
    """Paths in the folder of all agents, with their SHA-256; the card is the ``.json``."""

    @property
    def card(self) -> str:
        """Path of the card in the folder of all agents."""
        return next(path for path in self.files if path.endswith(".json"))


def is_shipped(name: str | Path) -> bool:
    """Whether a name means an agent that comes with the package."""
    return str(name).lower().startswith(PREFIX)


def shipped_agents(folder: Path = FOLDER) -> dict[str, Shipped]:
    """All of them, by name.

    Raises:
        FileNotFoundError: there is no index.
        ValueError: it is no index of ours.
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
    """Names of the agents of one kind; none if the index cannot be read, which loading tells."""
    try:
        agents = shipped_agents()
    except (OSError, ValueError):
        return ()
    return tuple(name for name, agent in agents.items() if agent.kind == kind)


def find_shipped(name: str | Path, kind: str, folder: Path = FOLDER) -> Path:
    """The card of a shipped agent, it and its weights being what was shipped.

    Args:
        name: with its prefix, whatever the case.
        kind: of the agent: driver, vehicle_ai, traits, ...
        folder: of all agents.

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
