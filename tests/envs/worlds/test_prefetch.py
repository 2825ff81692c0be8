import numpy as np
import pytest
from numba import njit

from hmi_marl.envs.worlds.batched.prefetch import ask_for_rows


@njit
def ask(table, first, last):
    ask_for_rows(table, first, last)
    return len(table)


@pytest.mark.parametrize("shape", [(0, 5), (4, 0), (1, 1), (7, 100)])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_asking_for_memory_changes_nothing(shape, dtype):
    table = np.arange(shape[0] * shape[1], dtype=dtype).reshape(shape)
    before = table.copy()
    for first, last in ((0, len(table)), (len(table), len(table)), (len(table) // 2, len(table))):
        assert ask(table, first, last) == len(table)
    np.testing.assert_array_equal(table, before)
