"""The database of people: transactions, kills, writers at the same time, other files, deletion."""

import json
import os
import signal
import sqlite3
import threading
import time
from dataclasses import replace

import numpy as np
import pytest
from people.trips import a_trip

from hmi_marl.people.record import Progress
from hmi_marl.people.store import Store, visitor_name


@pytest.fixture(scope="module")
def records():
    """Finished trips of both seats, and one without real attention."""
    driven = [a_trip(seed=seed).record() for seed in range(3)]
    return [*driven, a_trip(seed=5, seen=False).record(), a_trip(seat="vehicle_ai").record()]


@pytest.fixture
def store(tmp_path):
    with Store(tmp_path / "people.db") as store:
        yield store


def cut(record, steps):
    """The first steps of a trip."""
    away = record.looking_away
    return replace(
        record,
        intents=record.intents[:steps],
        alerts=record.alerts[:steps],
        looking_away=None if away is None else away[:steps],
        crashed=record.crashed and steps == len(record),
        digest=record.digest if steps == len(record) else "",
    )


def fill(store, records, visitors=2):
    """Some people, each with all these trips and some answers; returns them."""
    people = []
    for number in range(visitors):
        visitor = store.new_visitor()
        session = store.new_session(visitor.number, "play", {"at": number})
        for record in records:
            store.begin_trip(session, replace(record, visitor=visitor.name))
        for question in ("age", "sex"):
            store.answer(session, question, [question, number])
        people.append(visitor)
    return people


def dump(path):
    """All rows of all tables."""
    base = sqlite3.connect(path)
    names = [row[0] for row in base.execute("SELECT name FROM sqlite_master WHERE type = 'table'")]
    rows = {name: base.execute(f"SELECT * FROM {name}").fetchall() for name in names}
    base.close()
    return {name: found for name, found in rows.items() if not name.startswith("sqlite_")}


def test_what_is_kept_is_found_again_in_another_process(store, records):
    visitor, other = fill(store, records)
    with Store(store.path) as again:
        found = list(again.trips(visitor.number))
        assert [trip.record for trip in found] == [
            replace(record, visitor=visitor.name) for record in records
        ]
        assert len(list(again.trips())) == 2 * len(records)
        (session,) = again.sessions(other.number)
        assert (session.kind, session.state, session.visitor) == ("play", {"at": 1}, other.number)
        assert [(a.question, a.value) for a in again.answers(session.id)] == [
            ("age", ["age", 1]), ("sex", ["sex", 1]),
        ]  # fmt: skip
        assert again.find_visitor(visitor.code) == visitor.number
        assert again.session("no") is None


def test_a_code_is_read_in_any_case_and_grouping_and_not_kept(store):
    visitor = store.new_visitor()
    typed = "-".join(visitor.code[at : at + 4].lower() for at in range(0, 16, 4))
    assert store.find_visitor(f" {typed} ") == visitor.number
    assert store.find_visitor(visitor.code[:-1]) is None
    assert visitor.code not in repr(dump(store.path))
    assert visitor_name(visitor.number) == visitor.name == "visitor-1"


def test_the_file_is_for_its_owner_alone(store, records):
    fill(store, records[:1], 1)
    files = list(store.path.parent.glob("people.db*"))
    assert len(files) == 3  # with SQLite's log and its index
    assert {path.stat().st_mode & 0o777 for path in files} == {0o600}


def test_a_running_trip_grows_by_what_is_new(store, records):
    session = store.new_session(store.new_visitor().number, "play")
    numbers = [store.begin_trip(session, cut(record, 0)) for record in records]
    for steps in (1, 4, 4, 9, 15):
        now = {
            number: cut(record, min(steps, len(record)))
            for number, record in zip(numbers, records, strict=True)
        }
        store.save_trips(now)
        for number, record in now.items():
            assert store.trip(number).record == record
    assert [trip.number for trip in store.trips(finished=True)] == numbers
    assert list(store.trips(finished=False)) == []


def test_no_decisions_change_nothing(store, records):
    seen = next(record for record in records if record.looking_away is not None)
    number = store.begin_trip(store.new_session(store.new_visitor().number, "play"), seen)
    before = dump(store.path)
    store.add_decisions({number: Progress(len(seen), (), False, "", False)})
    assert dump(store.path) == before


def test_a_trip_that_goes_back_or_otherwise_is_refused_and_nothing_of_the_batch_is_kept(
    store, records
):
    session = store.new_session(store.new_visitor().number, "play")
    first, second = (store.begin_trip(session, cut(record, 5)) for record in records[:2])
    before = dump(store.path)
    otherwise = replace(cut(records[1], 7), alerts=tuple(1 - a for a in records[1].alerts[:7]))
    for wrong in (cut(records[1], 4), otherwise):
        with pytest.raises(ValueError, match="is further, or went otherwise"):
            store.save_trips({first: cut(records[0], 9), second: wrong})
        assert dump(store.path) == before
    with pytest.raises(ValueError, match="has no trip 99"):
        store.save_trips({99: cut(records[0], 0)})
    with pytest.raises(ValueError, match="there is no trip 99"):
        store.trip(99)


def test_the_first_answer_stays_however_often_it_is_sent(store):
    session = store.new_session(store.new_visitor().number, "study")
    assert store.answer(session, "safe", 5) == 5
    assert store.answer(session, "safe", 5) == 5
    assert store.answer(session, "safe", 2) == 5
    assert [answer.value for answer in store.answers(session)] == [5]
    store.save_session(session, {"page": 3})
    assert store.session(session).state == {"page": 3}
    for call in (
        lambda: store.answer("no", "safe", 5),
        lambda: store.save_session("no", 1),
        lambda: store.new_session(99, "play"),
        lambda: store.begin_trip("no", a_trip(steps=0).record()),
    ):
        with pytest.raises(ValueError, match="no"):
            call()
    with pytest.raises(ValueError, match="JSON"):
        store.answer(session, "risky", float("nan"))
    assert [answer.question for answer in store.answers()] == ["safe"]


def test_deleting_takes_every_row_of_a_person_and_nothing_else(store, records):
    visitors = fill(store, records, 3)
    before = dump(store.path)
    counts = store.delete_visitor(visitors[1].code.lower())
    after = dump(store.path)
    assert set(counts) == set(before) == {
        "visitors", "sessions", "trips", "decisions", "answers",
    }  # fmt: skip
    for name, rows in before.items():
        gone = [row for row in rows if row not in after[name]]
        assert [row for row in rows if row in after[name]] == after[name]
        assert len(gone) == counts[name] > 0
    others = {visitor.number for visitor in visitors} - {visitors[1].number}
    assert {session.visitor for session in store.sessions()} == others
    assert len(after["trips"]) == 2 * len(records)
    assert store.find_visitor(visitors[1].code) is None
    with pytest.raises(ValueError, match="has this code; check its letters"):
        store.delete_visitor(visitors[1].code)
    assert dump(store.path) == after
    assert store.new_visitor().number == 4  # a number is never given again


def test_what_was_deleted_is_in_none_of_the_files(store):
    visitor = store.new_visitor()
    session = store.new_session(visitor.number, "study")
    store.answer(session, "name", "Wilhelmina Unforgettable")
    store.delete_visitor(visitor.code)
    for path in store.path.parent.iterdir():
        assert b"Unforgettable" not in path.read_bytes(), path


def test_what_fails_within_a_transaction_leaves_nothing(store, records):
    fill(store, records[:1], 1)
    before = dump(store.path)

    def fail():
        with store.writing() as base:
            base.execute("DELETE FROM visitors")
            raise RuntimeError("here")

    with pytest.raises(RuntimeError, match="here"):
        fail()
    assert dump(store.path) == before


def others(folder):
    """Files that are no database of people, with words of the error for each."""
    text = folder / "text.db"
    text.write_text("These are notes. " * 100)
    foreign = folder / "foreign.db"
    base = sqlite3.connect(foreign)
    base.execute("CREATE TABLE notes (text TEXT)")
    base.close()
    Store(folder / "new.db").close()
    base = sqlite3.connect(folder / "new.db", isolation_level=None)
    base.execute("PRAGMA user_version = 2")
    base.close()
    Store(folder / "changed.db").close()
    base = sqlite3.connect(folder / "changed.db", isolation_level=None)
    base.execute("ALTER TABLE answers ADD COLUMN mood TEXT")
    base.close()
    os.mkfifo(folder / "pipe.db")
    return {
        "text.db": "file is not a database",
        "foreign.db": "a database of another program",
        "new.db": "tables of version 2, and this is 1",
        "changed.db": "other tables than hmi-marl makes",
        "pipe.db": "a pipe, a device or a socket",
    }


def test_other_files_give_one_precise_error_and_stay_as_they_are(tmp_path):
    for name, message in others(tmp_path).items():
        path = tmp_path / name
        before = path.read_bytes() if path.is_file() else b""
        with pytest.raises(ValueError, match=message) as error:
            Store(path)
        assert "\n" not in str(error.value)
        assert str(path) in str(error.value)
        assert not path.is_file() or path.read_bytes() == before
    assert not (tmp_path / "foreign.db-wal").exists()
    with pytest.raises(FileNotFoundError):
        Store(tmp_path / "none.db", make=False)
    with pytest.raises(OSError, match=r"no/such\S* cannot be made: make its folder first"):
        Store(tmp_path / "no" / "such.db")
    with pytest.raises(OSError, match=str(tmp_path)):
        Store(tmp_path)


@pytest.mark.parametrize("damage", [b"\xff\xfe", b"`n"], ids=["no text", "no statement"])
def test_sqlite_quotes_a_damaged_schema_on_one_line(tmp_path, damage):
    path = tmp_path / "people.db"
    Store(path).close()
    content = path.read_bytes()
    place = content.index(b"CREATE TABLE answers (") + len(b"CREATE TABLE answers (")
    assert content[place : place + 1] == b"\n"  # the statement goes on in other lines
    path.write_bytes(content[: place + 9] + damage + content[place + 9 + len(damage) :])
    with pytest.raises(ValueError, match="is damaged") as error:
        Store(path)
    assert "\n" not in str(error.value)
    assert str(error.value).isprintable()


def test_columns_of_another_type_are_damage(store, records):
    fill(store, records[:1], 1)
    for change in (
        "UPDATE decisions SET intent = 'x' WHERE step = 2",
        "DELETE FROM decisions WHERE step = 1",
        "UPDATE trips SET head = 5",
        "UPDATE trips SET head = '[' ",
    ):
        with store.writing() as base:
            base.execute(change)
        with pytest.raises(ValueError, match="is damaged"):
            list(store.trips())
    with store.writing() as base:
        base.execute("UPDATE sessions SET state = x'00ff'")
    with pytest.raises(ValueError, match="is damaged"):
        list(store.sessions())


def work(store, records, number, done):
    """Write as a visitor; ``done`` is called with every acknowledgement."""
    visitor = store.new_visitor()
    session = store.new_session(visitor.number, "play", number)
    done(("session", session, number))
    for place, record in enumerate(records):
        trip = store.begin_trip(session, cut(record, 0))
        for steps in range(1, len(record) + 1):
            store.save_trips({trip: cut(record, steps)})
            done(("steps", trip, steps))
        store.answer(session, f"q{place}", place)
        done(("answer", session, place))


def test_writers_at_the_same_time_lose_nothing(tmp_path, records):
    path, errors = tmp_path / "people.db", []
    few = [cut(record, 4) for record in records[:2]]

    def run(own):
        try:
            if own is None:
                with Store(path) as store:  # made by whoever comes first
                    work(store, few, 1, lambda _: None)
            else:
                work(own, few, 1, lambda _: None)
        except BaseException as error:
            errors.append(error)

    with Store(path) as shared:
        threads = [
            threading.Thread(target=run, args=(own,)) for own in (shared, shared, None, None)
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert errors == []
        assert len(list(shared.trips())) == 8
        assert all(len(trip.record) == 4 for trip in shared.trips())
        assert len(list(shared.answers())) == 8


def kill_while_writing(path, records, seed):
    """Kill a process that writes, at a random moment; return what it had acknowledged."""
    ours, theirs = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            os.close(ours)
            with Store(path) as store:
                for number in range(1000):
                    work(
                        store, records, number,
                        lambda each: os.write(theirs, (json.dumps(each) + "\n").encode()),
                    )  # fmt: skip
        finally:
            os._exit(1)
    os.close(theirs)
    with os.fdopen(ours, "rb") as told:
        lines = [told.readline()]  # at least one, on however busy a machine
        time.sleep(np.random.default_rng(seed).uniform(0.0, 0.3))
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        lines += told.read().splitlines()
    return [json.loads(line) for line in lines if line.strip()]


def check_kills(path, records, seeds):
    for seed in seeds:
        acknowledged = kill_while_writing(path, records[:3], seed)
        assert acknowledged
        steps = {}
        for kind, where, value in acknowledged:
            if kind == "steps":
                steps[where] = max(value, steps.get(where, 0))
        with Store(path) as store:
            for kind, where, value in acknowledged:
                if kind == "session":
                    assert store.session(where).state == value
                elif kind == "answer":
                    assert f"q{value}" in {answer.question for answer in store.answers(where)}
            for number, count in steps.items():
                kept = store.trip(number).record
                assert len(kept) in (count, count + 1)  # one may have been kept, but not told
                whole = next(r for r in records if r.seed == kept.seed)
                assert kept == cut(whole, len(kept))


def test_a_kill_loses_nothing_that_was_acknowledged(tmp_path, records):
    check_kills(tmp_path / "people.db", records, range(2))


@pytest.mark.slow
def test_twenty_kills_lose_nothing_that_was_acknowledged(tmp_path, records):
    check_kills(tmp_path / "people.db", records, range(20))
