"""The rating study in a real browser: three raters at once, reloads, lost connections, rubbish."""

import pytest
from browsing import browser, chromium
from people.study.studies import a_service

from hmi_marl.people.store import Store
from hmi_marl.people.study.make import make_study
from hmi_marl.people.study.settings import RATINGS, StudySettings
from hmi_marl.people.web.server import ServerThread
from hmi_marl.people.web.settings import ServerSettings

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not chromium(), reason="no Chromium here: apt-get install chromium"),
]
TITLE = "() => document.querySelector('h1')?.innerText"  # none while the next page loads


@pytest.fixture(scope="module")
def shown():
    with browser() as started:
        yield started


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    pytest.importorskip("imageio_ffmpeg")
    settings = StudySettings(
        drivers=("lisa", "bart"), controls=(), policy="rule", clips=2, shown=2, duration=1.0,
        width=320, completion_code="C0DE",
    )  # fmt: skip
    return make_study(settings, tmp_path_factory.mktemp("made") / "study")


@pytest.fixture
def served(study, tmp_path):
    settings = ServerSettings(port=0, base_path="/lab")
    with Store(tmp_path / "people.db") as store:
        server = ServerThread(a_service(study, store, base_path="/lab").app(), settings)
        yield server.start(), store
        server.stop()


def ratings(store, **whose):
    """What was answered about clips, in the order of the points."""
    given = [each.value for each in store.answers(**whose) if each.value is not True]
    return sorted(given, key=lambda value: value["safe"])


class Person:
    """A rater with a browser of their own."""

    def __init__(self, shown, address, **options):
        self.context = shown.new_context(viewport={"width": 390, "height": 844}, **options)
        self.page, self.heard = self.context.new_page(), []
        self.page.set_default_timeout(30_000)
        self.page.on("console", lambda each: self.heard.append(each.text))
        self.page.on("pageerror", lambda error: self.heard.append(str(error)))
        self.page.goto(address)

    @property
    def title(self):
        return self.page.locator("h1").inner_text()

    def begin(self):
        self.page.check("[name=agree]")
        self.press("Begin")
        self.press("Show the first clip")

    def choose(self, point):
        for name in RATINGS:
            self.page.check(f"[name={name}][value='{point}']")

    def send(self):
        self.press("Send and go on")

    def press(self, label):
        """Press a button, and wait for the next page."""
        before = self.title
        self.page.click(f"button:text-is('{label}')")
        self.page.wait_for_function(f"title => (({TITLE})() ?? title) !== title", arg=before)


def test_three_raters_at_once_from_consent_to_the_code(shown, served):
    address, store = served
    people = [
        Person(shown, address, color_scheme=scheme, reduced_motion=motion)
        for scheme, motion in (
            ("light", "no-preference"),
            ("dark", "reduce"),
            ("dark", "no-preference"),
        )
    ]
    for person in people:
        person.begin()
    for clip in range(5):
        for number, person in enumerate(people):
            assert person.title == f"Clip {clip + 1} of 5"
            person.choose(number + 1)
            person.send()
    for number, person in enumerate(people, start=1):
        assert person.title == "Thank you"
        assert person.page.inner_text("#completion") == "C0DE"
        assert store.find_visitor(person.page.inner_text("#code")) == number
        assert ratings(store, visitor=number) == [dict.fromkeys(RATINGS, number)] * 5
        assert person.heard == []
        person.context.close()


def test_a_clip_plays_unless_less_motion_is_wanted(shown, served):
    for motion, plays in (("no-preference", True), ("reduce", False)):
        person = Person(shown, served[0], reduced_motion=motion)
        person.begin()
        person.page.wait_for_function("() => document.querySelector('video')?.readyState >= 2")
        if plays:
            person.page.wait_for_function("() => document.querySelector('video')?.ended")
            assert person.page.inner_text("#play") == "Watch again"
        else:
            assert person.page.evaluate("() => document.querySelector('video').currentTime") == 0
            assert person.page.inner_text("#play") == "Play the clip"
        person.page.click("#play")
        person.page.wait_for_selector("#play:text-is('Pause')")
        person.page.wait_for_function("() => document.querySelector('video')?.ended")
        person.context.close()


def test_reload_back_and_a_second_window_go_on_where_it_was(shown, served):
    address, store = served
    person = Person(shown, address)
    person.begin()
    person.choose(3)
    person.send()
    for go in (person.page.reload, person.page.go_back, lambda: person.page.goto(address)):
        go()
        person.page.goto(address)
        assert person.title == "Clip 2 of 5"
    other = person.context.new_page()
    other.goto(address)
    assert other.locator("h1").inner_text() == "Clip 2 of 5"
    person.choose(4)
    person.send()
    for name in RATINGS:  # the other window is behind: its answer changes nothing
        other.check(f"[name={name}][value='7']")
    other.click("text=Send and go on")
    other.wait_for_function(f"() => ({TITLE})() === 'Clip 3 of 5'")
    assert ratings(store) == [dict.fromkeys(RATINGS, 3), dict.fromkeys(RATINGS, 4)]
    person.context.close()


def test_an_answer_given_without_a_connection_is_sent_when_there_is_one(shown, served):
    address, store = served
    person = Person(shown, address)
    person.begin()
    person.context.set_offline(True)
    person.choose(5)
    person.page.click("text=Send and go on")
    person.page.wait_for_selector("text=The connection was lost")
    assert person.title == "Clip 1 of 5"
    assert len(list(store.answers())) == 1
    person.context.set_offline(False)
    person.page.wait_for_function(f"() => ({TITLE})() === 'Clip 2 of 5'")
    assert ratings(store) == [dict.fromkeys(RATINGS, 5)]
    person.context.close()


def test_without_scripts_the_pages_work_as_forms(shown, served):
    address, store = served
    person = Person(shown, address, java_script_enabled=False)
    person.page.check("[name=agree]")
    for label in ("Begin", "Show the first clip"):
        person.page.click(f"button:text-is('{label}')")
    for clip in range(5):
        assert person.title == f"Clip {clip + 1} of 5"
        person.choose(2)
        person.page.click("text=Send and go on")
    assert person.title == "Thank you"
    person.page.click("text=Withdraw")
    person.page.click("button.danger")
    assert person.title == "Your answers are deleted"
    assert store.visitors() == []
    person.context.close()


def test_the_keyboard_alone_rates_a_clip(shown, served):
    address, store = served
    person = Person(shown, address)
    person.begin()
    page = person.page
    page.focus("[name=safe][value='1']")
    for place, name in enumerate(RATINGS):
        page.keyboard.press("Space")
        for _ in range(place):
            page.keyboard.press("ArrowRight")
        assert page.evaluate("() => document.activeElement.name") == name
        page.keyboard.press("Tab")
    assert page.evaluate("() => document.activeElement.innerText") == "Send and go on"
    page.keyboard.press("Enter")
    page.wait_for_function(f"() => ({TITLE})() === 'Clip 2 of 5'")
    wanted = {name: 1 + place for place, name in enumerate(RATINGS)}
    assert ratings(store) == [wanted]
    person.context.close()


def test_rubbish_from_a_rater_harms_nobody(shown, served):
    address, store = served
    person, rude = Person(shown, address), Person(shown, address)
    person.begin()
    rude.begin()
    statuses = rude.page.evaluate(
        """async (base) => {
            const bodies = ["", "page=x", "page=%00&safe=9", "x".repeat(9000), "page=instructions"];
            const found = [];
            for (const body of bodies) {
              const headers = {"Content-Type": "application/x-www-form-urlencoded"};
              const answer = await fetch(base + "answer", {method: "POST", body, headers});
              found.push(answer.status);
            }
            found.push((await fetch(base + "clips/..%2Fstudy.json")).status);
            found.push((await fetch(base + "consent", {method: "PUT"})).status);
            return found;
        }""",
        address,
    )
    assert statuses == [400, 400, 400, 413, 200, 404, 405]
    person.choose(1)
    person.send()
    rude.page.reload()
    assert (person.title, rude.title) == ("Clip 2 of 5", "Clip 1 of 5")
    assert len(list(store.answers())) == 3
    person.context.close()
    rude.context.close()
