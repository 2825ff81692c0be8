"""A worker without Ray: its process, its messages and what it leaves behind."""

import os
import signal
import tempfile
import time
from pathlib import Path

import pytest

from hmi_marl.training.cluster.node import PACKAGES, Worker, difference, versions
from hmi_marl.training.run_tasks import RunTask
from hmi_marl.training.runs.reports import listener


def count(until: int, folder: Path, other: Path) -> None:
    """Count on from the file in the folder, and say what was found elsewhere."""
    hears = listener()
    assert hears is not None
    assert os.environ["OPENBLAS_NUM_THREADS"] == "1"
    assert os.environ["CUDA_VISIBLE_DEVICES"] == ""
    done = int((folder / "count").read_text()) if (folder / "count").exists() else 0
    hears.begin(folder.name, until, done, "numbers")
    for number in range(done + 1, until + 1):
        (folder / "count").write_text(str(number))
        hears.advance(1, {"return": number})
        hears.saved(folder)
    (folder / "read").write_text((other / "told").read_text())


def fail(folder: Path) -> None:
    raise ValueError(f"cannot learn in {folder / 'x'}")


def die(folder: Path) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def sleep(folder: Path) -> None:
    time.sleep(600)


def messages(worker: Worker) -> list:
    found = []
    while not found or found[-1][0] not in ("ended", "failed", "lost"):
        found += worker.news()
    return found


@pytest.fixture
def no_left_over(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    yield
    assert os.listdir(tmp_path) == []


def test_a_task_goes_on_from_what_was_sent_and_sends_each_state(no_left_over):
    task = RunTask(count, (3,), Path("there/run"), (Path("there/other"),))
    worker = Worker(task, {"count": b"1"}, versions(), {"other/told": b"hello"})
    assert messages(worker) == [
        ("begin", ("run", 3, 1, "numbers")),
        ("advance", (1, {"return": 2})),
        ("saved", ({"count": b"2"},)),
        ("advance", (1, {"return": 3})),
        ("saved", ({"count": b"3"},)),
        ("saved", ({"read": b"hello"},)),
        ("ended", ()),
    ]


def test_an_error_and_a_death_are_told_apart(no_left_over):
    ((name, (error, place)),) = messages(Worker(RunTask(fail, (), Path("run")), {}, versions()))
    assert (name, type(error)) == ("failed", ValueError)
    assert str(error) == f"cannot learn in {place}/x"
    assert messages(Worker(RunTask(die, (), Path("run")), {}, versions())) == [
        ("lost", ("SIGKILL",))
    ]


def test_a_stopped_worker_ends_its_process(no_left_over):
    worker = Worker(RunTask(sleep, (), Path("run")), {}, versions())
    assert worker.news() == []
    worker.stop()
    assert not worker._process.is_alive()


def test_other_versions_are_refused_before_anything_is_made(no_left_over):
    needed = versions() | {"torch": "1.0"}
    ((name, (error,)),) = Worker(RunTask(sleep, (), Path("run")), {}, needed).news()
    assert name == "failed"
    assert str(error).startswith("a node has torch ")
    assert str(error).endswith("not 1.0 as here; install the same there")


def test_versions_are_compared_without_those_of_builds():
    here = versions()
    assert set(here) == set(PACKAGES)
    assert "+" not in "".join(here.values())
    assert difference(here, here) is None
    assert difference({}, here) == f"hmi-marl none, not {here['hmi-marl']} as here"
