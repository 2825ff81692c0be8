"""Learned models in files: a JSON card and, next to it, safetensors weights.

The card is a dataclass that describes the model; see :class:`CardFormat`. It holds a checksum of
the weights, and one of everything in itself. Nothing is ever unpickled. Agents that come with the
package have names, ``trained:homer``, ``trained:driver``: each has a folder in
``hmi_marl/trained``, and ``INDEX.json`` there, which has a checksum of its own, holds that of every
file. Only unaltered files that it lists are loaded.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import Field, asdict, dataclass
from pathlib import Path, PurePosixPath
from typing import Any, ClassVar, Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray
from safetensors.numpy import load as load_tensors
from safetensors.numpy import save as save_tensors

from hmi_marl.agents.learned.network import Weights
from hmi_marl.checks import shown
from hmi_marl.file_index import INDEX, check_digests, check_files, read_index
from hmi_marl.files import (
    sha256,
    with_checksum,
    without_checksum,
    write_bytes,
    write_json,
)
from hmi_marl.reading import parse_tensors, read_bytes, read_json
from hmi_marl.registry import HELP, suggest, unknown
from hmi_marl.text import listed, one_line
from hmi_marl.typed_json import read_as, read_value

INDEX_FORMAT = "hmi-marl trained 2"
PREFIX = "trained:"
FOLDER = Path(__file__).parents[2] / "trained"
_WEIGHTS = "weights_sha256"
"""Name of the weights' checksum in a card."""
_MOST_VALUES = 200_000
"""Most values in a card, whose training may name thousands of drivers."""
MOST_WEIGHTS = 2 * 2**30
"""Largest file of weights [bytes]."""
_HEADER_BYTES = 1024
"""Most bytes that a header has for each of the weights."""
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


_NAME = re.compile(r"[\w.-]{1,100}")
_LINE = 200
"""Most characters of a description."""


@dataclass(frozen=True)
class _Entry:
    """Content of the index about one agent."""

    what: str
    kind: str
    files: dict[str, str]

    def __post_init__(self) -> None:
        if not _NAME.fullmatch(self.kind) or self.what != one_line(self.what, _LINE):
            raise ValueError(f"{shown(self.what)} ({shown(self.kind)}) describes no agent")
        check_digests(self.files)
        suffixes = sorted(PurePosixPath(path).suffix for path in self.files)
        if suffixes != [".json", ".safetensors"]:
            raise ValueError(f"an agent has a card and weights, not {shown(list(self.files))}")


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
        content = read_index(folder, INDEX_FORMAT, "trained agents", _REMEDY)
    except FileNotFoundError:
        raise FileNotFoundError(
            f"no trained agents came with this package: {path} is missing; {_REMEDY}"
        ) from None
    try:
        agents = read_value(dict[str, _Entry], content.get("agents"), "agents")
        if odd := [name for name in agents if not _NAME.fullmatch(name)]:
            raise ValueError(f"{shown(odd[0])} is no name of an agent")
        return {name: Shipped(name, **vars(entry)) for name, entry in agents.items()}
    except ValueError as error:
        raise ValueError(f"{path} is damaged ({error}); {_REMEDY}") from None


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
    check_files(folder, agent.files, "that came with the package", _REMEDY)
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
    """Class of the card, which is read from JSON by the types of its fields."""

    def check(self, card: C, weights: Weights) -> None:
        """Raise ``ValueError`` unless the weights fit the card and are finite."""
        shapes = card.shapes
        if set(weights) != set(shapes):
            odd = sorted(set(weights) ^ set(shapes))
            raise ValueError(f"the weights do not fit the {self.model}'s card: {listed(odd)}")
        for name, shape in shapes.items():
            if weights[name].shape != shape:
                raise ValueError(
                    f"{name} has shape {weights[name].shape}, but the card says {shape}"
                )
            if weights[name].dtype.kind != "f":
                raise ValueError(f"{name} holds numbers of type {weights[name].dtype}")
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
        about = {"format": self.name, _WEIGHTS: sha256(content)} | asdict(card)
        write_json(path, with_checksum(about))
        return path

    def read(self, path: Path) -> tuple[C, dict[str, NDArray[np.float32]]]:
        """Return the card at ``path`` and the weights next to it.

        Raises:
            FileNotFoundError: a file is missing.
            ValueError: another kind of file, another version of the format, or files that are
                damaged or were altered; the message says which.
        """
        card, checksum = self._read_card(path)
        weights = _read_weights(path, checksum, card.shapes)
        try:
            self.check(card, weights)
        except ValueError as error:
            raise ValueError(f"{path.with_suffix('.safetensors')}: {error}") from None
        return card, weights

    def _read_card(self, path: Path) -> tuple[C, str]:
        content = read_json(path, most_values=_MOST_VALUES)
        found = content.get("format") if isinstance(content, dict) else None
        if found != self.name:
            raise ValueError(
                f"{path} is no {self.model} that can be read here: format {shown(found)}"
            )
        try:
            content = without_checksum(content)
        except ValueError as error:
            raise ValueError(
                f"{path} is a damaged {self.model} card: {error}; copy it again from where it "
                "comes from, or run the command that made it again"
            ) from None
        del content["format"]
        checksum = content.pop(_WEIGHTS, None)
        try:
            return read_as(self.card, content), read_value(str, checksum, _WEIGHTS)
        except ValueError as error:
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


def _read_weights(path: Path, checksum: str, shapes: Shapes) -> dict[str, NDArray[np.float32]]:
    """The weights next to the card at ``path``, whose SHA-256 and shapes are known."""
    weights_path = path.with_suffix(".safetensors")
    expected = 8 * sum(math.prod(shape) for shape in shapes.values())  # in double precision
    limit = min(MOST_WEIGHTS, expected + _HEADER_BYTES * (len(shapes) + 1))
    try:
        content = read_bytes(weights_path, limit)
    except FileNotFoundError:
        raise FileNotFoundError(f"{path} has lost its weights, {weights_path.name}") from None
    if sha256(content) != checksum:
        raise ValueError(f"{weights_path} is not the file that {path.name} was written with")
    try:
        return parse_tensors(content, load_tensors)[1]
    except ValueError as error:
        raise ValueError(f"{weights_path} is no safetensors file: {error}") from None
