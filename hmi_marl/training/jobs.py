"""Several training runs in parallel, each in processes of its own with one thread.

Runs side by side waste no time on waiting for each other, so each has one process while there are
enough runs, and the processes that are left over otherwise. Weights do not depend on either.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from multiprocessing import current_process, get_context
from pathlib import Path
from typing import Any

from tqdm import tqdm

from hmi_marl.extras import TRAINING, need
from hmi_marl.ownership import check_free
from hmi_marl.training.protocols.settings import TrainSettings
from hmi_marl.training.runs.exchange import SharedMemory
from hmi_marl.training.runs.folder import read_curve
from hmi_marl.training.runs.start import (
    check_processes,
    check_start,
    default_processes,
    start_together,
)
from hmi_marl.workers import calls, without_interrupts


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
    """Train every job, in ``workers`` processes in all.

    Jobs must not need each other's results. Finished runs are skipped, interrupted ones resumed.

    Raises:
        ModuleNotFoundError: torch or rsl_rl is not installed.
        ValueError: what :func:`hmi_marl.training.ppo.run.train` refuses.
    """
    need_training()
    for job in jobs:
        check_start(job.settings)
    each = max(1, workers // max(1, len(jobs)))
    side_by_side(_train, [(job, command_line, quiet, each) for job in jobs], workers)


def train_together(settings: TrainSettings, folder: Path, processes: int, **shown: Any) -> None:
    """Train one run in so many processes, of which this one is none: it imports no torch.

    Args:
        processes: at least 2.
        shown: ``quiet``, ``command_line``, ``line``: see :class:`hmi_marl.training.runs.run.Run`.
    """
    check_processes(processes, settings)
    check_free(folder)
    check_start(settings)
    start_together(processes, _train_rank, settings, folder, shown)


def side_by_side(
    learn: Callable[..., None], tasks: Sequence[tuple[Any, ...]], workers: int
) -> None:
    """Call ``learn`` with each task's arguments, ``workers`` of them at a time.

    The first error of any ends the others.
    """
    with without_interrupts():
        lock = get_context("spawn").RLock()
    for _ in calls(learn, tasks, workers, tqdm.set_lock, lock):
        pass


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


def _train(job: Job, command_line: str, quiet: bool, limit: int) -> None:
    """Train a job that :func:`train_all` has checked."""
    settings = replace(job.settings, threads=1)
    shown: dict[str, Any] = {"quiet": quiet, "command_line": command_line, "line": own_line()}
    if (processes := default_processes(settings, limit)) > 1:
        start_together(processes, _train_rank, settings, job.folder, shown)
        return
    from hmi_marl.training.ppo.run import train_rank  # torch, with the threads that were just set

    train_rank(settings, job.folder, None, shown)


def _train_rank(
    settings: TrainSettings, folder: Path, shown: dict[str, Any], memory: SharedMemory, rank: int
) -> None:
    from hmi_marl.training.ppo.run import train_rank

    train_rank(settings, folder, None, shown, memory, rank)
