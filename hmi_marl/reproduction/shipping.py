"""Ship agents and the report: copy them to where the package and its documentation have them."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import hmi_marl
from hmi_marl.agents.adaptive.hmis import CONDITIONED, Trained, make_adaptive
from hmi_marl.agents.learned.cards import (
    INDEX_FORMAT,
    MOST_WEIGHTS,
    PREFIX,
    Shipped,
    shipped_agents,
)
from hmi_marl.envs.config import TeamConfig
from hmi_marl.experiments.experiment import Agent, Place
from hmi_marl.file_index import digests, put_back, replaced, write_index
from hmi_marl.files import with_checksum, without_checksum, write_bytes, write_json
from hmi_marl.ownership import check_free
from hmi_marl.reading import read_bytes, read_json
from hmi_marl.reporting.report import PAGE
from hmi_marl.reproduction.report import NUMBERS
from hmi_marl.reproduction.suite import Suite, is_done

_OF_REPORT = (".html", ".json", ".txt")
"""Suffixes of a report's files."""
MOST_REPORT = 2**30
"""Largest file of a report [bytes]."""
_PLACE = re.compile(r"(?<![^\s'\"=])(?:[A-Za-z]:[\\/]|[/~])[^\s'\"]*")
"""Absolute path within a text."""


def ship(suite: Suite, run: Path, driver_run: Path, out: Path) -> list[Agent]:
    """Copy the agents of all experiments into ``out``, in place of those of the same names.

    Others, such as the pairs of a comparison, come from runs of their own and stay.

    Args:
        suite, run: experiments of the reproduction, and its folder.
        driver_run: run of the driver policy that they share.
        out: a folder of shipped agents, an empty folder, or a new one.

    Raises:
        ValueError: an experiment is not finished, ``out`` holds something else, or its agents that
            infer drivers would read another encoder than the one next to them.
    """
    before = {}
    put_back(out)
    if out.exists() and any(out.iterdir()):
        try:
            before = shipped_agents(out)
        except (OSError, ValueError) as error:
            raise ValueError(
                f"{out} holds other things than shipped agents; choose another --out ({error})"
            ) from None
    agents = []
    for experiment in suite:
        place = Place(run / experiment.name, driver_run)
        if not is_done(experiment, place, run):
            raise ValueError(
                f"stage {experiment.name} of {run} is not finished; run it to its end first"
            )
        agents += experiment.agents(place)
    check_free(run)
    _write(agents, before, out)
    return agents


def ship_more(agents: Sequence[Agent], out: Path) -> None:
    """Add agents to the shipped ones in ``out``, in place of those of the same names.

    Raises:
        FileNotFoundError, ValueError: ``out`` holds no shipped agents, or a card is damaged.
    """
    put_back(out)
    _write(agents, shipped_agents(out), out)


def read_report(folder: Path) -> dict[str, bytes]:
    """Read all files of a report by their names.

    Raises:
        FileNotFoundError: there is none.
    """
    for name in (PAGE, NUMBERS):
        if not (folder / name).is_file():
            raise FileNotFoundError(f"{folder} has no {name}; run hmi-marl reproduce to its end")
    found = sorted(path for path in folder.iterdir() if path.suffix in _OF_REPORT)
    return {path.name: read_bytes(path, MOST_REPORT) for path in found}


def write_report(folder: Path, files: Mapping[str, bytes]) -> None:
    """Write a report's files, in place of those of an earlier one; other files stay."""
    if (folder / NUMBERS).is_file():
        for path in folder.iterdir():
            if path.suffix in _OF_REPORT and path.name not in files:
                path.unlink()
    for name, content in files.items():
        write_bytes(folder / name, content)


def _write(agents: Sequence[Agent], before: Mapping[str, Shipped], out: Path) -> None:
    """Write agents, and those of other names that were in ``out``, in place of what is there."""
    with replaced(out) as (folder,):
        fill(folder, agents, before, out)


def fill(folder: Path, agents: Sequence[Agent], before: Mapping[str, Shipped], out: Path) -> None:
    """Write agents, those of other names that ``out`` has, and the index into an empty folder.

    Raises:
        ValueError: a card is damaged, or agents that infer drivers would read another encoder than
            the one next to them.
    """
    names = {agent.name for agent in agents}
    kept = {name: agent for name, agent in before.items() if name not in names}
    index = {name: _keep(agent, out, folder) for name, agent in kept.items()}
    index |= {agent.name: _copy(agent, folder) for agent in agents}
    _check_adaptive(folder)
    write_index(folder, INDEX_FORMAT, {"version": hmi_marl.__version__, "agents": index})


def _check_adaptive(folder: Path) -> None:
    """Check that the agents that infer drivers read the shipped encoder, where all are there.

    Raises:
        ValueError: they were learned with another one.
    """
    names = {each.name: str(each.default).removeprefix(PREFIX) for each in fields(Trained)}
    models = Trained(**{model: str(folder / name) for model, name in names.items()})
    read = models.evidence, models.conditioned, models.traits
    if not all(Path(place).is_dir() for place in read):
        return
    try:
        make_adaptive(CONDITIONED, TeamConfig(ai_sees_attention=False), trained=models)
    except ValueError as error:
        raise ValueError(
            f"the agents that would be shipped do not belong together: {error}; ship the stages "
            "traits and adapt of one reproduction"
        ) from None


def _keep(agent: Shipped, out: Path, folder: Path) -> dict[str, Any]:
    """Copy the files of a shipped agent as they are; returns the index's entry."""
    for name in agent.files:
        write_bytes(folder / name, read_bytes(out / name, MOST_WEIGHTS))
    return {"what": agent.what, "kind": agent.kind, "files": dict(agent.files)}


def _copy(agent: Agent, folder: Path) -> dict[str, Any]:
    """Copy a card, without this machine's paths, and its weights; returns the index's entry."""
    card = folder / agent.name / agent.card.name
    try:
        about = without_checksum(read_json(agent.card))
    except ValueError as error:
        raise ValueError(f"{agent.card} is damaged: {error}; run its experiment again") from None
    write_json(card, with_checksum(without_places(about)))
    weights = card.with_suffix(".safetensors")
    write_bytes(weights, read_bytes(agent.card.with_suffix(".safetensors"), MOST_WEIGHTS))
    return {"what": agent.what, "kind": card.stem, "files": digests((card, weights), folder)}


def without_places(content: Any) -> Any:
    """Shorten absolute paths in JSON content to their last part."""
    if isinstance(content, dict):
        return {name: without_places(value) for name, value in content.items()}
    if isinstance(content, list):
        return [without_places(value) for value in content]
    if isinstance(content, str):
        return _PLACE.sub(lambda found: re.split(r"[\\/]", found[0].rstrip("\\/"))[-1], content)
    return content
