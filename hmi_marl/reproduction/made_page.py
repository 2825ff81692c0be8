"""Page of the report on how it was made: commands, settings, versions; and that of durations."""

from __future__ import annotations

import platform
from collections.abc import Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version

import hmi_marl
from hmi_marl.reporting.blocks import Block, Heading, Table, Text
from hmi_marl.reporting.html import flat
from hmi_marl.reporting.sources import pointer
from hmi_marl.reproduction.suite import Record

LIBRARIES = ("numpy", "torch", "rsl-rl-lib", "highway-env", "pettingzoo")
MADE = "made with"
"""Name of the versions in the report's JSON file."""
_ALL = "hmi-marl reproduce"
Timings = Mapping[str, Mapping[str, float]]
"""Durations of the parts of each experiment, by its name [s]."""


def made_with() -> dict[str, str]:
    """Versions of the libraries that numbers depend on."""
    found = {"hmi-marl": hmi_marl.__version__, "Python": platform.python_version()}
    for name in LIBRARIES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "none"
    return found


def command_of(name: str, command_line: str) -> str:
    """Return the command that runs one experiment, from the command that ran all of them."""
    return command_line.replace(_ALL, f"{_ALL} {name}", 1)


def made_blocks(
    records: Sequence[Record], command_line: str, versions: Mapping[str, str]
) -> list[Block]:
    """List the command, the versions, and each experiment's own command and settings."""
    blocks: list[Block] = [
        Heading("Command", "command"),
        Text(
            f"`{command_line}` runs all experiments, goes on where it was cut off, and gives the "
            "same bytes again, on one machine, whatever interrupts it. Only the durations differ, "
            "which have a page of their own."
        ),
        Table(
            "Versions",
            ["library", "version"],
            [[*each] for each in versions.items()],
            sources=[pointer(MADE)],
        ),
    ]
    for record in records:
        experiment = record.experiment
        text = f"`{command_of(experiment.name, command_line)}` runs this experiment alone."
        if experiment.uses_driver:
            text += (
                " Then it plays with another driver policy than here, unless `--driver-run` names "
                "that of the reproduction."
            )
        rows = [[name, str(value)] for name, value in flat(experiment.settings())]
        sources = [pointer("settings", experiment.name)]
        blocks += [
            Heading(experiment.title, experiment.name),
            Text(text),
            Table("Settings", ["setting", "value"], rows, sources=sources),
        ]
    return blocks


def time_blocks(timings: Timings) -> list[Block]:
    """Show the durations of every experiment's parts."""
    blocks: list[Block] = [
        Text(
            "Durations of the last call that ran each experiment; trainings as long as they took "
            "in all, however often they were cut off."
        )
    ]
    for name, parts in timings.items():
        rows = [[part, f"{spent:.0f} s"] for part, spent in parts.items()]
        blocks.append(Table(name, ["part", "time"], rows, sources=[pointer(name)]))
    return blocks
