"""Settings and fixtures for every test."""

import gc
import os
import pickle
import subprocess
import sys
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import IO, Any

import pytest
from hypothesis import settings

ROOT = Path(__file__).parents[1]

settings.register_profile("patient", deadline=None)  # a busy machine is no failure
settings.load_profile("patient")


COMPILE = """
from standing_world import standing_teams
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.teaming import Teaming

for teams in (Teaming(TeamConfig(), 16, "batched"), standing_teams(16)):
    teams.reset(range(16))
    teams.observe("driver")
    teams.turn([1] * 16, [0] * 16)
"""
"""Compiles the world, its whole step of teams, and the loops over teams in any other world."""
_compiling: list[subprocess.Popen[bytes]] = []


def pytest_configure(config: pytest.Config) -> None:
    """Compile the loops, once, while workers collect tests and run those that need none.

    They wait for it where they need it. Compiling takes half as long again in a process whose
    lines are counted.
    """
    if getattr(config.option, "dist", "no") != "no" and not hasattr(config, "workerinput"):
        surroundings = {k: v for k, v in os.environ.items() if not k.startswith("COVERAGE_")}
        surroundings["PYTHONPATH"] = str(ROOT / "tests")
        command = [sys.executable, "-c", COMPILE]
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        _compiling.append(subprocess.Popen(command, cwd=ROOT, env=surroundings, **quiet))


BEFORE = (
    "experiments/latent_traits/test_probes_regression.py",
    "training/traits/test_airl.py",
    "experiments/protocols/test_experiment.py",
    "envs/test_render.py",
    "experiments/latent_traits/test_assessment.py",
    "exact/test_identify.py",
    "experiments/latent_traits/test_assessment_identification.py",
    "agents/test_graded_oracle.py",
    "envs/worlds/test_highway.py",
    "envs/worlds/test_lidar.py",
    "exact/test_oracle.py",
    "experiments/latent_traits/test_report.py",
    "experiments/latent_traits/test_reward.py",
    "experiments/adaptation/test_experiment_report.py",
    "training/traits/test_discriminator.py",
    "training/traits/test_losses.py",
    "envs/test_merge_v0.py",
    "reproduction",
)
"""Tests that need no compiled loop and take long, those that take longest first."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Let both halves begin with tests that run while the loops are compiled."""
    halves: tuple[list[pytest.Item], list[pytest.Item]] = ([], [])
    others: list[pytest.Item] = []
    places = {ROOT / "tests" / place: number for number, place in enumerate(BEFORE)}

    @cache  # many tests are in one file
    def place_of(path: Path) -> int:
        return next((places[each] for each in (path, *path.parents) if each in places), len(places))

    for item in sorted(items, key=lambda item: place_of(item.path)):
        number = place_of(item.path)
        (halves[number % 2] if number < len(places) else others).append(item)
    middle = len(others) // 2
    items[:] = [*halves[0], *others[:middle], *halves[1], *others[middle:]]


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Collect garbage among what tests make, and not among the modules that they share.

    With half a million objects of modules, each collection took a tenth of a second.
    """
    gc.disable()
    try:
        return (yield)
    finally:
        gc.collect()
        gc.freeze()
        gc.set_threshold(20_000, 20, 20)
        gc.enable()


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


@contextmanager
def _no_drawing() -> Iterator[None]:
    from matplotlib.figure import Figure

    def savefig(figure: Figure, file: IO[bytes], **_: object) -> None:
        file.write(b"\x89PNG")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Figure, "savefig", savefig)
        yield


@pytest.fixture
def undrawn() -> Iterator[None]:
    """Make figures, but draw none of them, which takes half a second for each way to show it.

    For tests of something else, where those of the same report draw its figures.
    """
    with _no_drawing():
        yield


@pytest.fixture(scope="module")
def module_undrawn() -> Iterator[None]:
    """:func:`undrawn` for a fixture of a module."""
    with _no_drawing():
        yield


def _calls_here(
    function: Callable[..., Any], tasks: Sequence[tuple[Any, ...]], *_: Any
) -> Iterator[Any]:
    """Make the calls of worker processes here, with all that is sent to them and comes back."""
    for task in tasks:
        sent, arguments = pickle.loads(pickle.dumps((function, task)))
        yield pickle.loads(pickle.dumps(sent(*arguments)))


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
