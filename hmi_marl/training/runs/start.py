"""Start the processes of one run on this machine, and end them together; no torch."""

from __future__ import annotations

import os
import signal
import sys
import traceback
from collections.abc import Callable
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from hmi_marl.agents.catalogue import make_driver_policy, make_hmi
from hmi_marl.checks import WORKERS
from hmi_marl.envs.config import DRIVER
from hmi_marl.training.protocols.anchored import load_anchor
from hmi_marl.training.protocols.settings import LEARNED, TrainSettings
from hmi_marl.training.runs.exchange import SharedMemory
from hmi_marl.workers import (
    begin_worker,
    check_threads_here,
    cores,
    environment,
    threads_each,
    without_interrupts,
)

_GPU_DRIVERS = ("/dev/nvidiactl", "/dev/kfd", "/dev/dxg")
"""Devices of the drivers that torch.cuda works with, on Linux: NVIDIA's, AMD's, Windows'."""


def learns_on_gpu(device: str) -> bool:
    """Whether a setting ``device`` means a GPU on this machine."""
    if device != "auto":
        return device.startswith("cuda")
    if sys.platform == "linux" and not any(Path(driver).exists() for driver in _GPU_DRIVERS):
        return False  # without importing torch, which takes seconds
    import torch

    return torch.cuda.is_available()


def default_threads(device: str) -> int:
    """Threads of the world by default: with a learner on a GPU, all cores that numba may use."""
    allowed = int(os.environ.get("NUMBA_NUM_THREADS", "0")) or cores()
    return allowed if learns_on_gpu(device) else 1


def default_processes(settings: TrainSettings, limit: int | None = None) -> int:
    """Processes by default: as many as cores, or the most that the shards allow; one with a GPU.

    ``limit`` takes the place of the number of cores.
    """
    if learns_on_gpu(settings.device):
        return 1
    most = min(settings.shards_used, cores() if limit is None else limit)
    return 1 << max(0, most.bit_length() - 1)


def check_processes(count: int, settings: TrainSettings) -> int:
    """Return the number of processes.

    Raises:
        TypeError, ValueError: it is no number of processes that can share the teams.
    """
    WORKERS("processes", count)
    shards = settings.shards_used
    if learns_on_gpu(settings.device):
        if (
            settings.num_teams % count
            or settings.num_teams // count < settings.ppo.num_mini_batches
        ):
            raise ValueError(
                f"{count} processes cannot share {settings.num_teams} teams evenly, with a team "
                f"for each of {settings.ppo.num_mini_batches} mini-batches; change --num-teams"
            )
    elif shards % count:
        choices = ", ".join(str(2**power) for power in range(shards.bit_length()))
        raise ValueError(
            f"processes is one of {choices}, since a batch has {shards} shards, but got {count}; "
            "raise --shards, and --num-teams with it, for more"
        )
    return count


def check_machine(device: str, threads: int | None) -> None:
    """Check that this machine has a device, and a core for each of so many threads.

    Raises:
        ValueError: it has not.
    """
    check_threads_here(threads)
    if device.startswith("cuda"):
        from hmi_marl.training.runs.processes import ALONE  # imports torch, which takes seconds

        ALONE.device(device)


def check_start(settings: TrainSettings) -> None:
    """Check that a run can start, before anything is made.

    Its device, threads, partners and anchor are there and fit.

    Raises:
        FileNotFoundError, ValueError: it cannot; the message says what to use instead.
    """
    check_machine(settings.device, settings.threads)
    for phase in settings.phases():
        if phase.partner not in (None, LEARNED):
            make = make_hmi if phase.seat == DRIVER else make_driver_policy
            make(phase.partner, phase.team)
        if phase.anchor not in (None, LEARNED):
            load_anchor(phase.anchor, phase.team)


def start_together(
    count: int, function: Callable[..., object], *arguments: Any, threads: int = 1
) -> None:
    """Call ``function(*arguments, memory, rank)`` in ``count`` new processes, and wait for them.

    If one fails, the others are ended; all end with this process, however it ends.

    Args:
        function: of a module, with picklable arguments. ``memory`` is a :class:`SharedMemory`.
        threads: threads that each process may use.

    Raises:
        ChildProcessError: a process was killed.
        Exception: what ``function`` raised in one of them.
    """
    context = get_context("spawn")
    processes: list[tuple[BaseProcess, Connection]] = []
    try:
        with environment(threads_each(threads)), without_interrupts():
            memory = SharedMemory(count)
            for rank in range(count):
                reader, writer = context.Pipe(duplex=False)
                call = (function, (*arguments, memory, rank), writer)
                process: BaseProcess = context.Process(target=_call, args=call, daemon=True)
                process.start()
                writer.close()
                processes.append((process, reader))
        _join(processes)
    finally:
        for process, _ in processes:
            process.kill()  # nothing happens to those that have ended
        for process, _ in processes:
            process.join()


def _join(processes: list[tuple[BaseProcess, Connection]]) -> None:
    """Wait until all have ended, or raise the error of the first that fails."""
    left = list(range(len(processes)))
    while left:
        wait([processes[rank][0].sentinel for rank in left])
        for rank in left.copy():
            process, reader = processes[rank]
            if process.exitcode is None:
                continue
            left.remove(rank)
            if process.exitcode:
                raise _failure(rank, process.exitcode, reader)


def _failure(rank: int, status: int, reader: Connection) -> BaseException:
    try:
        error: BaseException = reader.recv()
    except (EOFError, OSError):
        how = signal.Signals(-status).name if status < 0 else f"status {status}"
        return ChildProcessError(
            f"process {rank} of those that train together ended by {how}; the same command "
            "continues the run"
        )
    return error


def _call(function: Callable[..., object], arguments: tuple[Any, ...], writer: Connection) -> None:
    begin_worker()
    try:
        function(*arguments)
    except Exception as error:
        error.add_note(traceback.format_exc())
        writer.send(error)
        sys.exit(1)
