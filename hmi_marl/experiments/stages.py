"""One long run in stages, each kept when it is done: what is done already is not done again.

A stage learns (every training resumes by itself), plays or judges, and hands over an
:class:`Outcome`. :func:`run_stages` keeps it in ``stages/NAME.json`` together with the version, the
stage's settings and the checksums of everything learned or recorded that it depends on. A stage
whose record agrees with all of these is skipped; one whose weights have changed is done again; one
with other settings is refused.

How long things took is kept apart, in ``timings.json``: an outcome is the same whether its stage
ran through or was killed and taken up again.
"""

from __future__ import annotations

import hashlib
import json
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import hmi_marl
from hmi_marl.files import make_folder, write_json
from hmi_marl.reporting.blocks import Exhibit, exhibit_from
from hmi_marl.training.runs.folder import CHECKPOINT, check_same

STAGES, TIMINGS = "stages", "timings.json"
_DEPENDED_ON = (".safetensors", ".parquet")


@dataclass(frozen=True)
class Place:
    """Where and how a stage runs."""

    folder: Path
    """Its own."""
    driver_run: Path
    """Whose driver all stages share; the one that learns it finds it below its own folder."""
    workers: int = 1
    """Processes at a time. Does not change results."""
    command_line: str = ""
    """The command."""


@dataclass(frozen=True)
class Agent:
    """Something learned that is worth shipping."""

    name: str
    card: Path
    what: str
    """In a line."""


@dataclass(frozen=True)
class Outcome:
    """What a stage came to."""

    numbers: Mapping[str, Any]
    """JSON content, without times and places."""
    exhibits: tuple[Exhibit, ...]
    """What to show of it."""
    seconds: Mapping[str, float]
    """How long its parts took."""
    text: str = ""
    """For a terminal."""


class Stage(Protocol):
    """A part of the whole. A frozen dataclass with its sizes will do."""

    @property
    def name(self) -> str:
        """Of its folder and its record."""

    @property
    def title(self) -> str:
        """Its heading in the report."""

    @property
    def paper(self) -> str:
        """What the paper shows of this, and in which way ours stands for it."""

    def settings(self) -> dict[str, Any]:
        """As JSON, all that its results depend on."""

    def inputs(self, place: Place) -> list[Path]:
        """Files that were learned or recorded and that its results depend on, once it has run."""

    def agents(self, place: Place) -> list[Agent]:
        """What it has learned for others to use."""

    def run(self, place: Place) -> Outcome:
        """Do what is not done yet, and tell."""


@dataclass(frozen=True)
class Record:
    """A finished stage, as it is told in the report."""

    stage: Stage
    numbers: Mapping[str, Any]
    exhibits: tuple[Exhibit, ...]


def learned_in(folder: Path) -> list[Path]:
    """Weights and demonstrations below ``folder``, in order; checkpoints are on the way to them."""
    return sorted(
        path
        for path in folder.rglob("*")
        if path.suffix in _DEPENDED_ON
        and path.name != CHECKPOINT
        and not path.name.startswith(".")  # left behind by a kill
    )


def run_stages(
    stages: Sequence[Stage],
    folder: Path,
    driver_run: Path,
    workers: int = 1,
    command_line: str = "",
    line: Callable[[str], object] | None = None,
) -> list[Record]:
    """Run them one after the other, but for those that are done.

    Args:
        stages: in their order.
        folder: of the whole; each stage has a folder of its own in it.
        driver_run: see :class:`Place`.
        workers: processes at a time.
        typed: the command.
        line: told what is run and what is skipped; by default it is printed to stderr.

    Raises:
        ValueError: a stage was done there with other settings or by another version; nothing is
            run then.
    """
    tell = line or (lambda told: print(told, file=sys.stderr))
    make_folder(folder / STAGES)
    timings = _read(folder / TIMINGS) or {}
    for stage in stages:
        before = _read(folder / STAGES / f"{stage.name}.json")
        if before is not None:
            check_same(before, _about(stage), folder / stage.name)
    records = []
    for number, stage in enumerate(stages, 1):
        place = Place(folder / stage.name, driver_run, workers, command_line)
        path = folder / STAGES / f"{stage.name}.json"
        which = f"stage {number} of {len(stages)}, {stage.name}"
        content = _read(path)
        if content is not None:
            changed = _changed(content, stage.inputs(place), folder)
            if changed is not None:
                tell(f"{which}: once more, since {changed} has changed")
                content = None
            else:
                tell(f"{which}: done already")
        if content is None:
            tell(f"{which}: {stage.title}")
            began = time.monotonic()
            outcome = stage.run(place)
            spent = time.monotonic() - began
            content = _about(stage) | {
                "inputs": _digests(stage.inputs(place), folder),
                "numbers": outcome.numbers,
                "exhibits": [exhibit.as_json() for exhibit in outcome.exhibits],
            }
            timings[stage.name] = {"this time": spent} | dict(outcome.seconds)
            write_json(folder / TIMINGS, timings)
            write_json(path, content)
            content = _read(path) or {}  # as it will be read the next time
            tell(f"{which}: done in {spent:.0f} s")
        exhibits = tuple(exhibit_from(piece) for piece in content["exhibits"])
        records.append(Record(stage, content["numbers"], exhibits))
    return records


def is_done(stage: Stage, place: Place, folder: Path) -> bool:
    """Whether ``folder`` has a stage's record, and all that it depends on is as it was then.

    Raises:
        ValueError: it was done with other settings or by another version.
    """
    content = _read(folder / STAGES / f"{stage.name}.json")
    if content is None:
        return False
    check_same(content, _about(stage), folder / stage.name)
    return _changed(content, stage.inputs(place), folder) is None


def _about(stage: Stage) -> dict[str, Any]:
    return {"stage": stage.name, "version": hmi_marl.__version__, "settings": stage.settings()}


def _read(path: Path) -> dict[str, Any] | None:
    """The JSON of a file that is written in one go; None if it is not there."""
    try:
        content: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise ValueError(f"{path} is damaged ({error}); remove it, to have it made again") from None
    return content


def _digests(paths: Iterable[Path], folder: Path) -> dict[str, str]:
    found = {}
    for path in paths:
        with path.open("rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
        found[path.relative_to(folder).as_posix()] = digest
    return found


def _changed(content: Mapping[str, Any], paths: Iterable[Path], folder: Path) -> str | None:
    """The first file that is not what it was when the stage was done."""
    before = content.get("inputs")
    if not isinstance(before, dict) or not {"numbers", "exhibits"} <= set(content):
        return "its record"
    now = _digests((path for path in paths if path.is_file()), folder)
    odd = sorted(name for name in before.keys() | now.keys() if before.get(name) != now.get(name))
    return odd[0] if odd else None
