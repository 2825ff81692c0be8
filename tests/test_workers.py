import os
import signal
import sys
import time

import pytest

from hmi_marl.workers import calls, pool, results


def threads_here(_):
    import numba

    return os.environ["OMP_NUM_THREADS"], numba.config.NUMBA_NUM_THREADS


def remember(text):
    os.environ["REMEMBERED"] = text


def remembered(_):
    return os.environ["REMEMBERED"]


def fail(folder, number):
    (folder / str(number)).touch()
    if number == 0:
        raise ValueError("the first one fails")


def all_of(futures):
    return [future.result() for future in futures]


def test_every_worker_has_one_thread_and_this_process_keeps_its_own(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "5")
    monkeypatch.delenv("NUMBA_NUM_THREADS", raising=False)
    with pool(1) as workers:
        assert list(workers.map(threads_here, range(2))) == [("1", 1)] * 2
    assert os.environ["OMP_NUM_THREADS"] == "5"
    assert "NUMBA_NUM_THREADS" not in os.environ


def test_workers_call_begin_first():
    with pool(1, remember, "this") as workers:
        assert workers.submit(remembered, None).result() == "this"


def test_what_has_not_begun_is_dropped_when_one_fails(tmp_path):
    count = 20_000
    with pool(1) as workers:
        futures = [workers.submit(fail, tmp_path, number) for number in range(count)]
        with pytest.raises(ValueError, match="the first one fails"):
            all_of(futures)
    assert len(list(tmp_path.iterdir())) < count


def process_of(number):
    return number, os.getpid()


def test_results_come_in_the_order_of_their_tasks():
    here = list(results(process_of, [3, 1, 2], workers=1))
    assert here == [(number, os.getpid()) for number in (3, 1, 2)]
    apart = list(results(process_of, [3, 1, 2], workers=2))
    assert [number for number, _ in apart] == [3, 1, 2]
    assert os.getpid() not in {process for _, process in apart}


def die_or_wait(number):
    if number == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(600)


def fail_or_wait(number):
    if number == 1:
        raise ValueError("the second one fails")
    time.sleep(600)


@pytest.mark.skipif(sys.platform == "win32", reason="kills as POSIX does")
def test_a_killed_worker_ends_the_others_and_is_reported():
    with pytest.raises(ChildProcessError, match=r"a worker process was killed.*fewer --workers"):
        list(results(die_or_wait, [0, 1], workers=2))


def test_an_error_ends_those_before_it_at_once():
    began = time.monotonic()
    with pytest.raises(ValueError, match="the second one fails"):
        list(calls(fail_or_wait, [(0,), (1,)], 2))
    assert time.monotonic() - began < 300  # the first would go on for 600 s
