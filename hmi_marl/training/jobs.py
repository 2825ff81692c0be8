"""Several training runs side by side, a process each with one thread.

Small networks learn little faster on two threads than on one, so two runs at a time are nearly
twice as fast as two runs in turn. One thread each also makes the weights independent of how many
run at a time.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import current_process, get_context
from pathlib import Path
from typing import Any

from tqdm import tqdm

from hmi_marl.training.settings import TrainSettings

_ONE_THREAD = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "NUMBA_NUM_THREADS": "1",
}


@dataclass(frozen=True)
class Job:
    """One training run."""

    settings: TrainSettings
    folder: Path


def train_all(jobs: Sequence[Job], workers: int, typed: str = "", quiet: bool = False) -> None:
    """Train every job, ``workers`` of them at a time; finished ones are left alone.

    Jobs must not need each other's results. Runs that were cut off go on.

    Raises:
        ValueError: what :func:`hmi_marl.training.run.train` refuses.
    """
    before = {name: os.environ.get(name) for name in _ONE_THREAD}
    os.environ.update(_ONE_THREAD)  # a worker reads them when it starts
    try:
        context = get_context("spawn")
        with ProcessPoolExecutor(
            min(workers, len(jobs)) or 1,
            context,
            initializer=_begin_worker,
            initargs=(context.RLock(),),
        ) as pool:
            futures = [pool.submit(_train, job, typed, quiet) for job in jobs]
            try:
                for future in futures:
                    future.result()
            finally:
                for future in futures:
                    future.cancel()
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _begin_worker(lock: Any) -> None:
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # an interrupt ends it at once, without a trace
    tqdm.set_lock(lock)


def _train(job: Job, typed: str, quiet: bool) -> None:
    from hmi_marl.training.run import train  # torch, with the threads that were just set

    place = current_process()._identity
    line = place[-1] - 1 if place else 0
    train(replace(job.settings, threads=1), job.folder, quiet=quiet, typed=typed, line=line)
