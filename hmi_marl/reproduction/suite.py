"""All experiments of a reproduction in one folder, each kept when it is done, and their release.

:func:`run_suite` runs one experiment after the other (every training resumes by itself) and keeps
what it found in ``stages/NAME.json``, together with the version, the settings and the checksums of
everything learned or recorded that it depends on. An experiment whose record agrees with all of
these is skipped; one whose weights have changed, or whose results are of an earlier format, is run
again from what is learned; one with other settings is refused.

Durations are kept apart, in ``timings.json``: a record is the same whether its experiment ran
through or was killed and taken up again. :mod:`hmi_marl.reproduction.shipping` makes agents that
come with the package out of a finished reproduction.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import hmi_marl
from hmi_marl.experiments.experiment import Experiment, Place, conduct, with_seed
from hmi_marl.experiments.registry import EXPERIMENTS
from hmi_marl.file_index import digests
from hmi_marl.files import with_checksum, without_checksum, write_json
from hmi_marl.ownership import owned
from hmi_marl.reading import read_json
from hmi_marl.reporting.blocks import Block, block_from
from hmi_marl.reporting.report import Stopwatch
from hmi_marl.training.cluster.cluster import Cluster
from hmi_marl.training.runs.folder import check_same

STAGES, TIMINGS = "stages", "timings.json"
RECORD_FORMAT = 3
"""Format of records; those of another are made again, from what is learned already."""
_RECORD_BYTES = 256 * 2**20
"""Largest record; it holds figures."""
Suite = Sequence[Experiment[Any]]


@dataclass(frozen=True)
class Record:
    """A finished experiment, for the report of all."""

    experiment: Experiment[Any]
    numbers: Mapping[str, Any]
    blocks: tuple[Block, ...]


def full_suite(quick: bool = False, seed: int = 0) -> Suite:
    """Make all experiments of a reproduction, in their order; quick: a quarter of an hour in all.

    Raises:
        ValueError: the seed is out of range.
    """
    kinds = [entry.value.load(name) for name, entry in EXPERIMENTS.items() if entry.value.in_suite]
    return [with_seed(kind.quick() if quick else kind(), seed) for kind in kinds]


def shared_driver(suite: Suite, folder: Path) -> Path:
    """Run of the driver policy that the experiments share: the first that learns one for itself."""
    for experiment in suite:
        job = experiment.driver_job(folder / experiment.name)
        if job is not None and not experiment.uses_driver:
            return job.folder
    raise ValueError("no experiment of the suite learns a driver policy for the others")


def run_suite(
    suite: Suite,
    folder: Path,
    driver_run: Path,
    workers: int = 1,
    command_line: str = "",
    line: Callable[[str], object] | None = None,
    cluster: Cluster | None = None,
) -> list[Record]:
    """Run the experiments that are not done yet, in their order, each in a folder of its own.

    Args:
        suite, folder: experiments, and the folder of the reproduction.
        driver_run: see :class:`Place`.
        workers: processes at a time. Does not change results.
        command_line: command that was typed, kept with what is learned.
        line: receives a line about each experiment; by default it is printed to stderr.
        cluster: trains in place of processes here. Does not change results.

    Raises:
        FolderInUseError: another process writes into the folder.
        ValueError: an experiment was run there with other settings or by another version; nothing
            is run then.
    """
    with owned(folder):
        shared = Place(folder, driver_run, workers, command_line, cluster=cluster)
        return _run_suite(suite, shared, line or _print)


def _print(text: str) -> None:
    print(text, file=sys.stderr)


def _run_suite(suite: Suite, shared: Place, say: Callable[[str], object]) -> list[Record]:
    folder = shared.folder
    timings = read_timings(folder / TIMINGS)
    for experiment in suite:
        before = _read(_record_of(experiment, folder))
        if before is not None:
            check_same(before, _about(experiment), folder / experiment.name)
    records = []
    for number, experiment in enumerate(suite, 1):
        place = replace(shared, folder=folder / experiment.name, watch=Stopwatch())
        path = _record_of(experiment, folder)
        which = f"stage {number} of {len(suite)}, {experiment.name}"
        content = _read(path)
        if content is not None:
            changed = _changed(content, experiment, place, folder)
            if changed is not None:
                say(f"{which}: once more, since {changed} has changed")
                content = None
            else:
                say(f"{which}: done already")
        if content is None:
            say(f"{which}: {experiment.title}")
            began = time.monotonic()
            report = conduct(experiment, place)
            spent = time.monotonic() - began
            content = _about(experiment) | {
                "format": RECORD_FORMAT,
                "results_format": experiment.results_format,
                "inputs": digests(experiment.inputs(place), folder),
                "numbers": report.numbers,
                "blocks": [block.as_json() for block in report.blocks],
            }
            timings[experiment.name] = {"this time": spent} | dict(report.seconds)
            write_json(folder / TIMINGS, timings)
            write_json(path, with_checksum(content))
            content = _read(path) or {}  # as it will be read the next time
            say(f"{which}: done in {spent:.0f} s")
        blocks = tuple(block_from(block) for block in content["blocks"])
        records.append(Record(experiment, content["numbers"], blocks))
    return records


def is_done(experiment: Experiment[Any], place: Place, folder: Path) -> bool:
    """Check that ``folder`` has an experiment's record, and that its inputs have not changed.

    Raises:
        ValueError: it was run with other settings or by another version.
    """
    content = _read(_record_of(experiment, folder))
    if content is None:
        return False
    check_same(content, _about(experiment), folder / experiment.name)
    return _changed(content, experiment, place, folder) is None


def _record_of(experiment: Experiment[Any], folder: Path) -> Path:
    return folder / STAGES / f"{experiment.name}.json"


def _about(experiment: Experiment[Any]) -> dict[str, Any]:
    version, settings = hmi_marl.__version__, experiment.settings()
    return {"stage": experiment.name, "version": version, "settings": settings}


def _read(path: Path) -> dict[str, Any] | None:
    """Read a record; None if there is no such file.

    Raises:
        ValueError: it is damaged; the message says what to do.
    """
    try:
        return without_checksum(read_json(path, _RECORD_BYTES))
    except FileNotFoundError:
        return None
    except ValueError as error:
        raise ValueError(f"{path} is damaged ({error}); remove it, to have it made again") from None


def read_timings(path: Path) -> dict[str, Any]:
    """Durations by experiment so far, or nothing if there are none yet."""
    try:
        content = read_json(path)
    except FileNotFoundError:
        return {}
    if not isinstance(content, dict):
        raise ValueError(f"{path} is damaged; remove it, to have it made again")
    return content


def _changed(
    content: Mapping[str, Any], experiment: Experiment[Any], place: Place, folder: Path
) -> str | None:
    """Name the first input that is not as it was when the experiment was run; None if all are."""
    if content.get("format") != RECORD_FORMAT:
        return "the format of records"
    if content.get("results_format", 1) != experiment.results_format:
        return "the format of its results"
    before = content.get("inputs")
    if not isinstance(before, dict) or not {"numbers", "blocks"} <= set(content):
        return "its record"
    now = digests((path for path in experiment.inputs(place) if path.is_file()), folder)
    odd = sorted(name for name in before.keys() | now.keys() if before.get(name) != now.get(name))
    return odd[0] if odd else None
