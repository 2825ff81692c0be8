"""Exchange of numbers among processes that learn together; no torch until they have some.

Processes of one machine exchange them through shared memory, without a network connection.
Processes on several machines, and those that learn on GPUs, use torch.distributed.
"""

from __future__ import annotations

import time
from multiprocessing import get_context
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import torch

_SLOT = 2**18
"""Bytes that a process shows to the others at a time; networks of 64 units need a quarter."""


class Exchange(Protocol):
    """Connection of a process to the others."""

    waited: float
    """Time spent in exchanges so far, most of it waiting for the others [s]."""

    def gather(self, values: torch.Tensor) -> torch.Tensor:
        """Tensors of all processes, in the order of their ranks: shape (processes, ...)."""
        ...


class SharedMemory:
    """Memory that ``count`` processes share; each gets it when it is started, and joins it.

    A process copies its numbers into its own slot, meets the others, and reads all slots. There are
    two sets of slots, used by turns: a process that writes to a set again has met the others since,
    so they have read it.
    """

    def __init__(self, count: int) -> None:
        context = get_context("spawn")
        self.count, self.waited = count, 0.0
        self._memory: Any = context.RawArray("b", 2 * count * _SLOT)
        # One for each pair, since a fast process may be at the next meeting already.
        self._arrived = [[context.Semaphore(0) for _ in range(count)] for _ in range(count)]
        self._rank, self._turn = 0, 0

    def join(self, rank: int) -> None:
        """Take this place among the processes."""
        self._rank = rank
        shape = 2, self.count, _SLOT
        self._slots: NDArray[np.uint8] = np.frombuffer(self._memory, np.uint8).reshape(shape)

    def gather(self, values: torch.Tensor) -> torch.Tensor:
        """See :meth:`Exchange.gather`; of tensors on the CPU."""
        together = values.new_empty((self.count, *values.shape))
        sent = values.contiguous().view(-1).numpy().view(np.uint8)
        received = together.view(self.count, -1).numpy().view(np.uint8)
        for start in range(0, max(len(sent), 1), _SLOT):
            part = sent[start : start + _SLOT]
            slots = self._slots[self._turn % 2]
            self._turn += 1
            slots[self._rank, : len(part)] = part
            self._meet()
            received[:, start : start + _SLOT] = slots[:, : len(part)]
        return together

    def _meet(self) -> None:
        began = time.perf_counter()
        others = [other for other in range(self.count) if other != self._rank]
        for other in others:
            self._arrived[other][self._rank].release()
        for other in others:
            self._arrived[self._rank][other].acquire()
        self.waited += time.perf_counter() - began


class Distributed:
    """The processes of torch.distributed, which are connected already."""

    def __init__(self, count: int) -> None:
        self.count, self.waited = count, 0.0

    def gather(self, values: torch.Tensor) -> torch.Tensor:
        """See :meth:`Exchange.gather`; of tensors on the CPU by gloo, on GPUs by NCCL."""
        import torch

        began = time.perf_counter()
        together = values.new_empty((self.count, *values.shape))
        torch.distributed.all_gather(list(together.unbind()), values.contiguous())
        self.waited += time.perf_counter() - began
        return together
