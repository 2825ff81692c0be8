"""Processes that learn together, and their connection."""

from __future__ import annotations

import atexit
import os
from dataclasses import dataclass

import torch

from hmi_marl.training.runs.exchange import Distributed, Exchange, SharedMemory


@dataclass(frozen=True)
class Processes:
    """Number of processes that learn together, and the place of this one among them."""

    count: int = 1
    rank: int = 0
    local_rank: int = 0
    """Rank on this machine."""
    exchange: Exchange | None = None
    """Connection to the others; None for a single process."""

    @property
    def is_first(self) -> bool:
        """Whether this process writes files and shows progress."""
        return self.rank == 0

    @property
    def seconds_waited(self) -> float:
        """Time spent in exchanges so far, most of it waiting for the others [s]."""
        return 0.0 if self.exchange is None else self.exchange.waited

    def device(self, wanted: str) -> str:
        """Return the device to learn on: ``auto`` is this process's GPU if there is one.

        Raises:
            ValueError: there is no such device.
        """
        if wanted == "auto":
            wanted = "cuda" if torch.cuda.is_available() else "cpu"
        if wanted == "cuda" and torch.cuda.is_available():
            wanted = f"cuda:{self.local_rank}"
        if wanted.startswith("cuda") and not torch.cuda.is_available():
            raise ValueError(f"device {wanted!r} was asked for, but torch sees no GPU; use cpu")
        try:
            torch.empty(0, device=wanted)
        except RuntimeError as error:
            raise ValueError(f"no device {wanted!r}: {str(error).splitlines()[0]}") from None
        return wanted

    def gather(self, values: torch.Tensor) -> list[torch.Tensor]:
        """Return the tensors of every process, by rank; this may be all there is, its own."""
        if self.exchange is None:
            return [values]
        return list(self.exchange.gather(values).unbind())

    def wait(self) -> None:
        """Wait until every process has come here."""
        self.gather(torch.zeros(1))


ALONE = Processes()
"""This process alone."""


def joined(memory: SharedMemory | None = None, rank: int = 0, on_gpus: bool = False) -> Processes:
    """Return this process's place among those that were started together.

    Args:
        memory: of the processes that :func:`hmi_marl.training.runs.start.start_together` started;
            None for those that torchrun started, if it did.
        rank: place of this one among them.
        on_gpus: whether they learn on GPUs, which exchange gradients by NCCL.
    """
    if memory is not None:
        memory.join(rank)
        local = Processes(memory.count, rank, rank, memory)
        return _by_torch(local) if on_gpus else local
    count = int(os.environ.get("WORLD_SIZE", "1"))
    if count == 1:
        return ALONE
    if not torch.distributed.is_initialized():
        torch.distributed.init_process_group(_backend())
        atexit.register(_disconnect)
    rank = torch.distributed.get_rank()
    return Processes(count, rank, int(os.environ["LOCAL_RANK"]), Distributed(count))


def _by_torch(local: Processes) -> Processes:
    """Connect processes of this machine by torch.distributed, at a port that the first one gets."""
    from torch.distributed import TCPStore  # type: ignore[attr-defined]  # it is there

    count = local.count
    if local.is_first:
        store = TCPStore("127.0.0.1", 0, count, True, wait_for_workers=False)
        local.gather(torch.tensor([store.port]))
    else:
        port = int(local.gather(torch.tensor([0]))[0])
        store = TCPStore("127.0.0.1", port, count, False)
    torch.distributed.init_process_group(_backend(), store=store, rank=local.rank, world_size=count)
    atexit.register(_disconnect)
    return Processes(count, local.rank, local.local_rank, Distributed(count))


def _backend() -> str:
    """Gloo for tensors on the CPU, and NCCL for those on a GPU."""
    nccl = torch.cuda.is_available() and torch.distributed.is_nccl_available()
    return "cpu:gloo,cuda:nccl" if nccl else "gloo"


def _disconnect() -> None:
    if torch.distributed.is_initialized():
        torch.distributed.destroy_process_group()
