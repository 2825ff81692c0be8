"""``hmi-marl people traits``: from recordings to a driver that other commands take."""

import json
from dataclasses import replace

import pytest
from cited import missing_in, reports_written

from hmi_marl.cli import main
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import DRIVERS, Traits, get_driver
from hmi_marl.envs.scene import Scene
from hmi_marl.files import write_json
from hmi_marl.people.export import export
from hmi_marl.people.measure.scripted import simulate_calibrations
from hmi_marl.people.measure.trip_files import read_trips
from hmi_marl.people.store import Store

CONFIG = TeamConfig(driver="average", scene=Scene(vehicles=(1, 1)), end_at_crash=False)


@pytest.fixture(scope="module")
def recordings(tmp_path_factory):
    """A folder of a visitor's trips, each in a file, and a list of two visitors' in one file."""
    folder = tmp_path_factory.mktemp("recordings")
    trips = simulate_calibrations(Traits.of([DRIVERS["average"]]), CONFIG, 5)[0]
    for place, trip in enumerate(trips):
        write_json(folder / "trips" / f"{place}.json", replace(trip, visitor="ada").to_json())
    both = [replace(trips[0], visitor=name).to_json() for name in ("ada", "bob")]
    write_json(folder / "both.json", both)
    free = replace(trips[0], looking_away=None)
    write_json(folder / "free.json", free.to_json())
    return folder


def run(recordings, tmp_path, *words):
    out = str(tmp_path / "measured")
    return main(["people", "traits", *(str(recordings / word) for word in words[:1]), *words[1:],
                 "--widths", "0.5", "--out", out])  # fmt: skip


def test_a_person_becomes_a_driver(recordings, tmp_path, capsys):
    name = ["--name", "visitor-17"]
    with reports_written() as reports:
        assert run(recordings, tmp_path, "trips", *name) == 0
    assert [missing_in(report) for report in reports] == [[]]
    printed = capsys.readouterr().out
    for words in ("looks away, per step", "lisa", "own (optimal", "Minutes needed", "not contrad"):
        assert words in printed
    file = tmp_path / "measured" / "visitor-17.json"
    driver = get_driver(str(file))
    assert driver.beta == pytest.approx(0.5, abs=0.15)
    page = tmp_path / "measured" / "visitor-17"
    assert {each.name for each in page.iterdir()} >= {"index.html", "traits.json", "traits.png"}
    numbers = json.loads((page / "traits.json").read_text())
    assert numbers["estimates"]["beta"]["low"] < 0.5 < numbers["estimates"]["beta"]["high"]
    assert len(numbers["tests"]) == 4
    assert main(["oracle", "--driver", str(file), "--out", str(tmp_path)]) == 0
    assert "visitor-17" in capsys.readouterr().out


def test_one_of_several_visitors_is_chosen(recordings, tmp_path, capsys):
    words = ["--driver-policy", "none"]
    assert run(recordings, tmp_path, "both.json", *words) == 2
    assert "choose one with --visitor: ada, bob" in capsys.readouterr().err
    with reports_written() as reports:
        assert run(recordings, tmp_path, "both.json", *words, "--visitor", "bob") == 0
    assert [missing_in(report) for report in reports] == [[]]
    assert "not measured" in capsys.readouterr().out
    assert get_driver(str(tmp_path / "measured" / "person.json")).inflation == 6.0


def test_a_database_and_the_folder_of_its_export_are_recordings_too(recordings, tmp_path, capsys):
    trip, database = read_trips([recordings / "trips"])[0], tmp_path / "people.db"
    with Store(database) as store:
        visitor = store.new_visitor()
        session = store.new_session(visitor.number, "play")
        store.begin_trip(session, replace(trip, visitor=visitor.name))
        export(store, tmp_path / "out", ["json"])
    words = ["--driver-policy", "none", "--visitor", "visitor-1"]
    estimates = []
    for source in (database, tmp_path / "out"):
        assert run(tmp_path, tmp_path, source.name, *words) == 0
        numbers = json.loads((tmp_path / "measured" / "person" / "traits.json").read_text())
        estimates.append(numbers["estimates"])
    assert estimates[0] == estimates[1]
    assert "person: 1 trips of 0.3 minutes" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["free.json"], "in none of 1 trips a person drove with the second task"),
        (["nothing.json"], "nothing.json"),
        (
            ["both.json", "--visitor", "eve"],
            "no trip is of visitor 'eve'; there are trips of ada",
        ),
        (["trips", "--name", "a/b"], "--name has letters"),
        (["trips", "--driver-policy", "rule"], "must give its probabilities"),
        (["trips", "--widths", "2"], "the width of an interval lies in"),
    ],
)
def test_what_cannot_be_measured_is_one_line(words, message, recordings, tmp_path, capsys):
    if "--widths" in words:
        out = str(tmp_path / "measured")
        assert main(["people", "traits", str(recordings / words[0]), *words[1:], "--out", out]) == 2
    else:
        assert run(recordings, tmp_path, *words) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert not (tmp_path / "measured").exists()


def test_something_else_is_named(recordings, tmp_path, capsys):
    write_json(tmp_path / "odd.json", [{"format": "hmi-marl trip 1"}])
    assert main(["people", "traits", str(tmp_path / "odd.json")]) == 2
    assert "odd.json, trip 0: " in capsys.readouterr().err
