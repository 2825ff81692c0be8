"""The walk finds what is wrong with a page: each fault is made on purpose."""

import pytest
from browsing import browser, chromium, walk

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not chromium(), reason="no Chromium here: apt-get install chromium"),
]
WIDE = "<table><tr>" + "<td>entry</td>" * 200 + "</tr></table>"
PIXEL = "data:image/gif;base64,R0lGODlhAQABAAAAACwAAAAAAQABAAA="
FAULTS = {
    "wide": (WIDE, "wide"),
    "cut": (f'<div style="overflow: hidden">{WIDE}</div>', "cut off"),
    "low": ('<div style="height: 9px; overflow: hidden">two<br>lines</div>', "cut off below"),
    "letters": (
        f'<table style="width: 300px"><tr><td style="overflow-wrap: anywhere">{"letters " * 9}</td>'
        f"<td>{'x' * 90}</td></tr></table>",
        "column of letters",
    ),
    "entry": (
        '<table style="width: 99px; table-layout: fixed"><tr><td>averyverylongword</td><td>x</td>'
        "</tr></table>",
        "overflows its box",
    ),
    "code": ('<pre style="width: 40px">a_long_line_of_code</pre>', "overflows its box"),
    "picture": ('<img src="none.png" width="9" height="9">', "is not shown"),
    "error": ("<script>console.error('loud')</script>", "loud"),
    "raised": ("<script>throw new Error('raised')</script>", "raised"),
    "faint": ('<div style="background: #fff; color: #999">grey</div>', "is faint (2.85): grey"),
    "night": (
        "<style>div { background: #fff; color: #000 } @media (prefers-color-scheme: dark) {"
        "div { background: #222; color: #333 } }</style><div>grey</div>",
        "in the dark, is faint",
    ),
    "net": ('<link rel="stylesheet" href="http://127.0.0.1:9/none.css">', "asks the net"),
}
FINE = {
    "large": '<div style="background: #fff; color: #888; font-size: 24px">grey</div>',
    "high row": "<table><tr><td>short</td><td>" + "a line<br>" * 20 + "</td></tr></table>",
    "picture": '<table><tr><td><img width="90" height="300" src="' + PIXEL + '"></td></tr></table>',
    "scrolls": f'<div style="overflow-x: auto">{WIDE}</div>',
    "code": '<pre style="overflow-x: auto"><code>' + "long " * 100 + "</code></pre>",
}


def found_on(folder, body):
    page = folder / "page.html"
    page.write_text(f"<!doctype html><html><body>{body}</body></html>")
    with browser() as started:
        return walk(started, folder, [page])


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_found(fault, tmp_path):
    body, words = FAULTS[fault]
    assert any(words in problem for problem in found_on(tmp_path, body).problems)


@pytest.mark.parametrize("page", FINE)
def test_what_scrolls_in_its_box_is_no_fault(page, tmp_path):
    assert not found_on(tmp_path, FINE[page]).problems


def test_dead_links_and_anchors_are_found(tmp_path):
    links = '<a href="none.html">x</a><a href="#none">y</a><a id="here" href="#here">z</a>'
    dead = found_on(tmp_path, links).dead_links()
    assert len(dead) == 2
    assert "none.html is not there" in dead[0] + dead[1]
    assert "no such anchor" in dead[0] + dead[1]
