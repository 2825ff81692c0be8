"""The service of a rating study, page by page."""

import re

import pytest
from people.study.studies import GIF, a_service, a_study
from starlette.testclient import TestClient

from hmi_marl.people.store import Store
from hmi_marl.people.study.settings import RATINGS
from hmi_marl.people.study.visits import Visits

FULL = {"safe": "1", "distracted": "2", "risky": "3", "own": "7"}


@pytest.fixture
def store(tmp_path):
    with Store(tmp_path / "people.db") as store:
        yield store


def client_of(study, store, **settings):
    app = a_service(study, store, **settings).app()
    return TestClient(app, "http://testserver", raise_server_exceptions=False)


@pytest.fixture
def study(tmp_path):
    return a_study(tmp_path / "study", completion_code="C0DE", return_address="https://panel.org/r")


@pytest.fixture
def client(study, store):
    return client_of(study, store)


def due(page):
    found = re.search(r'name="page" value="([\w.]+)"', page.text)
    return found[1] if found else None


def begin(client, **form):
    page = client.post("/consent", data={"agree": "yes"} | form)
    assert due(page) == "instructions"
    return client.post("/answer", data={"page": "instructions"})


def test_a_rater_goes_from_consent_to_the_codes(client, store, study):
    first = client.get("/")
    assert "We ask you to rate &lt;clips&gt;." in first.text
    assert store.visitors() == []
    page, seen = begin(client), []
    code = re.search(r'id="code">(\w+)<', client.get("/").text)
    assert code is None, "on the pages of clips it would be in the way"
    while (clip := due(page)) is not None:
        assert f"Clip {len(seen) + 1} of 5" in page.text
        assert page.text.count('type="radio"') == 28
        seen.append(clip)
        page = client.post("/answer", data={"page": clip} | FULL)
    assert len(set(seen)) == 5
    assert study.check.name in seen[2:]
    assert 'id="completion">C0DE<' in page.text
    assert 'href="https://panel.org/r"' in page.text
    (code,) = re.findall(r'id="code">(\w+)<', page.text)
    assert store.find_visitor(code) == 1
    answers = {answer.question: answer.value for answer in store.answers()}
    value = {name: int(FULL[name]) for name in RATINGS}
    assert answers == {f"{study.id}:instructions": True} | {
        f"{study.id}:{clip}": value for clip in seen
    }


def test_no_consent_no_data(client, store):
    page = client.post("/consent", data={"agree": "no"})
    assert page.status_code == 400
    assert 'role="alert"' in page.text
    assert client.post("/answer", data={"page": "instructions"}).url.path == "/"
    assert store.visitors() == []


def test_an_answer_sent_twice_is_kept_once_and_the_first_counts(client, store):
    clip = due(begin(client))
    first = client.post("/answer", data={"page": clip} | FULL)
    again = client.post("/answer", data={"page": clip} | FULL | {"safe": "5"})
    assert due(first) == due(again) != clip
    (value,) = [answer.value for answer in store.answers() if answer.question.endswith(clip)]
    assert value["safe"] == 1
    assert client.post("/consent", data={"agree": "yes"}).url.path == "/"
    assert store.visitors() == [1], "consent that is sent twice makes no second rater"


def test_missing_ratings_are_asked_for_and_those_given_stay(client, store):
    clip = due(begin(client))
    page = client.post("/answer", data={"page": clip, "safe": "3", "own": "8", "risky": ""})
    assert page.status_code == 400
    assert "Please answer all four questions." in page.text
    assert re.findall(r'name="(\w+)" value="(\d)" required checked', page.text) == [("safe", "3")]
    assert page.text.count("question card wrong") == 3
    assert len(list(store.answers())) == 1


@pytest.mark.parametrize(
    "form",
    [
        {},
        {"page": "other.gif"},
        {"page": "../people.db"},
        {"page": "\x00"},
        b"\xff\xfe=%ff&page=%00",
        b"&".join(b"a=%d" % k for k in range(50)),
        b"x" * 5000,
    ],
)
def test_rubbish_is_refused_in_words_and_changes_nothing(client, store, form):
    begin(client)
    before = list(store.answers())
    kept = {"data": form} if isinstance(form, dict) else {"content": form}
    answer = client.post("/answer", **kept)
    assert answer.status_code in (400, 413)
    assert "Traceback" not in answer.text
    assert list(store.answers()) == before
    assert due(client.get("/")) is not None, "the study goes on"


def test_a_page_that_is_not_due_yet_is_refused(client, study, store):
    clip = due(begin(client))
    (session,) = [each.id for each in store.sessions()]
    pages = Visits(study, store).find(session).pages
    later = [page for page in pages[1:] if page != clip][-1]
    assert client.post("/answer", data={"page": later} | FULL).status_code == 400


def test_clips_are_served_by_name_alone(client, study):
    answer = client.get(f"/clips/{study.clips[0].name}")
    assert answer.content == GIF
    assert answer.headers["content-type"] == "image/gif"
    ranged = client.get(f"/clips/{study.clips[0].name}", headers={"range": "bytes=0-5"})
    assert (ranged.status_code, ranged.content) == (206, b"GIF89a")
    for odd in ("study.json", "..%2Fstudy.json", "..%2fconsent.txt", "none.gif"):
        assert client.get(f"/clips/{odd}").status_code == 404


def test_withdrawal_deletes_everything_at_once(client, store):
    page = begin(client)
    client.post("/answer", data={"page": due(page)} | FULL)
    assert "Withdraw" in client.get("/withdraw").text
    assert len(list(store.answers())) == 2
    page = client.post("/withdraw")
    assert "are deleted" in page.text
    assert (store.visitors(), list(store.sessions()), list(store.answers())) == ([], [], [])
    assert "agree" in client.get("/").text, "one may begin again"
    assert client.get("/withdraw").url.path == "/"


def test_a_code_deletes_later_from_anywhere(client, study, store):
    page = client.post("/consent", data={"agree": "yes"})
    (code,) = re.findall(r'id="code">(\w+)<', page.text)
    other = client_of(study, store)
    wrong = other.post("/delete", data={"code": "AAAA"})
    assert wrong.status_code == 404
    assert 'role="alert"' in wrong.text
    assert store.visitors() == [1]
    right = other.post("/delete", data={"code": f"{code[:8].lower()}-{code[8:]}"})
    assert "are deleted" in right.text
    assert store.visitors() == []
    assert "agree" in client.get("/").text, "the cookie of a deleted rater leads to the beginning"


def test_a_database_that_fails_is_not_an_unknown_code(client, store, monkeypatch):
    page = client.post("/consent", data={"agree": "yes"})
    (code,) = re.findall(r'id="code">(\w+)<', page.text)

    def fail(code):
        raise ValueError("the file is damaged")

    monkeypatch.setattr(type(store), "delete_visitor", fail)
    assert client.post("/delete", data={"code": code}).status_code >= 500
    assert store.visitors() == [1]


def test_codes_cannot_be_tried_in_masses(client):
    statuses = [client.post("/delete", data={"code": str(k)}).status_code for k in range(12)]
    assert statuses[:10] == [404] * 10
    assert statuses[10:] == [429, 429]


@pytest.mark.parametrize("keep", [True, False])
def test_ids_of_a_panel_are_kept_only_where_the_study_asks(tmp_path, store, keep):
    client = client_of(a_study(tmp_path / "study", keep_ids=keep), store)
    page = client.get("/?PROLIFIC_PID=abc123&SESSION_ID=<b>&STUDY_ID=s-1&name=Ada")
    fields = dict(re.findall(r'type="hidden" name="(\w+)" value="([^"]*)"', page.text))
    fields.pop("once")
    ids = {"PROLIFIC_PID": "abc123", "SESSION_ID": "&lt;b&gt;", "STUDY_ID": "s-1"}
    assert fields == (ids if keep else {})
    begin(client, PROLIFIC_PID="abc123", SESSION_ID="<b>", STUDY_ID="s-1", name="Ada")
    (session,) = store.sessions()
    wanted = {"PROLIFIC_PID": "abc123", "STUDY_ID": "s-1"}
    assert session.state.get("ids") == (wanted if keep else None)
    assert "abc123" in session.state.get("ids", {}).values() or not keep


def test_a_made_up_cookie_or_one_of_another_study_begins_anew(client, tmp_path, store):
    begin(client)
    other = client_of(a_study(tmp_path / "other", seed=9), store)
    other.cookies = client.cookies
    assert "agree" in other.get("/").text
    client.cookies.clear()
    client.cookies.set("hmi-marl-study", "rubbish")
    assert "agree" in client.get("/").text


def test_raters_are_limited(tmp_path, store):
    study = a_study(tmp_path / "study")
    full = client_of(study, store, max_visitors=1)
    begin(full)
    full.cookies.clear()
    assert full.post("/consent", data={"agree": "yes"}).status_code == 503
    over = client_of(study, store, most_raters=1)
    assert over.post("/consent", data={"agree": "yes"}).status_code == 403
    assert len(store.visitors()) == 1


def test_it_works_under_a_path(study, store):
    client = client_of(study, store, base_path="/lab/study")
    page = begin_under(client, "/lab/study")
    assert due(page) is not None
    for address in re.findall(r'(?:href|src|action|data-next)="([^"]+)"', page.text):
        assert address.startswith(("/lab/study/", "#"))


def begin_under(client, base):
    client.post(f"{base}/consent", data={"agree": "yes"})
    return client.post(f"{base}/answer", data={"page": "instructions"})


def test_the_script_is_answered_without_a_page(client):
    clip = due(begin(client))
    headers = {"accept": "application/json"}
    answer = client.post("/answer", data={"page": clip} | FULL, headers=headers)
    assert (answer.status_code, answer.content) == (204, b"")


def test_pages_have_headings_labels_and_a_language(client):
    page = begin(client)
    assert '<html lang="en">' in page.text
    assert page.text.count("<h1>") == 1
    assert page.text.count("<legend>") == 4
    assert "not safe at all" in page.text
    assert 'aria-label="Clips rated so far"' in page.text


def test_a_consent_that_is_sent_twice_makes_one_rater(study, store):
    app = a_service(study, store).app()
    first, second = (TestClient(app, "http://testserver") for _ in range(2))
    token = re.search(r'name="once" value="([\w-]+)"', first.get("/").text)[1]
    for browser in (first, second):  # a double click: neither request has the cookie yet
        page = browser.post("/consent", data={"agree": "yes", "once": token})
        assert due(page) == "instructions"
    assert store.counts()["visitors"] == 1
    first.post("/withdraw")
    again = TestClient(app, "http://testserver").post(
        "/consent", data={"agree": "yes", "once": token}
    )
    assert "I agree" in again.text, "who withdrew consents on a new page"
    assert store.counts()["visitors"] == 0


def test_a_clip_that_was_removed_is_missing(client, study):
    name = due(begin(client))
    study.path(name).unlink()
    assert client.get(f"/clips/{name}").status_code == 404
