"""The report of a reproduction in a browser: on a phone, a tablet and a laptop, light and dark."""

from pathlib import Path

import pytest
from browsing import WIDTHS, Reader, browser, chromium, walk
from PIL import ImageColor
from simulated_pages import whole_report

from hmi_marl.reporting.drawing import DARK_PAPER, PAPER

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not chromium(), reason="no Chromium here: apt-get install chromium"),
]
SCREEN = {"width": 1280, "height": 800}


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("below") / "some where" / "report"
    whole_report().write(folder)
    return folder


@pytest.mark.parametrize("dark", [False, True])
def test_every_page_fits_and_its_links_lead_somewhere(report: Path, dark: bool) -> None:
    pages = sorted(report.glob("*.html"))
    assert len(pages) == 11
    with browser() as started:
        found = walk(started, report, pages, dark=dark)
    assert not found.problems
    assert not found.dead_links()
    assert not found.elsewhere()
    for links in found.links.values():
        assert {f"{(report / page).as_uri()}" for page in ("index.html", "claims.html")} <= links


def test_the_summary_is_one_screen(report: Path) -> None:
    with browser() as started:
        reader = Reader(started)
        reader.page.set_viewport_size(SCREEN)
        reader.open(report / "index.html")
        ends = reader.page.evaluate(
            "() => [...document.body.children].map(e => e.getBoundingClientRect().bottom)"
        )
        cards = reader.page.evaluate(
            "() => [...document.querySelectorAll('.card')].map(e => e.getBoundingClientRect().top)"
        )
    assert max(ends) <= SCREEN["height"]
    assert len(cards) == 3
    assert len(set(cards)) == 1, "the cards are in one row"


@pytest.mark.parametrize("page", ["index", "table"])
def test_figures_follow_dark_mode(report: Path, page: str) -> None:
    with browser() as started:
        for dark, paper in ((False, PAPER), (True, DARK_PAPER)):
            reader = Reader(started, dark)
            reader.open(report / f"{page}.html")
            found = reader.corners()
            assert len(found) == (3 if page == "index" else 1)
            assert set(found) == {ImageColor.getrgb(paper)}


def test_wide_tables_scroll_on_a_phone_and_verdicts_stack(report: Path) -> None:
    with browser() as started:
        reader = Reader(started)
        reader.open(report / "table.html")
        assert not reader.overflows(WIDTHS[0])
        scrolls = reader.page.evaluate(
            "() => [...document.querySelectorAll('.wide')].some(e => e.scrollWidth > e.clientWidth)"
        )
        assert scrolls
        reader.open(report / "claims.html")
        reader.overflows(WIDTHS[0])
        claim, numbers, verdict = reader.page.evaluate(
            "() => [...document.querySelectorAll('.stack td')].slice(0, 3)"
            ".map(e => e.getBoundingClientRect().top)"
        )
        assert claim < verdict < numbers
