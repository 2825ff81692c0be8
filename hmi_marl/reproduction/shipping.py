"""Fill the folder of agents that come with the package, from a finished reproduction."""

from __future__ import annotations

import hashlib
import json
import re
import shutil
import tempfile
from pathlib import Path
from typing import Any

import hmi_marl
from hmi_marl.agents.learned.cards import INDEX, INDEX_FORMAT, shipped_agents
from hmi_marl.experiments.experiment import Agent, Place
from hmi_marl.files import write_bytes, write_json
from hmi_marl.reproduction.suite import Suite, is_done

_PLACE = re.compile(r"(?<![^\s'\"=])(?:[A-Za-z]:[\\/]|[/~])[^\s'\"]*")
"""Absolute path within a text."""


def ship(suite: Suite, run: Path, driver_run: Path, out: Path) -> list[Agent]:
    """Copy the agents of all experiments into ``out``, in place of what was there, and index them.

    Args:
        suite: experiments of the reproduction.
        run: its folder.
        driver_run: run of the driver policy that they share.
        out: a folder of shipped agents, an empty folder, or a new one.

    Returns:
        Agents that were copied.

    Raises:
        ValueError: an experiment is not finished, or ``out`` holds something else.
    """
    if out.exists() and any(out.iterdir()):
        try:
            shipped_agents(out)
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
    out.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=f".{out.name}-", dir=out.parent) as made:
        folder = Path(made) / out.name
        index = {agent.name: _copy(agent, folder) for agent in agents}
        about = {"format": INDEX_FORMAT, "version": hmi_marl.__version__, "agents": index}
        write_json(folder / INDEX, about)
        before = out.with_name(f".{out.name}-before")
        if out.exists():
            out.replace(before)  # still there if what comes next is interrupted
        folder.replace(out)
        shutil.rmtree(before, ignore_errors=True)
    return agents


def _copy(agent: Agent, folder: Path) -> dict[str, Any]:
    """Copy a card, without this machine's paths, and its weights; returns the index's entry."""
    card = folder / agent.name / agent.card.name
    write_json(card, without_places(json.loads(agent.card.read_text(encoding="utf-8"))))
    weights = card.with_suffix(".safetensors")
    write_bytes(weights, agent.card.with_suffix(".safetensors").read_bytes())
    files = {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in (card, weights)
    }
    return {"what": agent.what, "kind": card.stem, "files": files}


def without_places(content: Any) -> Any:
    """Shorten absolute paths in JSON content to their last part."""
    if isinstance(content, dict):
        return {name: without_places(value) for name, value in content.items()}
    if isinstance(content, list):
        return [without_places(value) for value in content]
    if isinstance(content, str):
        return _PLACE.sub(lambda found: re.split(r"[\\/]", found[0].rstrip("\\/"))[-1], content)
    return content
