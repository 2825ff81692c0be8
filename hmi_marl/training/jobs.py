"""Several training runs in parallel, each in its own process with one thread.

Small networks gain little from a second thread, so parallel runs are the better use of several
cores. One thread each also makes the weights independent of how many run at a time.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from multiprocessing import current_process, get_context
from pathlib import Path
from typing import Any

from tqdm import tqdm

from hmi_marl.extras import TRAINING, need
from hmi_marl.training.protocols.settings import TrainSettings
from hmi_marl.training.runs.folder import read_curve
from hmi_marl.workers import pool


@dataclass(frozen=True)
class Job:
    """One training run."""

    settings: TrainSettings
    folder: Path

    def curve(self) -> list[dict[str, Any]]:
        """Rows of its learning curve, once it has been trained."""
        return read_curve(self.folder)


def train_all(
    jobs: Sequence[Job], workers: int, command_line: str = "", quiet: bool = False
) -> None:
    """Train every job, ``workers`` of them at a time.

    Jobs must not need each other's results. Finished runs are skipped, interrupted ones resumed.

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
    """Line of the terminal for this worker's progress bar."""
    numbers = current_process()._identity
    return numbers[-1] - 1 if numbers else 0


def need_training() -> None:
    """Check that torch and rsl_rl are installed.

    Raises:
        ModuleNotFoundError: one is not; the message says what to install.
    """
    need("training", *TRAINING)


def _train(job: Job, command_line: str, quiet: bool) -> None:
    from hmi_marl.training.ppo.run import train  # torch, with the threads that were just set

    settings = replace(job.settings, threads=1)
    train(settings, job.folder, quiet=quiet, command_line=command_line, line=own_line())
