"""Processes started by torchrun that learn together, each with its own teams."""

from __future__ import annotations

import atexit
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import torch


@dataclass(frozen=True)
class Processes:
    """Number of processes that learn together, and the place of this one among them."""

    count: int = 1
    rank: int = 0
    local_rank: int = 0
    """Rank on this machine."""

    @property
    def is_first(self) -> bool:
        """Whether this process writes files and shows progress."""
        return self.rank == 0

    def as_rsl_rl(self) -> dict[str, int] | None:
        """Return rsl_rl's ``multi_gpu_cfg``; None for a single process."""
        if self.count == 1:
            return None
        return {"global_rank": self.rank, "local_rank": self.local_rank, "world_size": self.count}

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

    def wait(self) -> None:
        """Wait until every process has come here."""
        if self.count > 1:
            torch.distributed.barrier()

    def mean(self, values: dict[str, float]) -> dict[str, float]:
        """Return the mean of every value over the processes, in each of them."""
        if self.count == 1:
            return values
        together = torch.tensor(list(values.values()), dtype=torch.float64)
        torch.distributed.all_reduce(together)
        return dict(zip(values, (together / self.count).tolist(), strict=True))


ALONE = Processes()
"""This process alone."""


@contextmanager
def joined() -> Iterator[Processes]:
    """Connect the processes that torchrun started, if it did.

    Gradients of a CPU learner go through gloo, those of a GPU through NCCL. The processes stay
    connected until they end, since connecting again can fail.
    """
    count = int(os.environ.get("WORLD_SIZE", "1"))
    if count == 1:
        yield ALONE
        return
    if not torch.distributed.is_initialized():
        torch.distributed.init_process_group("cpu:gloo,cuda:nccl" if _has_nccl() else "gloo")
        atexit.register(_disconnect)
    yield Processes(count, torch.distributed.get_rank(), int(os.environ["LOCAL_RANK"]))


def _disconnect() -> None:
    if torch.distributed.is_initialized():
        torch.distributed.destroy_process_group()


def _has_nccl() -> bool:
    return torch.cuda.is_available() and torch.distributed.is_nccl_available()
