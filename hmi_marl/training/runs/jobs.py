"""Several training runs side by side, a process each with one thread.

Small networks gain little from a second thread, so runs side by side are the better use of several
cores. One thread each also makes the weights independent of how many run at a time.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from multiprocessing import current_process, get_context
from pathlib import Path
from typing import Any

from tqdm import tqdm

from hmi_marl.extras import TRAINING, need
from hmi_marl.training.protocols.settings import TrainSettings
from hmi_marl.workers import pool

CURVE = "curve.json"
"""In a run's folder: a row for each batch."""
CHECKPOINT = "checkpoint.safetensors"
"""In a run's folder: all that it takes to go on."""


@dataclass(frozen=True)
class Job:
    """One training run."""

    settings: TrainSettings
    folder: Path

    def curve(self) -> list[dict[str, Any]]:
        """The rows of its learning curve, once it has been trained."""
        rows: list[dict[str, Any]] = json.loads((self.folder / CURVE).read_text("utf-8"))
        return rows


def seconds_of(runs: Iterable[Path]) -> dict[str, float]:
    """What each training took in all, however often it was cut off, by its folder's name."""
    return {run.name: json.loads((run / CURVE).read_text("utf-8"))[-1]["seconds"] for run in runs}


def train_all(
    jobs: Sequence[Job], workers: int, command_line: str = "", quiet: bool = False
) -> None:
    """Train every job, ``workers`` of them at a time; finished ones are left alone.

    Jobs must not need each other's results. Runs that were cut off go on.

    Raises:
        ModuleNotFoundError: torch or rsl_rl is not installed.
        ValueError: what :func:`hmi_marl.training.ppo.run.train` refuses.
    """
    need_training()
    side_by_side(_train, [(job, command_line, quiet) for job in jobs], workers)


def side_by_side(
    learn: Callable[..., None], tasks: Sequence[tuple[Any, ...]], workers: int
) -> None:
    """Call ``learn`` with each task's arguments, ``workers`` of them at a time."""
    lock = get_context("spawn").RLock()
    with pool(max(1, min(workers, len(tasks))), tqdm.set_lock, lock) as workshop:
        for future in [workshop.submit(learn, *task) for task in tasks]:
            future.result()


def own_line() -> int:
    """The line of the terminal for this worker's progress bar."""
    place = current_process()._identity
    return place[-1] - 1 if place else 0


def need_training() -> None:
    """Raise ``ModuleNotFoundError``, saying what to install, if nothing can be learned here."""
    need("training", *TRAINING)


def _train(job: Job, command_line: str, quiet: bool) -> None:
    from hmi_marl.training.ppo.run import train  # torch, with the threads that were just set

    settings = replace(job.settings, threads=1)
    train(settings, job.folder, quiet=quiet, command_line=command_line, line=own_line())
