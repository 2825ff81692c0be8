"""hmi-marl people: export and deletion, from the command line."""

import sys

import pytest
from people.trips import a_trip

from hmi_marl.cli import main
from hmi_marl.extras import EXTRAS
from hmi_marl.people.store import Store


@pytest.fixture
def visitors(tmp_path, monkeypatch):
    """Two people with a trip each."""
    monkeypatch.chdir(tmp_path)
    with Store(tmp_path / "people.db") as store:
        people = [store.new_visitor() for _ in range(2)]
        for visitor in people:
            session = store.new_session(visitor.number, "play")
            store.begin_trip(session, a_trip(seed=1, visitor=visitor.name).record())
    return people


def test_export_without_extras_and_delete_by_code(visitors, monkeypatch, capsys):
    for module in EXTRAS["data"] + EXTRAS["people"]:
        monkeypatch.setitem(sys.modules, module, None)
    assert main(["people", "export", "people.db", "--out", "all"]) == 0
    assert capsys.readouterr().out == (
        "written: all/trips.csv, all/steps.csv, all/answers.csv, all/sessions.csv, all/trips\n"
    )
    assert main(["people", "delete", "people.db", visitors[0].code.lower()]) == 0
    assert capsys.readouterr().out.startswith(
        "deleted visitor-1: rows of 1 visitors, 1 sessions, 1 trips, "
    )
    assert main(["people", "export", "people.db", "--out", "rest", "--formats", "csv"]) == 0
    with open("rest/trips.csv") as file:
        assert [line.split(",")[1] for line in file][1:] == ["visitor-2"]
    assert main(["people", "delete", "people.db", visitors[0].code]) == 2
    assert "has this code" in capsys.readouterr().err


def test_an_empty_file_is_no_database_to_read(tmp_path, capsys):
    path = tmp_path / "empty.db"
    path.touch()
    assert main(["people", "export", str(path), "--out", str(tmp_path / "out")]) == 2
    assert capsys.readouterr().err == (
        f"hmi-marl: {path} is empty, and no database; name another file\n"
    )
    assert path.read_bytes() == b""
    assert not (tmp_path / "out").exists()
