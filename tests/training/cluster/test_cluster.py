"""The side of the command, with nodes that are played here; test_two_nodes.py has real ones."""

from __future__ import annotations

import signal
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from hmi_marl.ownership import FolderInUseError, owned
from hmi_marl.training.cluster import cluster
from hmi_marl.training.cluster.cluster import Cluster, connected
from hmi_marl.training.run_tasks import RunTask


class RayError(Exception):
    pass


class NodeDiedError(RayError):
    pass


class FakeRay:
    """Plays what each worker of a task says: a list of news for each time that it is started."""

    def __init__(self, plays: dict[str, list[list[Any]]], cores: int = 2) -> None:
        self.plays, self.cores = plays, cores
        self.started: list[tuple[str, dict[str, bytes], tuple[Any, ...]]] = []
        self.killed: list[str] = []
        self.most = 0
        names = {"RayError": RayError, "RayTaskError": type("RayTaskError", (RayError,), {})}
        self.exceptions = SimpleNamespace(**names)

    def remote(self, **_: Any) -> Any:
        return lambda kind: SimpleNamespace(remote=self._start)

    def _start(self, task: RunTask, state: dict[str, bytes], needed: object, *reads: Any) -> Any:
        self.started.append((task.folder.name, dict(state), reads))
        said = iter(self.plays[task.folder.name].pop(0))
        ask = SimpleNamespace(remote=lambda: (task.folder.name, said, object()))
        nothing = SimpleNamespace(remote=lambda: ("", iter([]), object()))
        return SimpleNamespace(news=ask, stop=nothing, name=task.folder.name)

    def wait(self, asked: list[Any], num_returns: int = 1, timeout: float = 0) -> Any:
        self.most = max(self.most, len(asked))
        return asked[:1], asked[1:]

    def get(self, asked: Any) -> Any:
        found = next(asked[1])
        if isinstance(found, Exception):
            raise found
        return found

    def put(self, content: Any) -> Any:
        return ("put", content)

    def kill(self, worker: Any) -> None:
        self.killed.append(worker.name)

    def cluster_resources(self) -> dict[str, float]:
        return {"CPU": float(self.cores)}


def saved(**files: bytes) -> tuple[str, Any]:
    return "saved", (files,)


ENDED = ("ended", ())


@pytest.fixture
def learn(monkeypatch, tmp_path):
    def go(plays: dict[str, list[list[Any]]], reads: tuple[Path, ...] = (), **how: Any) -> FakeRay:
        ray = FakeRay(plays, **how)
        monkeypatch.setattr(cluster, "_ray", lambda: ray)
        go.ray = ray  # type: ignore[attr-defined]
        tasks = [RunTask(print, (), tmp_path / name, reads) for name in plays]
        Cluster().learn(tasks, quiet=True)
        return ray

    return go


def test_states_are_written_into_the_folder_that_the_command_owns(learn, tmp_path):
    begin = ("begin", ("a", 2, 0, "steps"))
    ray = learn({"a": [[[begin, ("phase", ("a: x",)), ("advance", (1, {"return": 1.0}))],
                        [], [saved(one=b"1", two=b"2")], [saved(one=b"3"), ENDED]]]})  # fmt: skip
    assert {path.name: path.read_bytes() for path in (tmp_path / "a").iterdir()} == {
        "one": b"3",
        "two": b"2",
    }
    assert ray.killed == ["a"]


def test_a_task_of_a_lost_node_goes_on_from_its_latest_state(learn, tmp_path, capsys):
    lost = [[saved(one=b"1")], NodeDiedError("gone")]
    killed = [[saved(one=b"2"), ("lost", ("SIGKILL",))]]
    ray = learn({"a": [lost, killed, [[saved(one=b"3"), ENDED]]], "b": [[[ENDED]]]})
    states = [state for name, state, _ in ray.started if name == "a"]
    assert states == [{}, {"one": b"1"}, {"one": b"2"}]
    assert (tmp_path / "a" / "one").read_bytes() == b"3"
    told = [line for line in capsys.readouterr().err.splitlines() if "lost" in line]
    assert len(told) == 2
    assert "of a was lost (NodeDiedError); it goes on elsewhere" in told[0]


def test_a_task_that_is_lost_again_and_again_ends_the_command(learn):
    with pytest.raises(ChildProcessError, match=r"a was lost 3 times in a row \(NodeDiedError\)"):
        learn({"a": [[NodeDiedError()]] * 3})


def test_the_first_error_ends_all_and_names_the_folder_here(learn, tmp_path):
    failed = ("failed", (ValueError("damaged: /tmp/x/run/a/checkpoint"), "/tmp/x/run/a"))
    with pytest.raises(ValueError, match=f"damaged: {tmp_path}/a/checkpoint"):
        learn({"b": [[[]] * 50], "a": [[[failed]]]})
    assert sorted(learn.ray.killed) == ["a", "b"]


def test_no_more_tasks_run_than_there_are_cores(learn):
    ray = learn({name: [[[], [ENDED]]] for name in "abcde"}, cores=2)
    assert ray.most == 2
    assert len(ray.started) == 5


def test_what_tasks_read_is_sent_once(learn, tmp_path):
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "told").write_bytes(b"x")
    ray = learn({name: [[[ENDED]]] for name in "ab"}, (tmp_path / "data",))
    reads = [each[2][0] for each in ray.started]
    assert reads[0] == ("put", {"data/told": b"x"})
    assert reads[0] is reads[1]


def test_a_folder_that_another_command_owns_is_refused_before_anything_starts(learn, tmp_path):
    entered, leave = threading.Event(), threading.Event()

    def own() -> None:
        with owned(tmp_path / "a"):
            entered.set()
            leave.wait()

    other = threading.Thread(target=own)
    other.start()
    entered.wait()
    try:
        with pytest.raises(FolderInUseError):
            learn({"a": [[[ENDED]]]})
    finally:
        leave.set()
        other.join()
    assert learn.ray.started == []


def test_no_address_is_no_cluster_and_imports_nothing():
    with connected(None) as found:
        assert found is None


@pytest.mark.parametrize("address", ["nope", "host:many", "ray://", ":1", "host:99999"])
def test_what_is_no_address_is_refused(address):
    with (
        pytest.raises(ValueError, match=r"auto, local, HOST:PORT or ray://HOST:PORT, not"),
        connected(address),
    ):
        pass


def test_where_nothing_listens_is_told_at_once():
    with (
        pytest.raises(ConnectionError, match=r"no Ray cluster at ray://127\.0\.0\.1:9: "),
        connected("ray://127.0.0.1:9"),
    ):
        pass


def test_handlers_of_signals_stay_as_they_are():
    before = signal.getsignal(signal.SIGTERM)
    with cluster._same_signals():
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
    assert signal.getsignal(signal.SIGTERM) == before


def test_a_node_is_asked_by_code_that_does_not_need_this_package():
    asked = cluster._versions_there(("numpy", "no-such-package"))
    assert asked()["no-such-package"] == "none"
    assert asked()["numpy"][0].isdigit()
    assert "hmi_marl" not in asked.__code__.co_names


def test_without_a_core_it_says_that_it_waits(learn, capsys):
    ray = learn({"a": [[[], [], [ENDED]]]}, cores=0)
    assert capsys.readouterr().err.count("no node has a core; waiting until one joins") == 1
    assert ray.most == 1


def test_folders_are_free_again_and_those_of_a_failure_are_removed(learn, tmp_path):
    failed = ("failed", (ValueError("no"),))
    with pytest.raises(ValueError, match="no"):
        learn({"a": [[[ENDED]]], "b": [[[failed]]], "c": [[[], []]]}, cores=1)
    assert [path.name for path in tmp_path.iterdir()] == ["a"]
    assert list((tmp_path / "a").iterdir()) == []
