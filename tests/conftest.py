"""Settings and fixtures for every test."""

import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

ROOT = Path(__file__).parents[1]

settings.register_profile("patient", deadline=None)  # a busy machine is no failure
settings.load_profile("patient")


COMPILE = """
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.worlds import make_world
make_world("batched", TeamConfig().scene, 1)
"""
_compiling: list[subprocess.Popen[bytes]] = []


def pytest_configure(config: pytest.Config) -> None:
    """Compile the batched world, once, while workers collect tests.

    They wait for it where they need it. Compiling takes half as long again in a process whose
    lines are counted.
    """
    if getattr(config.option, "dist", "no") != "no" and not hasattr(config, "workerinput"):
        surroundings = {k: v for k, v in os.environ.items() if not k.startswith("COVERAGE_")}
        command = [sys.executable, "-c", COMPILE]
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        _compiling.append(subprocess.Popen(command, cwd=ROOT, env=surroundings, **quiet))


def pytest_unconfigure() -> None:
    """Leave no process behind."""
    for process in _compiling:
        process.wait()


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


def _calls_here(
    function: Callable[..., None], tasks: Sequence[tuple[Any, ...]], *_: Any
) -> Iterator[None]:
    """Make the calls of worker processes in this process."""
    return (function(*task) for task in tasks)


@contextmanager
def _training_here() -> Iterator[None]:
    from hmi_marl.training import jobs

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(jobs, "calls", _calls_here)
        yield


@pytest.fixture
def trained_here() -> Iterator[None]:
    """Train in this process, which has torch already, what else is trained in worker processes.

    ``tests/training/test_jobs.py`` tests the workers.
    """
    with _training_here():
        yield


@pytest.fixture(scope="module")
def module_trained_here() -> Iterator[None]:
    """:func:`trained_here` for all tests of a module."""
    with _training_here():
        yield
