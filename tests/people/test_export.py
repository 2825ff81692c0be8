"""Data of people in files, and trait models that learn from them."""

import csv
from dataclasses import replace

import numpy as np
import pytest
from people.trips import a_trip

from hmi_marl.agents.rollout import Observer
from hmi_marl.demonstrations.dataset import STATE_PARTS
from hmi_marl.demonstrations.env import team_of
from hmi_marl.people.export import demonstrations_of, export
from hmi_marl.people.record import ReplayError, TripRecord, replay
from hmi_marl.people.store import Store
from hmi_marl.reading import read_json


@pytest.fixture(scope="module")
def records():
    """Trips of the driver's seat, one of which crashes, and one of each other kind."""
    driven = [a_trip("standing", seed=seed).record() for seed in range(6)]
    assert any(record.crashed for record in driven)
    return driven


@pytest.fixture(scope="module")
def place(records, tmp_path_factory):
    """A database of two people, the second of whom also has trips that are no demonstrations."""
    path = tmp_path_factory.mktemp("people") / "people.db"
    with Store(path) as store:
        codes = []
        for part in (records[:3], [*records[3:], *others()]):
            visitor = store.new_visitor()
            session = store.new_session(visitor.number, "play")
            for record in part:
                store.begin_trip(session, replace(record, visitor=visitor.name))
            store.answer(session, "=like", {"text": '=1+1, "quoted"\nand more'})
            codes.append(visitor.code)
    return path


def others():
    graded, ai = a_trip("graded", seed=1), a_trip("standing", "vehicle_ai", seed=1)
    return [graded.record(), ai.record(), a_trip("standing", seed=1, steps=0).record()]


def rows_of(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


class Steps(Observer):
    def __init__(self):
        self.rows = []

    def after(self, teaming, result):
        now = teaming.attention
        whole = [teaming.alerted, now.distracted, now.accepted, now.counter, now.fatigue]
        self.rows.append([*(int(x[0]) for x in whole), float(teaming.ego.x[0])])


def test_csv_and_json_hold_what_the_trips_were(place, tmp_path):
    with Store(place, make=False) as store:
        written = export(store, tmp_path, ("csv", "json"))
        trips = list(store.trips())
    assert [path.name for path in written] == [
        "trips.csv", "steps.csv", "answers.csv", "sessions.csv", "trips",
    ]  # fmt: skip
    table, steps = rows_of(tmp_path / "trips.csv"), rows_of(tmp_path / "steps.csv")
    assert len(table) == len(trips) == 9
    for trip, row in zip(trips, table, strict=True):
        record = trip.record
        assert (int(row["trip"]), int(row["steps"])) == (trip.number, len(record))
        assert (row["visitor"], row["seat"]) == (record.visitor, record.seat)
        assert row["attention"] == ("chain" if record.looking_away is None else "person")
        watched = Steps()
        replay(record, observers=[watched])
        own = [each for each in steps if int(each["trip"]) == trip.number]
        names = ("alert", "distracted", "accepted", "counter", "fatigue")
        told = [[*(int(each[name]) for name in names), float(each["x"])] for each in own]
        assert told == watched.rows
        kept = TripRecord.from_json(read_json(tmp_path / "trips" / f"{trip.number}.json"))
        assert kept == record
    answers = rows_of(tmp_path / "answers.csv")
    assert [row["question"] for row in answers] == ["'=like", "'=like"]  # no formula
    assert answers[0]["value"].startswith('{"text"')


def test_demonstrations_are_the_states_that_a_replay_shows(records):
    named = [replace(record, visitor=f"visitor-{k % 2}") for k, record in enumerate(records)]
    data = demonstrations_of(named)
    observed = data.observed
    assert data.truth is None
    assert observed.names == ("visitor-0", "visitor-1")
    assert observed.driver.tolist() == [0, 1] * 3
    assert observed.crashed.tolist() == [record.crashed for record in records]
    for k, record in enumerate(records):
        steps = int(observed.length[k])
        assert steps == len(record) if not record.crashed else steps <= len(record)
        assert observed.alerts[k, :steps].tolist() == list(record.alerts[:steps])

        class Seen(Observer):
            def __init__(self):
                self.states, self.applied = [], []

            def before(self, teaming):
                layout = teaming.layouts["vehicle_ai"]
                own = layout.columns_of(observed.layout)
                self.states.append(teaming.observe("vehicle_ai", STATE_PARTS)[0, own])

            def after(self, teaming, result):
                self.applied.append(int(teaming.applied[0]))

        seen = Seen()
        replay(record, observers=[seen])
        assert np.array_equal(observed.states[k, :steps], np.array(seen.states)[:steps])
        assert observed.actions[k, :steps].tolist() == seen.applied[:steps]
    assert team_of(observed).scene == records[0].config.scene
    with pytest.raises(ValueError, match="one team's settings"):
        demonstrations_of([records[0], a_trip("paper").record()])
    with pytest.raises(ValueError, match="alerts of one strength"):
        demonstrations_of([a_trip("graded").record()])
    with pytest.raises(ValueError, match="no trip with a step"):
        demonstrations_of([])


def test_parquet_and_minari_hold_the_same_and_only_a_persons_driving(place, tmp_path):
    pytest.importorskip("pyarrow")
    minari = pytest.importorskip("minari")
    from hmi_marl.demonstrations.parquet import read_demonstrations

    with Store(place, make=False) as store:
        parquet, sets = export(store, tmp_path, ("parquet", "minari"))
        driven = [
            trip.record for trip in store.trips()
            if trip.record.seat == "driver" and trip.record.config.alerts.choices == 2
            and len(trip.record)
        ]  # fmt: skip
    data, made = read_demonstrations(parquet.parent), demonstrations_of(driven)
    assert data.truth is None
    for name in ("states", "actions", "alerts", "length", "driver", "crash_step"):
        assert np.array_equal(getattr(data.observed, name), getattr(made.observed, name))
    assert data.observed.about == made.observed.about
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MINARI_DATASETS_PATH", str(sets.parent))
        dataset = minari.load_dataset(sets.name)
    assert dataset.total_episodes == len(driven) == 6


def test_nothing_is_written_if_one_of_the_formats_cannot_be(place, tmp_path, records):
    pytest.importorskip("minari")
    there = tmp_path / "a" / "demonstrations" / "minari" / "hmi_marl-demonstrations-v0"
    there.mkdir(parents=True)
    with Store(place, make=False) as store:
        with pytest.raises(FileExistsError, match="is there already; remove it"):
            export(store, tmp_path / "a", ("csv", "json", "parquet", "minari"))
        assert [path for path in tmp_path.rglob("*") if path.is_file()] == []
    with Store(tmp_path / "own.db") as store:  # of people, but none to learn from
        store.new_visitor()
        with pytest.raises(ValueError, match="there is no trip for demonstrations"):
            export(store, tmp_path / "b", ("csv", "parquet"))
        assert not (tmp_path / "b").exists()
        visitor = store.new_visitor()
        store.begin_trip(store.new_session(visitor.number, "play"), records[0])
        with store.writing() as base:
            base.execute("UPDATE trips SET digest = ?", ("0" * 64,))  # as of another version
        with pytest.raises(ReplayError, match="does not replay as it was"):
            export(store, tmp_path / "c", ("csv", "json"))
        assert not (tmp_path / "c").exists()


def test_export_of_one_person_and_after_deletion(place, tmp_path, records):
    with Store(place, make=False) as store:
        export(store, tmp_path, ("csv",), visitor=1)
        assert {row["visitor"] for row in rows_of(tmp_path / "steps.csv")} == {"visitor-1"}
        assert len(rows_of(tmp_path / "answers.csv")) == 1
    with Store(tmp_path / "own.db") as store:
        visitor = store.new_visitor()
        store.begin_trip(store.new_session(visitor.number, "play"), records[0])
        store.delete_visitor(visitor.code)
        export(store, tmp_path, ("csv",))
        assert rows_of(tmp_path / "steps.csv") == rows_of(tmp_path / "trips.csv") == []
        with pytest.raises(ValueError, match="there is no trip for demonstrations"):
            export(store, tmp_path, ("parquet",))


def test_a_trait_models_windows_take_trips_of_people(records):
    pytest.importorskip("torch")
    from hmi_marl.training.traits.episodes import Episodes
    from hmi_marl.training.traits.windows import Windows, transitions

    named = [replace(record, visitor=f"visitor-{k % 2}") for k, record in enumerate(records)]
    observed = demonstrations_of(named).observed
    windows = Windows(Episodes.of(observed), np.full(len(observed), np.nan))
    pools = windows.draw(np.random.default_rng(0), 4, 3)
    batch = windows.batch(pools)
    assert batch.situations.shape[:3] == (4, 3, observed.actions.shape[1])
    assert {len(set(observed.driver[pool])) for pool in pools} == {1}
    assert len(transitions(batch).actions) == int((observed.length[pools] - 1).sum())


def test_ids_of_a_panel_are_exported_where_they_were_kept(tmp_path):
    with Store(tmp_path / "people.db") as store:
        for state in ({"study": "s", "ids": {"PROLIFIC_PID": "p1"}}, {"study": "s"}, None):
            store.new_session(store.new_visitor().number, "study", state)
        export(store, tmp_path / "out", ["csv"])
    rows = rows_of(tmp_path / "out" / "sessions.csv")
    assert [row["visitor"] for row in rows] == ["visitor-1", "visitor-2", "visitor-3"]
    assert [row["ids"] for row in rows] == ['{"PROLIFIC_PID": "p1"}', "{}", "{}"]
