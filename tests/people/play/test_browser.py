"""Whole visits in a real browser: keyboard, mouse and touch, reloads and lost connections."""

import re
from contextlib import ExitStack, contextmanager

import pytest
from browsing import ANOTHER_MACHINE, WIDTHS, Reader, browser, chromium
from people.guests import service

from hmi_marl.people.record import replay
from hmi_marl.people.store import Store
from hmi_marl.people.web.server import ServerThread
from hmi_marl.people.web.settings import ServerSettings

pytestmark = [
    pytest.mark.slow,
    pytest.mark.usefixtures("unmeasured"),
    pytest.mark.skipif(not chromium(), reason="no Chromium here: apt-get install chromium"),
]


@pytest.fixture(scope="module")
def chrome():
    with browser() as started:
        yield started


class Place:
    """A server and its database."""

    def __init__(self, store, **more):
        self.store, self.more = store, more
        self.port = 0
        self.start()

    def start(self):
        settings = ServerSettings(port=self.port, base_path="/hmi")
        self.thread = ServerThread(service(self.store, settings, **self.more).app(), settings)
        self.address = self.thread.start()
        self.port = int(re.search(r":(\d+)/", self.address)[1])

    def stop(self):
        self.thread.stop()


@contextmanager
def place_in(folder, **more):
    with Store(folder / "people.db") as store:
        place = Place(store, **({"duration": 3.0} | more))
        try:
            yield place
        finally:
            place.stop()


@contextmanager
def visitor(chrome, address, **context):
    """A page of a visitor, which says nothing wrong and asks for nothing elsewhere."""
    page = chrome.new_context(**({"viewport": {"width": 1280, "height": 850}} | context)).new_page()
    page.set_default_timeout(60_000)
    page.said = []
    page.on("pageerror", lambda error: page.said.append(str(error)))
    page.on(
        "console",
        lambda said: said.type in ("error", "warning") and page.said.append(said.text),
    )
    page.on(
        "request",
        lambda asked: asked.url.startswith(address) or page.said.append(asked.url),
    )
    page.goto(address)
    try:
        yield page
        assert page.said == []
    finally:
        page.context.close()


def start(page):
    page.wait_for_selector("#start:visible")
    page.click("#start")


def ended(page):
    page.wait_for_selector("#on:visible")


def wait_for_steps(page, store, count, trip=1):
    """Wait until so many decisions are stored."""
    for _ in range(600):
        if len(store.trip(trip).record) >= count:
            return
        page.wait_for_timeout(20)
    raise AssertionError(f"no {count} decisions")


def test_a_whole_trip_by_keyboard_alone(chrome, tmp_path):
    with place_in(tmp_path) as place, visitor(chrome, place.address) as page:
        page.focus("#driver-partner")
        page.keyboard.press("Tab")
        page.keyboard.press("Enter")
        page.wait_for_selector("#start:focus")
        page.keyboard.press("Enter")
        page.keyboard.down("ArrowUp")
        wait_for_steps(page, place.store, 3)
        page.keyboard.up("ArrowUp")
        page.keyboard.press("a")
        wait_for_steps(page, place.store, len(place.store.trip(1).record) + 2)
        page.keyboard.press("n")
        page.wait_for_selector("#task button:focus")
        numbers = page.locator("#task .grid button").all_inner_texts()
        target = page.inner_text("#task h2").split()[-1]
        row, column = divmod(numbers.index(target), 4)
        for _ in range(row):
            page.keyboard.press("ArrowDown")
        for _ in range(column):
            page.keyboard.press("ArrowRight")
        wait_for_steps(page, place.store, len(place.store.trip(1).record) + 2)
        page.keyboard.press("Enter")
        page.wait_for_function("() => document.getElementById('fact-points').textContent === '25'")
        page.keyboard.press("Escape")
        ended(page)
        page.keyboard.press("Enter")
        page.wait_for_selector("text=The trip that ended")
        record = place.store.trip(1).record
        assert record.finished
        assert 3 in record.intents[:3]
        assert 0 in record.intents
        assert 1 in record.looking_away
        replay(record)


def test_the_alert_is_seen_heard_and_read_out(chrome, tmp_path):
    hmis = {"hmis": ("always",)}
    with place_in(tmp_path, **hmis) as place, visitor(chrome, place.address) as page:
        page.evaluate("() => 0")
        page.add_init_script(
            "window.tones = 0; const make = AudioContext.prototype.createOscillator;"
            "AudioContext.prototype.createOscillator = function () {"
            "  window.tones += 1; return make.call(this); };"
        )
        page.click("form:has(#driver-partner) button")
        start(page)
        page.wait_for_selector("#banner:visible")
        assert page.inner_text("#banner") == "Eyes on the road!"
        assert page.inner_text("#alert-text[role=alert]") == "Eyes on the road!"
        page.wait_for_function("() => window.tones >= 2")
        page.click("#sound")
        assert page.get_attribute("#sound", "aria-pressed") == "false"
        ended(page)


def test_a_whole_trip_as_the_hmi_by_mouse(chrome, tmp_path):
    with place_in(tmp_path) as place, visitor(chrome, place.address) as page:
        page.select_option("#vehicle_ai-driver", "bart")
        page.select_option("#vehicle_ai-partner", "rule")
        page.click("form:has(#vehicle_ai-driver) button")
        start(page)
        page.click(".alert-button")
        page.wait_for_selector("#banner:visible")
        page.keyboard.press(" ")
        ended(page)
        record = place.store.trip(1).record
        assert record.finished
        assert 1 <= sum(record.alerts) <= 4
        replay(record)


def test_a_whole_trip_by_touch_on_a_phone(chrome, tmp_path):
    phone = {"viewport": {"width": 390, "height": 844}, "has_touch": True, "is_mobile": True}
    with place_in(tmp_path) as place, visitor(chrome, place.address, **phone) as page:
        page.tap("form:has(#driver-partner) button")
        page.wait_for_selector("#start:visible")
        page.tap("#start")
        page.tap(".pad-slow_down")  # counts in the next decision, if the road is still seen
        wait_for_steps(page, place.store, len(place.store.trip(1).record) + 2)
        page.tap("#task-button")
        target = page.inner_text("#task h2").split()[-1]
        wait_for_steps(page, place.store, len(place.store.trip(1).record) + 2)
        page.tap(f"#task .grid button:text-is('{target}')")
        page.wait_for_function("() => document.getElementById('fact-points').textContent === '25'")
        page.tap("#task-button")
        ended(page)
        record = place.store.trip(1).record
        assert 4 in record.intents
        assert 1 in record.looking_away
        assert record.finished


def test_three_visitors_at_once_from_the_calibration_to_the_result(chrome, tmp_path):
    with place_in(tmp_path, duration=2.0, calibration_trips=2) as place, ExitStack() as stack:
        pages = [stack.enter_context(visitor(chrome, place.address)) for _ in range(3)]
        for page in pages:
            page.click("text=Begin the calibration")
        for _ in range(5):
            for page in pages:
                page.click("button:has-text('Begin trip')")
            for page in pages:
                start(page)
                page.keyboard.press("n")
            for page in pages:
                ended(page)
                page.click("#on")
        for page in pages:
            page.wait_for_selector("h1:has-text('Your result')")
            assert page.locator("svg.interval").count() == 3
        page = pages[0]
        page.click("text=Watch it again")
        page.click("#play")
        page.wait_for_function("() => Number(document.getElementById('place').value) > 0.5")
        with page.expect_download() as download:
            page.click("text=Download it")
        assert download.value.suggested_filename.startswith("trip-")
        trips = list(place.store.trips())
        assert len(trips) == 15
        for trip in trips:
            assert trip.record.finished
            replay(trip.record)
        page.click("text=Back")
        page.get_by_role("link", name="Your data").click()
        page.click("text=Delete my data")
        assert "5 trips with 50 decisions" in page.inner_text("main")
        assert len(list(place.store.trips())) == 10


def test_a_reload_in_mid_trip_goes_on_where_it_was(chrome, tmp_path):
    with place_in(tmp_path) as place, visitor(chrome, place.address) as page:
        page.click("form:has(#driver-partner) button")
        start(page)
        wait_for_steps(page, place.store, 4)
        page.reload()
        page.wait_for_selector("#start:visible")
        before = len(place.store.trip(1).record)
        assert before >= 4
        assert page.inner_text("#start") == "Go on"
        page.wait_for_timeout(500)
        assert len(place.store.trip(1).record) == before  # it waits for its driver
        page.click("#start")
        ended(page)
        record = place.store.trip(1).record
        assert len(record) == 15
        replay(record)


def test_a_server_that_comes_back_goes_on_without_a_lost_or_double_decision(chrome, tmp_path):
    with place_in(tmp_path) as place, visitor(chrome, place.address) as page:
        page.click("form:has(#driver-partner) button")
        start(page)
        wait_for_steps(page, place.store, 4)
        place.stop()
        page.wait_for_selector("text=The connection is lost")
        place.start()
        ended(page)
        page.said = [said for said in page.said if "WebSocket" not in said]
        record = place.store.trip(1).record
        assert len(record) == 15
        replay(record)


def test_a_browser_without_a_network_goes_on_when_it_is_back(chrome, tmp_path):
    with place_in(tmp_path, duration=4.0) as place, visitor(chrome, place.address) as page:
        page.add_init_script(
            "const sockets = []; const Old = WebSocket; window.WebSocket = class extends Old {"
            "  constructor(...all) { super(...all); sockets.push(this); } };"
            "window.cut = () => sockets.forEach((each) => each.close());"
        )
        page.click("form:has(#driver-partner) button")
        start(page)
        for count in (3, 6, 9):
            wait_for_steps(page, place.store, count)
            page.evaluate("() => window.cut()")
        ended(page)
        record = place.store.trip(1).record
        assert len(record) == 20
        replay(record)


def test_a_second_window_takes_over_and_the_first_can_take_it_back(chrome, tmp_path):
    with place_in(tmp_path) as place, visitor(chrome, place.address) as page:
        page.click("form:has(#driver-partner) button")
        start(page)
        wait_for_steps(page, place.store, 2)
        other = page.context.new_page()
        other.goto(f"{place.address}trip")
        other.wait_for_selector("#start:visible")
        page.wait_for_selector("text=This trip goes on in another window.")
        page.click("#start")
        start(page)
        ended(page)
        assert len(place.store.trip(1).record) == 15


def test_all_pages_fit_all_widths_in_light_and_dark(chrome, tmp_path):
    with place_in(tmp_path, duration=1.0, calibration_trips=1) as place:
        for dark in (False, True):
            reader = Reader(chrome, dark)
            page, problems = reader.page, []

            def look(name, reader=reader, problems=problems):
                for width in WIDTHS:
                    found = reader.overflows(width)
                    problems.extend(f"{name} at {width}: {what}" for what in found)

            page.goto(place.address)
            look("welcome")
            page.click("text=Begin the calibration")
            look("calibration")
            for place_ in range(4):
                page.click("button:has-text('Begin trip')")
                page.wait_for_selector("#start:visible")
                look("trip")
                start(page)
                page.keyboard.press("n")
                ended(page)
                look("over")
                page.click("#on")
                look(f"between {place_}")
            page.click("text=Watch it again")
            look("replay")
            page.goto(f"{place.address}data")
            look("data")
            page.goto(f"{place.address}missing")
            look("missing")
            assert problems == []
            said = [each for each in reader.said if place.address not in each]
            assert [each for each in said if "404" not in each] == []
            reader.context.close()


PHONES = ((390, 844), (375, 667), (360, 640), (320, 568), (844, 390), (667, 375))
OUTSIDE = """() => ["#road", ".pad, .alert-button", "#task-button"]
  .map((name) => [name, document.querySelector(name)])
  .filter(([, each]) => each && (each.getBoundingClientRect().top < 0
    || each.getBoundingClientRect().bottom > innerHeight)).map(([name]) => name)"""


@pytest.mark.parametrize(("width", "height"), PHONES)
@pytest.mark.parametrize("seat", ["driver", "vehicle_ai"])
def test_a_phone_shows_road_and_buttons_at_once(chrome, tmp_path, width, height, seat):
    phone = {"viewport": {"width": width, "height": height}, "has_touch": True, "is_mobile": True}
    with place_in(tmp_path) as place, visitor(chrome, place.address, **phone) as page:
        page.tap(f"form:has(#{seat}-partner) button")
        page.wait_for_selector("#start:visible")
        assert page.evaluate(OUTSIDE) == []
        page.tap("#start")
        if seat == "driver":
            page.tap("#task-button")
            page.wait_for_selector("#task:visible")
            heights = "each => each.map((one) => one.getBoundingClientRect().height)"
            assert min(page.locator("#task .grid button").evaluate_all(heights)) >= 24
        assert page.evaluate("document.documentElement.scrollWidth - innerWidth") <= 0


CONTRAST = """() => {
  const parse = (text) => (text.match(/[\\d.]+/g) || []).map(Number);
  const light = ([r, g, b]) => [r, g, b].map((c) => { c /= 255;
    return c <= 0.03928 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4; })
    .reduce((sum, c, k) => sum + c * [0.2126, 0.7152, 0.0722][k], 0);
  const back = (e) => { for (; e; e = e.parentElement) {
    const c = parse(getComputedStyle(e).backgroundColor);
    if (c.length === 3 || c[3] === 1) return c; } return [255, 255, 255]; };
  const found = [];
  for (const e of document.querySelectorAll('body *')) {
    const own = [...e.childNodes].some((n) => n.nodeType === 3 && n.textContent.trim());
    if (!own || !e.getBoundingClientRect().width || e.closest('#cover')) continue;
    const [a, b] = [light(parse(getComputedStyle(e).color)), light(back(e))];
    const ratio = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
    if (ratio < 4.5) found.push(`${e.textContent.trim().slice(0, 40)}: ${ratio.toFixed(2)}`);
  }
  return found;
}"""


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_texts_have_contrast_and_fields_and_buttons_have_names(chrome, tmp_path, scheme):
    with (
        place_in(tmp_path, duration=1.0) as place,
        visitor(chrome, place.address, color_scheme=scheme, reduced_motion="reduce") as page,
    ):

        def check():
            page.wait_for_load_state("load")  # with its styles
            assert page.evaluate(CONTRAST) == []
            nameless = page.locator("button, a, input:not([type=hidden]), select, canvas")
            for each in nameless.all():
                name = each.evaluate(
                    "e => (e.getAttribute('aria-label') || e.innerText || e.textContent "
                    "|| (e.labels && e.labels.length && e.labels[0].textContent) || '').trim()"
                )
                assert name, each.evaluate("e => e.outerHTML")
            assert page.locator("h1").count() == 1
            assert page.get_attribute("html", "lang") == "en"

        check()
        page.click("form:has(#driver-partner) button")
        start(page)
        page.keyboard.press("n")
        check()
        ended(page)
        page.click("#on")
        check()
        page.goto(f"{place.address}data")
        check()


def test_forms_work_over_plain_http_from_another_machine(chrome, tmp_path):
    """Browsers name no Sec-Fetch-Site there, and the server has to believe their Origin."""
    with place_in(tmp_path, duration=1.0) as place:
        with visitor(chrome, f"http://{ANOTHER_MACHINE}:{place.port}/hmi/") as page:
            assert not page.evaluate("window.isSecureContext")
            page.click("form:has(#driver-partner) button")
            start(page)
            ended(page)
            said = [each for each in page.said if "Opener-Policy" not in each]
            assert said == []
            page.said.clear()
        assert place.store.trip(1).record.finished
