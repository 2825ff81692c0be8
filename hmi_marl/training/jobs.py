"""Several training runs in parallel, in processes of one thread here or on a Ray cluster.

Runs side by side waste no time on waiting for each other, so each has one process while there are
enough runs, and here also the processes that are left over otherwise. On a cluster each has one
core of some node. Weights do not depend on any of this.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from multiprocessing import current_process, get_context
from pathlib import Path
from typing import Any, TypeVar

from tqdm import tqdm

from hmi_marl.extras import TRAINING, need
from hmi_marl.ownership import check_free
from hmi_marl.training.cluster.cluster import Cluster
from hmi_marl.training.policies import policies_read, reading
from hmi_marl.training.protocols.settings import TrainSettings
from hmi_marl.training.run_tasks import RunTask
from hmi_marl.training.runs.exchange import SharedMemory
from hmi_marl.training.runs.folder import read_curve
from hmi_marl.training.runs.start import (
    check_processes,
    check_start,
    default_processes,
    start_together,
)
from hmi_marl.workers import calls, without_interrupts

T = TypeVar("T")


@dataclass(frozen=True)
class Job:
    """One training run."""

    settings: TrainSettings
    folder: Path

    def curve(self) -> list[dict[str, Any]]:
        """Rows of its learning curve, once it has been trained."""
        return read_curve(self.folder)

    @property
    def reads(self) -> tuple[Path, ...]:
        """Learned driver policies that it needs, unless they come with the package."""
        return policies_read(self.settings)

    @property
    def on_gpu(self) -> bool:
        """Whether it asks for a GPU. On a cluster ``auto`` does not, so that nodes are alike."""
        return self.settings.device.startswith("cuda")


def train_all(
    jobs: Sequence[Job],
    workers: int,
    command_line: str = "",
    quiet: bool = False,
    cluster: Cluster | None = None,
) -> None:
    """Train every job, in ``workers`` processes in all, or on a cluster.

    Jobs must not need each other's results. Finished runs are skipped, interrupted ones resumed.

    Raises:
        ChildProcessError: see :meth:`Cluster.learn`.
        ModuleNotFoundError: torch or rsl_rl is not installed.
        ValueError: what :func:`hmi_marl.training.ppo.run.train` refuses.
    """
    need_training()
    for job in jobs:
        check_job(job.settings, cluster)
    each = processes_each(len(jobs), workers, cluster)
    tasks = [
        RunTask(
            train_in, (job.settings, command_line, quiet, each), job.folder, job.reads, job.on_gpu
        )
        for job in jobs
    ]
    side_by_side(tasks, workers, cluster, quiet)


def check_job(settings: TrainSettings, cluster: Cluster | None = None) -> None:
    """Check that a job can start here, or on a cluster, as far as that is known here.

    Raises:
        FileNotFoundError, ValueError: see :func:`check_start`.
    """
    check_start(replace(settings, device="cpu", threads=1) if cluster else settings)


def processes_each(jobs: int, workers: int, cluster: Cluster | None = None) -> int:
    """Return the most processes that each of so many jobs may have."""
    return 1 if cluster else max(1, workers // max(1, jobs))


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
    tasks: Sequence[RunTask], workers: int, cluster: Cluster | None = None, quiet: bool = False
) -> None:
    """Learn every task, ``workers`` of them at a time, or on a cluster.

    The first error of any ends the others.
    """
    if cluster is not None:
        cluster.learn(tasks, quiet)
        return
    for _ in calls_with_bars(RunTask.go, [(task,) for task in tasks], workers):
        pass


def calls_with_bars(
    function: Callable[..., T], tasks: Sequence[tuple[Any, ...]], workers: int
) -> Iterator[T]:
    """See :func:`calls`; for tasks that each show a progress bar on the :func:`own_line`."""
    with without_interrupts():
        lock = get_context("spawn").RLock()
    yield from calls(function, tasks, workers, tqdm.set_lock, lock)


def own_line() -> int:
    """Line of the terminal for this worker's progress bar; 0 in a process that is no worker."""
    numbers = current_process()._identity
    return numbers[-1] - 1 if numbers else 0


def need_training() -> None:
    """Check that torch and rsl_rl are installed.

    Raises:
        ModuleNotFoundError: one is not; the message says what to install.
    """
    need("training", *TRAINING)


def train_in(
    settings: TrainSettings,
    command_line: str,
    quiet: bool,
    limit: int,
    folder: Path,
    *policies: Path,
) -> None:
    """Train in ``folder``, in up to ``limit`` processes; to be called in a process of its own.

    The job has been checked by :func:`train_all`.

    Args:
        policies: where the driver policies of :attr:`Job.reads` are on this machine.
    """
    settings = replace(reading(settings, policies), threads=1)
    shown: dict[str, Any] = {"quiet": quiet, "command_line": command_line, "line": own_line()}
    if (processes := default_processes(settings, limit)) > 1:
        start_together(processes, _train_rank, settings, folder, shown)
        return
    from hmi_marl.training.ppo.run import train_rank  # torch, with the threads that were just set

    train_rank(settings, folder, None, shown)


def _train_rank(
    settings: TrainSettings, folder: Path, shown: dict[str, Any], memory: SharedMemory, rank: int
) -> None:
    from hmi_marl.training.ppo.run import train_rank

    train_rank(settings, folder, None, shown, memory, rank)
