"""Settings and fixtures for every test."""

import sys
from collections.abc import Iterator
from concurrent.futures import Future
from contextlib import nullcontext

import pytest
from hypothesis import settings

settings.register_profile("patient", deadline=None)  # a busy machine is no failure
settings.load_profile("patient")


@pytest.fixture
def unmeasured(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Leave this test, and the processes that it starts, out of the measure of coverage.

    Plain Python takes half as long again when its lines are counted, highway-env and the imports
    of a new process above all. For tests that run much of it over lines that others count.
    """
    monkeypatch.delenv("COVERAGE_PROCESS_CONFIG", raising=False)
    coverage = sys.modules.get("coverage")
    counting = coverage and coverage.Coverage.current()
    if counting:
        counting.stop()
    yield
    if counting:
        counting.start()


@pytest.fixture
def trained_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Train in this process, which has torch already, what is else trained in worker processes.

    ``tests/training/test_jobs.py`` tests the workers.
    """
    from hmi_marl.training import jobs

    class Here:
        def submit(self, function, *arguments):
            done = Future()
            done.set_result(function(*arguments))
            return done

    monkeypatch.setattr(jobs, "pool", lambda *_: nullcontext(Here()))
