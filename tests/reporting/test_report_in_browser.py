"""Report pages in a browser: all that commands can write, on a phone, a tablet and a laptop."""

import pytest
from browsing import Reader, browser, chromium, walk
from pages import DOCS
from PIL import ImageColor

from hmi_marl.reporting.blocks import Clip, Figure, Heading, Table, Text, Verdicts
from hmi_marl.reporting.drawing import DARK_PAPER, PAPER, canvas, png
from hmi_marl.reporting.report import Report
from hmi_marl.reporting.verdicts import Part, Verdict

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not chromium(), reason="no Chromium here: apt-get install chromium"),
]
LONG = "runs/" + "averylongnamewithoutaplacetobreak" * 5


def picture():
    drawing = canvas(11, 4)
    drawing.subplots().plot([0, 1], [1, 0])
    return png(drawing)


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    head = ["driver and what it learned with", *(f"column {k}" for k in range(20))]
    row = ["lisa, marge, bart and homer, one after the other", *(["-123.4 [-130.1, -116.7]"] * 20)]
    parts = [Part.exact(LONG, 1.0, above=0.5), Part.exact(LONG, 0.0, above=0.5)]
    outcomes = [
        Verdict(f"{LONG} {len(some)}", tuple(some), f"measured: {LONG}", "5.1")
        for some in ([], parts[:1], parts)
    ]
    blocks = [
        Heading("A section", "section"),
        Text(f"Made by `hmi-marl table --out {LONG} --episodes 2000` from {LONG}.", lead=LONG),
        Table("A wide table", head, [row] * 3, note=LONG),
        Table("A table of long words", ["name", "value"], [[LONG, LONG]]),
        Figure("figure", "A figure", picture),
        Clip("clip", LONG, picture()),
        Verdicts(outcomes, note=LONG),
    ]
    settings = {"out": LONG, "drivers": ("lisa", "bart")}
    report = Report("try", f"A title with {LONG}", blocks, {}, f"hmi-marl table {LONG}", settings)
    return report.write(tmp_path_factory.mktemp("report"))


@pytest.mark.parametrize("dark", [False, True])
def test_nothing_leaves_its_box_on_a_page_that_holds_every_block(page, dark):
    with browser() as started:
        found = walk(started, page.parent, [page], dark=dark)
    assert not found.problems
    assert not found.dead_links()
    assert not found.elsewhere()


def test_nothing_leaves_its_box_on_the_report_that_is_shipped():
    folder = DOCS / "report"
    with browser() as started:
        found = walk(started, folder, sorted(folder.glob("*.html")))
    assert not found.problems
    assert not found.dead_links()


def test_figures_turn_dark_with_the_page_and_clips_do_not(page):
    with browser() as started:
        shown = []
        for dark in (False, True):
            reader = Reader(started, dark)
            reader.open(page)
            shown.append(reader.corners())
    (light, clip), (dark, same) = shown
    assert light == ImageColor.getrgb(PAPER)
    assert dark == ImageColor.getrgb(DARK_PAPER)
    assert clip == same
