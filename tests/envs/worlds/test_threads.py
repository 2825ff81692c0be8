import numpy as np
import pytest

from hmi_marl.envs.worlds.batched.threads import Pace, new_progress, share, take


def drive(pace, steps, cost):
    """Take steps that cost what ``cost`` says of their threads; returns the threads of each."""
    taken = []
    for step in range(steps):
        threads = pace.threads(4)
        taken.append(threads)
        pace.note(threads, cost(step, threads))
    return taken


@pytest.mark.parametrize(("alone", "kept"), [(2.0, 4), (0.5, 1)])
def test_the_faster_way_is_kept_and_trials_are_rare(alone, kept):
    taken = drive(Pace(), 5000, lambda step, threads: alone if threads == 1 else 1.0)
    assert set(taken) == {1, 4}
    assert np.mean(np.array(taken) == kept) > 0.98


def test_it_changes_over_when_the_other_way_becomes_faster():
    def cost(step, threads):
        busy = 1000 <= step < 3000
        return 1.0 if (threads == 1) == busy else 2.0

    taken = drive(Pace(), 5000, cost)
    assert set(taken[1600:2990]) == {1, 4}
    assert np.mean(np.array(taken[1600:2990]) == 1) > 0.95
    assert np.mean(np.array(taken[3600:]) == 4) > 0.95


def test_one_slow_step_changes_nothing():
    def cost(step, threads):
        return 100.0 if step % 97 == 0 else (2.0 if threads == 1 else 1.0)

    assert np.mean(np.array(drive(Pace(), 5000, cost)) == 4) > 0.98


def test_with_one_thread_there_is_nothing_to_choose():
    pace = Pace()
    for _ in range(1200):
        assert pace.threads(1) == 1
        pace.note(1, 1.0)


@pytest.mark.parametrize("threads", [1, 2, 5])
@pytest.mark.parametrize("count", [1, 31, 32, 33, 1000])
def test_every_world_is_taken_exactly_once(count, threads):
    visits = np.zeros(count, np.int64)

    def loop(progress):
        first, last = take(progress, 0, count)
        while first < last:
            visits[first:last] += 1
            first, last = take(progress, last - first, count)

    share(loop, count, threads)
    assert (visits == 1).all()


@pytest.mark.parametrize(
    ("count", "threads", "part"),
    [(5000, 1, 32), (3, 0, 32), (32, 2, 8), (1024, 2, 16), (4096, 2, 32), (4096, 16, 8)],
)
def test_parts_are_neither_small_nor_large(count, threads, part):
    assert new_progress(count, threads).tolist() == [0, 0, part]
