"""Learned models in files: a JSON card and, next to it, safetensors weights with a checksum.

The card is a dataclass that describes the model; see :class:`CardFormat`. Nothing is ever
unpickled. Agents that come with the package have names, ``trained:homer``, ``trained:driver``: each
has a folder in ``hmi_marl/trained``, and ``INDEX.json`` there holds the checksum of every file.
Only unaltered files that it lists are loaded.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import Field, asdict, dataclass
from pathlib import Path
from typing import Any, ClassVar, Generic, Protocol, TypeVar, get_type_hints

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load as load_tensors
from safetensors.numpy import save as save_tensors

from hmi_marl.agents.learned.network import NetworkConfig, Weights
from hmi_marl.files import sha256, sha256_of, write_bytes, write_json
from hmi_marl.registry import HELP, suggest, unknown

INDEX_FORMAT = "hmi-marl trained 1"
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
    if found != INDEX_FORMAT:
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


Shapes = Mapping[str, tuple[int, ...]]


class Card(Protocol):
    """A frozen dataclass that describes a model except for its weights."""

    __dataclass_fields__: ClassVar[dict[str, Field[Any]]]

    @property
    def shapes(self) -> Shapes:
        """Names and shapes of the weights."""
        ...


C = TypeVar("C", bound=Card)


@dataclass(frozen=True)
class CardFormat(Generic[C]):
    """Write and read the files of one kind of model."""

    name: str
    """Name and version of the format, kept in the card."""
    model: str
    """Name of the model for error messages: "policy", "trait model", ..."""
    card: type[C]
    """Class of the card. Its fields of type :class:`NetworkConfig` become mappings in JSON."""

    def check(self, card: C, weights: Weights) -> None:
        """Raise ``ValueError`` unless the weights fit the card and are finite."""
        shapes = card.shapes
        if set(weights) != set(shapes):
            odd = sorted(set(weights) ^ set(shapes))
            raise ValueError(f"the weights do not fit the {self.model}'s card: {', '.join(odd)}")
        for name, shape in shapes.items():
            if weights[name].shape != shape:
                raise ValueError(
                    f"{name} has shape {weights[name].shape}, but the card says {shape}"
                )
            if not np.isfinite(weights[name]).all():
                raise ValueError(f"{name} is not finite everywhere")

    def save(self, path: Path, card: C, weights: Weights) -> Path:
        """Write the card to ``path``, a ``.json``, and the weights next to it; return ``path``.

        Weights are kept in single precision.

        Raises:
            ValueError: weights that do not fit the card.
        """
        self.check(card, weights)
        content = save_tensors(
            {name: np.asarray(weights[name], np.float32, order="C") for name in card.shapes}
        )
        write_bytes(path.with_suffix(".safetensors"), content)
        write_json(path, {"format": self.name, "sha256": sha256(content)} | asdict(card))
        return path

    def read(self, path: Path) -> tuple[C, dict[str, NDArray[np.float32]]]:
        """Return the card at ``path`` and the weights next to it.

        Raises:
            FileNotFoundError: a file is missing.
            ValueError: another kind of file, another version of the format, or files that are
                damaged or were altered; the message says which.
        """
        card, checksum = self._read_card(path)
        weights = _read_weights(path, checksum)
        try:
            self.check(card, weights)
        except ValueError as error:
            raise ValueError(f"{path.with_suffix('.safetensors')}: {error}") from None
        return card, weights

    def _read_card(self, path: Path) -> tuple[C, str]:
        try:
            content: Any = json.loads(path.read_text(encoding="utf-8"))
        except (UnicodeDecodeError, json.JSONDecodeError) as error:
            raise ValueError(f"{path} is no JSON file: {error}") from None
        found = content.get("format") if isinstance(content, dict) else None
        if found != self.name:
            raise ValueError(f"{path} is no {self.model} that can be read here: format {found!r}")
        try:
            fields = {name: content[name] for name in self.card.__dataclass_fields__}
            for name, kind in get_type_hints(self.card).items():
                if kind is NetworkConfig:
                    fields[name] = NetworkConfig(**fields[name])
            return self.card(**fields), str(content["sha256"])
        except (KeyError, TypeError, ValueError) as error:
            raise ValueError(f"{path} is a damaged {self.model} card: {error}") from None


def is_saved(card: Path) -> bool:
    """Whether there are a card and the weights next to it."""
    return card.is_file() and card.with_suffix(".safetensors").is_file()


def checked_reads(reads: Iterable[tuple[str, int]], model: str) -> tuple[tuple[str, int], ...]:
    """Return names and sizes of the parts that a model reads.

    Raises:
        ValueError: there are none, or one without columns.
    """
    parts = tuple((str(name), int(size)) for name, size in reads)
    if not parts or min(size for _, size in parts) < 1:
        raise ValueError(f"{model} reads parts of at least one column")
    return parts


def part_shapes(card: object, sizes: Mapping[str, tuple[int, int]]) -> dict[str, tuple[int, ...]]:
    """Return shapes by ``part.NAME`` of a card's networks, from inputs and outputs of each."""
    return {
        f"{part}.{name}": shape
        for part, (inputs, outputs) in sizes.items()
        for name, shape in getattr(card, part).shapes(inputs, outputs).items()
    }


def find_card(place: str | Path, kind: str, model: str, hint: str = "") -> Path:
    """Return the path of a model's card.

    Args:
        place: folder of the training run, path of the card or the weights, or ``trained:NAME``.
        kind: file name of the card without its suffix.
        model: name of the model for error messages.
        hint: end of the message if there is no such card.

    Raises:
        FileNotFoundError: there is none.
        ValueError: see :func:`hmi_marl.agents.learned.cards.find_shipped`.
    """
    if is_shipped(place):
        return find_shipped(place, kind)
    path = Path(place)
    path = path / f"{kind}.json" if path.is_dir() else path
    path = path.with_suffix(".json") if path.suffix == ".safetensors" else path
    if not path.is_file():
        raise FileNotFoundError(f"no {model} at {place}{hint}")
    return path


def _read_weights(path: Path, checksum: str) -> dict[str, NDArray[np.float32]]:
    """The weights next to the card at ``path``, whose SHA-256 is known."""
    weights_path = path.with_suffix(".safetensors")
    try:
        content = weights_path.read_bytes()
    except FileNotFoundError:
        raise FileNotFoundError(f"{path} has lost its weights, {weights_path.name}") from None
    if sha256(content) != checksum:
        raise ValueError(f"{weights_path} is not the file that {path.name} was written with")
    try:
        return load_tensors(content)
    except (SafetensorError, KeyError) as error:  # KeyError: number types unknown to NumPy
        raise ValueError(f"{weights_path} is no safetensors file: {error}") from None
