"""The built site in a browser: on a phone, a tablet and a laptop, by day and by night."""

import re
import subprocess
import sys

import pytest
from browsing import Reader, browser, chromium, walk
from pages import ROOT

pytestmark = [
    pytest.mark.slow,
    pytest.mark.xdist_group("site"),
    pytest.mark.skipif(not chromium(), reason="no Chromium here: apt-get install chromium"),
]
REPOSITORY = "https://github.com/hmi-marl/hmi-marl/"


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    folder = tmp_path_factory.mktemp("built") / "site"
    subprocess.run([sys.executable, ROOT / "docs" / "making", "--site-dir", folder], check=True)
    return folder


def pages(site):
    found = sorted(site.rglob("*.html"))
    assert len(found) > 30
    return found


def test_every_page_fits_its_links_lead_somewhere_and_nothing_is_asked_of_the_net(site):
    with browser() as started:
        found = walk(started, site, pages(site))
    assert not found.problems
    assert not found.dead_links()
    for link in found.elsewhere():
        home = re.match(rf"{REPOSITORY}(?:edit|blob|tree)/main/([^#]*)", link)
        assert home is None or (ROOT / home[1]).exists(), link
    assert f"{REPOSITORY}edit/main/docs/exact.md" in found.elsewhere()
    assert f"{REPOSITORY}edit/main/CHANGELOG.md" in found.elsewhere()


def test_the_site_is_dark_where_the_reader_wants_it_and_figures_follow(site):
    with browser() as started:
        for dark in (False, True):
            reader = Reader(started, dark)
            reader.open(site / "results.html")
            paper, figure = reader.page.evaluate(
                """() => [getComputedStyle(document.body).backgroundColor,
                getComputedStyle(document.querySelector('article img[src$=".png"]')).filter]"""
            )
            light = sum(map(int, re.findall(r"\d+", paper)[:3])) / 3
            assert light < 60 if dark else light > 200
            assert ("invert" in figure) is dark
            assert not reader.overflows(390)


def test_searching_finds_a_page(site):
    with browser() as started:
        reader = Reader(started)
        reader.open(site / "index.html")
        reader.page.keyboard.press("Control+k")
        reader.page.keyboard.type("trait_posterior", delay=20)
        reader.page.get_by_text("exact.trait_posterior").first.wait_for()
        assert not reader.said


def test_mathematics_is_drawn_by_the_browser_itself(site):
    with browser() as started:
        reader = Reader(started)
        reader.open(site / "exact.html")
        sizes = reader.page.evaluate(
            "() => [...document.querySelectorAll('math')].map(e => e.clientHeight)"
        )
    assert len(sizes) >= 3
    assert all(size > 8 for size in sizes)
