import numpy as np
import pytest

from hmi_marl.demonstrations.step_rows import StepRows


def test_rows_are_the_steps_of_one_episode_after_the_other() -> None:
    rows = StepRows(np.array([2, 1, 3]))
    assert (len(rows), rows.shape) == (6, (3, 3))
    episode, step = rows.places()
    assert episode.tolist() == [0, 0, 1, 2, 2, 2]
    assert step.tolist() == [0, 1, 0, 0, 1, 2]
    steps = np.arange(9).reshape(3, 3)
    assert rows.of(steps).tolist() == [0, 1, 3, 6, 7, 8]
    pairs = np.stack([steps, -steps], axis=2)
    assert rows.columns_of(pairs).tolist() == [[0, 1, 3, 6, 7, 8], [0, -1, -3, -6, -7, -8]]


def test_arrays_may_be_wider_than_the_longest_episode() -> None:
    rows = StepRows(np.array([2, 2]), 3)
    assert rows.of(np.arange(6).reshape(2, 3)).tolist() == [0, 1, 3, 4]


@pytest.mark.parametrize("length", [[3, 3], [1, 3], [3, 1, 2]])
@pytest.mark.parametrize("size", [1, 2, 100])
def test_rows_are_put_back_where_they_came_from(length: list[int], size: int) -> None:
    rows = StepRows(np.array(length))
    expected = np.arange(1, len(length) * 6 + 1).reshape(len(length), 3, 2)
    expected[np.arange(3) >= np.array(length)[:, None]] = 0
    taken, found = rows.of(expected), np.zeros_like(expected)
    for first in range(0, len(rows), size):
        rows.put(found, first, taken[first : first + size])
    np.testing.assert_array_equal(found, expected)


def test_full_episodes_are_not_copied() -> None:
    rows, steps = StepRows(np.array([4, 4])), np.zeros((2, 4, 5))
    assert np.shares_memory(rows.of(steps), steps)
    large = np.random.default_rng(0).random((20, 100, 3))
    columns = StepRows(np.full(20, 100)).columns_of(large)
    np.testing.assert_array_equal(columns, large.reshape(-1, 3).T)
    assert columns.flags.c_contiguous
