import copy
from concurrent.futures import ThreadPoolExecutor

import pytest
import torch

from hmi_marl.training.runs import exchange
from hmi_marl.training.runs.exchange import SharedMemory

KINDS = [torch.float32, torch.float64, torch.int64, torch.uint8]


def in_threads(count, function):
    """Results of ``function(memory, rank)`` in as many threads as places."""
    memory = SharedMemory(count)

    def call(rank):
        own = copy.copy(memory)  # a place of its own in the same memory
        own.join(rank)
        return function(own, rank)

    with ThreadPoolExecutor(count) as threads:
        return list(threads.map(call, range(count)))


@pytest.mark.parametrize("count", [1, 2, 4])
def test_every_process_gets_the_tensors_of_all_in_the_order_of_ranks(count):
    def gather(memory, rank):
        return [memory.gather(torch.full((2, 3), 7 * rank, dtype=kind)) for kind in KINDS]

    for results in in_threads(count, gather):
        for kind, together in zip(KINDS, results, strict=True):
            assert together.dtype == kind
            assert together.shape == (count, 2, 3)
            assert together[:, 1, 2].tolist() == [7 * rank for rank in range(count)]


@pytest.mark.parametrize("size", [0, 1, 15, 16, 17, 100])
def test_what_does_not_fit_into_a_slot_comes_in_parts(size, monkeypatch):
    monkeypatch.setattr(exchange, "_SLOT", 64)  # bytes: 16 numbers

    def gather(memory, rank):
        return [memory.gather(torch.arange(size) + 1.0 * rank + turn) for turn in range(20)]

    for results in in_threads(3, gather):
        for turn, together in enumerate(results):
            expected = torch.arange(size) + torch.arange(3.0)[:, None] + turn
            assert torch.equal(together, expected)


def test_the_time_in_exchanges_is_counted():
    def gather(memory, rank):
        memory.gather(torch.zeros(3))
        return memory.waited

    assert min(in_threads(2, gather)) > 0
