import re

import numpy as np
import pytest
from people.guests import KEY, Wheel, another, begin, client, drive, service, trip_number
from starlette.testclient import TestClient
from starlette.websockets import WebSocketDisconnect

from hmi_marl.envs.config import TeamSettings
from hmi_marl.envs.driver_files import write_driver
from hmi_marl.envs.drivers import DRIVERS, Driver, Traits
from hmi_marl.people.measure.scripted import KEEP_SPEED, ScriptedPeople, drive_calibration
from hmi_marl.people.play.live import FULL, LiveTrip
from hmi_marl.people.play.puzzles import puzzle
from hmi_marl.people.record import TripRecord, replay
from hmi_marl.people.store import Store
from hmi_marl.people.web.cookies import Cookies
from hmi_marl.people.web.settings import Limits, ServerSettings


@pytest.fixture
def store(tmp_path):
    with Store(tmp_path / "people.db") as opened:
        yield opened


@pytest.fixture
def in_real_time():
    """For tests of the clock."""


@pytest.fixture(autouse=True)
def hurried(request, monkeypatch):
    """Other tests do not wait for the time of a decision."""
    if "in_real_time" not in request.fixturenames:
        always = property(lambda trip: 0.0, lambda trip, due: None)
        monkeypatch.setattr(LiveTrip, "_due", always, raising=False)


def refused(browser, query, code, reason):
    with browser.websocket_connect(f"/trip/socket{query}") as socket:
        assert reason in socket.receive_json()["reason"]
        with pytest.raises(WebSocketDisconnect) as closed:
            socket.receive_json()
    assert closed.value.code == code


def closing_code(wheel, text, times):
    """Send a message again and again, until the connection is closed."""
    try:
        for _ in range(times):
            wheel.socket.send_text(text)
            wheel.next()
    except WebSocketDisconnect as closed:
        return closed.code
    return None


def test_a_free_trip_is_driven_shown_again_downloaded_and_replayed(store):
    with client(service(store).app()) as browser:
        page = begin(browser)
        number = drive(browser, page)
        over = browser.get("/next")
        assert "It went to its end without a crash." in over.text
        assert browser.get("/trip").url.path == "/next"
        record = TripRecord.from_json(browser.get(f"/trips/{number}/record").json())
        assert record == store.trip(number).record
        assert record.finished
        assert record.looking_away == (0, 0, 1, 0, 0)
        assert record.partner == "average"
        replay(record)
        film = browser.get(f"/trips/{number}/film").json()
        assert len(film["moments"]) == 1 + 3 * 5
        assert [step["away"] for step in film["steps_taken"]] == [0, 0, 1, 0, 0]
        assert f"seed {record.seed}" in browser.get(f"/trips/{number}").text
        again = browser.post("/trips")
        assert trip_number(again) == number + 1


def test_a_person_alerts_as_the_hmi(store):
    with client(service(store).app()) as browser:
        page = begin(browser, seat="vehicle_ai", partner="rule", driver="homer")
        number = trip_number(page)
        with browser.websocket_connect(f"/trip/socket?trip={number}") as socket:
            wheel = Wheel(socket)
            assert wheel.hello["choices"] == 2
            assert wheel.hello["puzzle"] is None
            assert wheel.state["intended"] in range(5)
            assert wheel.decide(action=1, away=None)["alert"] == 1
            assert "away is null" in wheel.decide(action=1, away=0)["reason"]
            assert "action lies in 0 to 1" in wheel.decide(action=2, away=None)["reason"]
            while not wheel.state["over"]:
                wheel.decide(action=0, away=None)
        record = store.trip(number).record
        assert record.alerts == (1, 0, 0, 0, 0)
        assert record.looking_away is None
        assert record.config.only_driver.name == "homer"
        replay(record)
        replay(record, "highway")


def test_the_whole_way_from_the_calibration_to_the_result(store):
    with client(service(store).app()) as browser:
        page = begin(browser, way="measured")
        assert "Begin trip 1 of 2" in page.text
        numbers = [drive(browser, browser.post("/trips")) for _ in range(2)]
        page = browser.get("/next")
        assert "Your traits are measured" in page.text
        assert page.text.count('class="interval"') == 3
        for hidden in ("Made for you", "For the average driver"):
            assert hidden not in page.text
        for _ in range(3):
            assert "Begin trip" in browser.get("/next").text
            page = browser.post("/trips")
            assert "optimal" not in page.text
            numbers.append(drive(browser, page))
            if len(numbers) < 5:  # what would name the HMI waits for the end
                number = numbers[-1]
                for path in (
                    f"/trips/{number}",
                    f"/trips/{number}/record",
                    f"/trips/{number}/film",
                ):
                    assert browser.get(path).status_code == 403
                for path in ("/next", "/data"):
                    shown = browser.get(path).text
                    assert f'/trips/{number}"' not in shown
                    assert "<dt>Alerts</dt>" not in shown
        page = browser.get("/next")
        assert "Your result" in page.text
        for shown in ("Made for you", "For the average driver", "None", "Lisa", "Homer"):
            assert shown in page.text
        kinds = [store.trip(number).record.kind for number in numbers]
        assert kinds == ["calibration"] * 2 + ["trial"] * 3
        partners = [store.trip(number).record.partner for number in numbers[2:]]
        assert {name.partition(":")[0] for name in partners} == {"optimal", "average", "never"}
        record = browser.get(f"/trips/{numbers[-1]}/record").json()
        assert record["partner"] == partners[-1]
        assert browser.get("/next").text == page.text
        assert browser.post("/trips").status_code == 400


def test_a_scripted_person_drives_the_same_trip_through_the_server_and_in_simulations(store):
    """So that coverage, which is simulated over 200 calibrations, is that of the server's own."""
    traits = Traits.of([DRIVERS["homer"]])
    with client(service(store).app()) as browser:
        begin(browser, way="measured")
        number = trip_number(browser.post("/trips"))
        begun = store.trip(number).record
        person = ScriptedPeople(
            traits, begun.config.alert_window, np.array([begun.seed], np.uint64)
        )
        with browser.websocket_connect(f"/trip/socket?trip={number}") as socket:
            wheel = Wheel(socket)
            while not wheel.state["over"]:
                away = person.look(np.array([wheel.state["alert"]]))
                wheel.decide(KEEP_SPEED, int(away[0]))
    driven, simulated = (
        store.trip(number).record,
        drive_calibration(traits, begun.config, begun.seed),
    )
    assert driven.looking_away == simulated.looking_away
    assert 0 < sum(driven.looking_away) < len(driven)
    assert (driven.alerts, driven.digest) == (simulated.alerts, simulated.digest)


def test_a_trip_of_another_version_is_not_shown_and_its_visit_goes_on(store):
    with client(service(store).app()) as browser:
        begin(browser, way="measured")
        first = drive(browser, browser.post("/trips"))
        with store.writing() as base:
            base.execute("UPDATE trips SET digest = ?", ("0" * 64,))
        shown = browser.get("/next")
        assert shown.status_code == 200
        assert "Begin trip 2 of 2" in shown.text
        assert browser.get(f"/trips/{first}").status_code == 409
        assert "another version" in browser.get(f"/trips/{first}").text
        assert browser.get(f"/trips/{first}/record").json()["digest"] == "0" * 64
        assert drive(browser, browser.post("/trips")) == 2
        assert "Your traits are measured" in browser.get("/next").text


def test_drivers_of_files_and_of_numbers_have_their_names(store, tmp_path):
    file = str(tmp_path / "17.json")
    write_driver(file, Driver("visitor-17", 0.1, 0.2, 0.3, 4.0))
    drivers = (file, "mine:0.1,0.2,0.3,4", "lisa")
    with client(service(store, drivers=drivers).app()) as browser:
        page = browser.get("/").text
        assert re.findall(r"<option[^>]*>(Visitor-17|Mine|Lisa)<", page) == [
            "Visitor-17", "Mine", "Lisa",
        ]  # fmt: skip
        begin(browser, seat="vehicle_ai", partner="rule", driver=file)
        assert store.trip(1).record.config.only_driver.name == "visitor-17"


def test_a_server_started_anew_with_other_settings_goes_on_alike(store):
    """Graded alerts or another window would mean traits and HMIs of two kinds of teams."""
    with client(service(store).app()) as browser:
        begin(browser, way="measured")
        numbers = [drive(browser, browser.post("/trips"))]
        cookies = dict(browser.cookies)
    other = TeamSettings(duration=2.0, alert_strengths=(0.5, 1.0), alert_window=5)
    with client(service(store, team=other).app()) as browser:
        browser.cookies.update(cookies)
        numbers += [drive(browser, browser.post("/trips"))]
        assert "Your traits are measured" in browser.get("/next").text
        numbers += [drive(browser, browser.post("/trips")) for _ in range(3)]
        assert "Your result" in browser.get("/next").text
    configs = [store.trip(number).record.config for number in numbers]
    assert configs == configs[:1] * 5


@pytest.mark.usefixtures("in_real_time")
def test_decisions_sent_again_or_early_are_taken_once(store):
    with client(service(store).app()) as browser:
        number = trip_number(begin(browser))
        address = f"/trip/socket?trip={number}"
        with browser.websocket_connect(address) as socket:
            wheel = Wheel(socket)
            wheel.decide(action=3, away=1)
            assert wheel.decide(action=4, away=0, step=0)["step"] == 1
            late = wheel.decide(step=5)
            assert late["reason"] == "the next decision is for step 1, not 5"
            message = {"type": "decide", "step": 1, "away": 0}
            socket.send_json(message | {"action": 0})
            socket.send_json(message | {"action": 2})  # the newest for a step counts
            assert wheel.next()["step"] == 2
        with browser.websocket_connect(address) as socket:
            wheel = Wheel(socket)
            assert wheel.state["step"] == 2
            wheel.decide(action=4, step=1)
            wheel.drive()
        record = store.trip(number).record
        assert record.intents[:2] == (3, 2)
        assert record.looking_away[:2] == (1, 0)
        assert len(record) == 5
        replay(record)


@pytest.mark.usefixtures("in_real_time")
def test_decisions_are_five_a_second_whatever_a_page_sends(store):
    import time

    with client(service(store, duration=2.0).app()) as browser:
        number = trip_number(begin(browser))
        with browser.websocket_connect(f"/trip/socket?trip={number}") as socket:
            wheel, begun = Wheel(socket), time.monotonic()
            wheel.drive()
            assert time.monotonic() - begun > 9 * 0.2 - 0.06


def test_number_searches_give_points_while_they_cover_the_road(store):
    with client(service(store, duration=4.0).app()) as browser:
        number = trip_number(begin(browser))
        seed = store.trip(number).record.seed
        with browser.websocket_connect(f"/trip/socket?trip={number}") as socket:
            wheel = Wheel(socket)
            assert wheel.hello["puzzle"]["target"] == puzzle(seed, 0).target

            def find(index, value):
                socket.send_json({"type": "found", "puzzle": index, "number": value})
                return wheel.next()

            assert find(0, puzzle(seed, 0).target)["reason"] == "the second task is closed"
            wheel.decide(away=1)
            right = find(0, puzzle(seed, 0).target)
            assert (right["right"], right["points"], right["puzzle"]) == (True, 25, 1)
            assert find(0, 50)["reason"] == "the number search is 1, not 0"
            other = next(n for n in puzzle(seed, 1).numbers if n != puzzle(seed, 1).target)
            assert find(1, other)["points"] == 25
            absent = next(n for n in range(10, 100) if n not in puzzle(seed, 2).numbers)
            assert "not among the numbers" in find(2, absent)["reason"]
        service_again = service(store, duration=4.0)
    with client(service_again.app()) as later:
        later.cookies = browser.cookies
        with later.websocket_connect(f"/trip/socket?trip={number}") as socket:
            wheel = Wheel(socket)
            assert wheel.hello["points"] == 25
            assert wheel.hello["puzzle"]["puzzle"] == 2
            assert wheel.state["step"] == 1


def test_rubbish_is_answered_and_harms_no_one(store):
    with client(service(store, limits=Limits(messages=1e4)).app()) as browser:
        number = trip_number(begin(browser))
        with browser.websocket_connect(f"/trip/socket?trip={number}") as socket:
            wheel = Wheel(socket)
            for text, reason in (
                ("{", ""),
                ("x" * 5000, "at most 4096 characters, not 5000"),
                ("null", "JSON object"),
                ('{"type": "shutdown"}', "type is decide or found"),
                ('{"type": "decide", "step": 0, "action": 5, "away": 0}', "0 to 4, but got 5"),
                ('{"type": "decide", "step": 0, "action": 1, "away": null}', "away is 0 or 1"),
            ):
                socket.send_text(text)
                answer = wheel.next()
                assert answer["type"] == "error"
                assert reason in answer["reason"]
            socket.send_bytes(b"\x00\xff")
            assert wheel.next()["reason"] == "messages are texts"
            assert wheel.decide()["step"] == 1
            assert closing_code(wheel, "{", 400) == 1008
        with browser.websocket_connect(f"/trip/socket?trip={number}") as socket:
            Wheel(socket).drive()
        assert store.trip(number).record.finished


@pytest.mark.usefixtures("in_real_time")
def test_too_many_messages_are_dropped(store):
    with client(service(store, limits=Limits(messages=1.0)).app()) as browser:
        number = trip_number(begin(browser))
        with browser.websocket_connect(f"/trip/socket?trip={number}") as socket:
            wheel = Wheel(socket)
            for _ in range(4):
                socket.send_text("{}")
            reasons = [wheel.next()["reason"] for _ in range(4)]
            assert reasons[-1] == "at most 1 messages a second"
            assert reasons[0] != reasons[-1]


def test_trips_and_sessions_of_others_are_out_of_reach(store):
    app = service(store).app()
    with client(app) as one:
        number = drive(one, begin(one))
        other = another(one)
        for path in ("", "/film", "/record"):
            assert other.get(f"/trips/{number}{path}").status_code == 403
        mine = trip_number(begin(other))
        for path in ("", "/film", "/record"):
            answer = other.get(f"/trips/{number}{path}")
            assert answer.status_code == 404
            assert "no such trip of yours" in answer.text
        refused(other, f"?trip={number}", 4004, "is not under way")
        refused(other, "", 4004, "trip '' is not under way")
        refused(other, f"?trip={mine}.0", 4004, "is not under way")
        stranger = another(one)
        refused(stranger, f"?trip={mine}", 4003, "there is no visit")
        session = next(iter(store.sessions())).id
        forged = Cookies("hmi-marl-play", b"guess" * 9, ServerSettings())
        value = forged._serializer.dumps({"session": session, "code": ""})
        stranger.cookies.set("hmi-marl-play", value)
        refused(stranger, f"?trip={mine}", 4003, "there is no visit")
        assert stranger.get("/trip").url.path == "/"
        assert one.get(f"/trips/{'9' * 5000}").status_code == 414  # more than Python reads


def test_a_second_window_takes_the_trip_over(store):
    with client(service(store).app()) as browser:
        number = trip_number(begin(browser))
        address = f"/trip/socket?trip={number}"
        with browser.websocket_connect(address) as first:
            Wheel(first).decide()
            with browser.websocket_connect(address) as second:
                wheel = Wheel(second)
                assert wheel.state["step"] == 1
                with pytest.raises(WebSocketDisconnect) as closed:
                    first.receive_json()
                assert closed.value.code == 4001
                wheel.drive()


def test_a_full_server_says_so_and_lets_those_inside_go_on(store):
    app = service(store, limits=Limits(max_visitors=1)).app()
    with client(app) as one:
        number = trip_number(begin(one))
        other = another(one)
        page = begin(other)
        with one.websocket_connect(f"/trip/socket?trip={number}") as socket:
            wheel = Wheel(socket)
            refused(other, f"?trip={trip_number(page)}", 1013, "too many visitors")
            late = begin(another(one))
            assert late.status_code == 503
            assert "as many visitors as this server takes" in late.text
            wheel.drive()


def test_deletion_in_mid_trip_ends_it_and_harms_no_one(store, caplog):
    app = service(store).app()
    with client(app) as one:
        number = trip_number(begin(one))
        other = another(one)
        begin(other)
        with one.websocket_connect(f"/trip/socket?trip={number}") as socket:
            wheel = Wheel(socket)
            wheel.decide()
            code = Cookies("hmi-marl-play", KEY, ServerSettings())._serializer.loads(
                one.cookies["hmi-marl-play"]
            )["code"]
            assert code.encode() not in (store.path).read_bytes()
            assert " ".join(code[k : k + 4] for k in range(0, 16, 4)) in one.get("/data").text
            wrong = other.post("/delete", data={"code": "A" * 16})
            assert wrong.status_code == 404
            page = other.post("/delete", data={"code": code.lower()})
            assert "Your data is deleted: 1 trips with 1 decisions." in page.text
            socket.send_json({"type": "decide", "step": 1, "action": 1, "away": 0})
            with pytest.raises(WebSocketDisconnect) as closed:
                wheel.next()
            assert closed.value.code == 1011
            assert f"trip {number}: nothing more can be stored: " in caplog.text
            assert f"no trip {number}" in caplog.text
        assert one.get("/trip").url.path == "/"
        assert "no visit" in one.get(f"/trips/{number}").text
        drive(other)
        assert store.visitors() == [2]


def test_a_trip_can_be_stopped_and_a_way_gone_on(store):
    with client(service(store).app()) as browser:
        number = trip_number(begin(browser))
        assert "End this trip" in browser.get("/").text
        assert trip_number(begin(browser, way="measured")) == number  # it is under way still
        assert browser.post("/stop").url.path == "/"
        assert "End this trip" not in browser.get("/").text
        assert begin(browser, way="measured").url.path == "/next"
        drive(browser, browser.post("/trips"))
        assert "Go on with it" in browser.get("/").text
        assert begin(browser, partner="nonsense").status_code == 400
        assert not store.trip(number).record.finished


def test_forms_that_are_rubbish_are_refused(store):
    with client(service(store).app()) as browser:
        for form in ({}, {"way": "x"}, {"seat": "driver", "partner": "../x"}):
            assert browser.post("/begin", data=form).status_code == 400
        assert browser.post("/begin", content=b"\xff\xfe&&==%zz").status_code == 400
        assert browser.post("/begin", content="&".join(["a=1"] * 50)).status_code == 400
        assert browser.post("/trips").status_code == 403
        assert browser.get("/next").url.path == "/"
        assert browser.get("/begin").status_code == 405
        assert store.visitors() == []


def test_all_pages_lie_under_the_base_path(store):
    server = ServerSettings(base_path="/hmi")
    with client(service(store, server).app()) as browser:
        page = browser.post("/hmi/begin", data={"way": "measured"})
        assert page.url.path == "/hmi/next"
        page = browser.post("/hmi/trips")
        assert page.url.path == "/hmi/trip"
        with browser.websocket_connect(f"/hmi/trip/socket?trip={trip_number(page)}") as socket:
            Wheel(socket).drive()
        for path in ("/hmi/next", "/hmi/data", "/hmi/"):
            text = browser.get(path).text
            assert 'href="/' in text
            for link in text.split('="/')[1:]:
                assert link.startswith(("hmi/", 'hmi"'))


def test_a_form_that_is_sent_twice_makes_one_visitor_and_one_trip(store):
    with client(service(store).app()) as browser:
        token = re.search(r'name="once" value="([\w-]+)"', browser.get("/").text)[1]
        numbers = {
            trip_number(begin(another(browser), once=token))  # neither request has the cookie yet
            for _ in range(2)
        }
        assert numbers == {1}
        counts = store.counts()
        assert (counts["visitors"], counts["trips"]) == (1, 1)


def test_new_visitors_of_one_address_are_limited(store, monkeypatch):
    monkeypatch.setattr("hmi_marl.people.play.app.NEW_VISITORS", (0.001, 2.0))
    with client(service(store).app()) as browser:
        statuses = [begin(another(browser), way="measured").status_code for _ in range(3)]
        assert statuses == [200, 200, 429]
        assert store.counts()["visitors"] == 2


def test_a_damaged_database_is_no_matter_of_visitors(store):
    app = service(store).app()
    with TestClient(app, "http://testserver", raise_server_exceptions=False) as browser:
        begin(browser)
        with store.writing() as base:
            base.execute("UPDATE sessions SET state = 'rubbish'")
        page = browser.get("/trip")
        assert page.status_code == 500
        assert "people.db" not in page.text


def test_a_database_that_does_not_answer_is_tried_again(store, monkeypatch):
    with client(service(store).app()) as browser:
        number = trip_number(begin(browser))
        read = store.answers
        monkeypatch.setattr(store, "answers", failing)
        with browser.websocket_connect(f"/trip/socket?trip={number}") as socket:
            assert "try again" in socket.receive_json()["reason"]
            with pytest.raises(WebSocketDisconnect) as closed:
                socket.receive_json()
            assert closed.value.code == FULL, "a code after which the page connects again"
        monkeypatch.setattr(store, "answers", read)
        with browser.websocket_connect(f"/trip/socket?trip={number}") as socket:
            assert Wheel(socket).decide()["step"] == 1


def failing(*_, **__):
    raise OSError("people.db: database is locked")
