import json
from dataclasses import replace
from pathlib import Path

import pytest

from hmi_marl.reporting.blocks import Table, Text
from hmi_marl.reporting.pages import Page, PagedReport
from hmi_marl.reporting.sources import Citation

CITED = Citation("hmi-marl try", "try.json", about="made.html#try")
FIRST = Page("index", "Summary", "A <title>", [Text("a < b")], CITED)
SECOND = Page("more", "More & more", "More", [Table("", ["n"], [["1"]], sources=["/rows"])], CITED)
TIMES = replace(SECOND, name="times", short="Times", title="Durations", repeatable=False)
REPORT = PagedReport(
    "try", (FIRST, SECOND, TIMES), {"rows": (1,)}, "hmi-marl try", {"n": 3}, {"t.json": {"a": 2.0}}
)


def test_all_files_are_written_and_pages_lead_to_each_other(tmp_path: Path) -> None:
    assert REPORT.write(tmp_path / "out") == tmp_path / "out" / "index.html"
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert names == {"index.html", "more.html", "times.html", "try.json", "try.txt", "t.json"}
    content = json.loads((tmp_path / "out" / "try.json").read_text())
    assert (content["command"], content["settings"], content["rows"]) == (
        "hmi-marl try",
        {"n": 3},
        [1],
    )
    first, second = ((tmp_path / "out" / page.address).read_text() for page in (FIRST, SECOND))
    assert '<a href="index.html" aria-current=page>Summary</a>' in first
    assert '<a href="more.html">More &amp; more</a>' in first
    assert '<a href="index.html">Summary</a>' in second
    assert "<h1>A &lt;title&gt;</h1>" in first
    assert '<a href="try.json#/rows">' in second


def test_the_text_has_every_page_but_that_of_durations() -> None:
    assert REPORT.text == "A <title>\n#########\n\na < b\n\nMore\n####\n\n  n\n  1"


def test_two_pages_of_one_name_and_another_first_page_are_refused() -> None:
    with pytest.raises(ValueError, match=r"two pages in more\.html"):
        replace(REPORT, pages=(FIRST, SECOND, SECOND))
    with pytest.raises(ValueError, match=r"first page is index\.html"):
        replace(REPORT, pages=(SECOND, FIRST))
