import json
from pathlib import Path

import hmi_marl
from hmi_marl.reporting.blocks import Figure, Heading, Text
from hmi_marl.reporting.report import Report, Stopwatch

BLOCKS = (
    Heading("One & all", "one"),
    Text("a < b"),
    Figure("bars", 'a "figure"', b"\x89PNG\x00", sources=["/rows"]),
)


def report(seconds: dict[str, float]) -> Report:
    settings = {"n": 3, "learn": {"rate": 0.5}}
    return Report("made", "A & B", BLOCKS, {"rows": [1]}, "do <it>", settings, seconds)


def test_a_page_needs_no_other_file_and_escapes_what_it_says() -> None:
    html = report({"part <1>": 2.4}).page
    for raw in ("a < b", "part <1>", "do <it>", '"figure"', "http:"):
        assert raw not in html
    for shown in ("a &lt; b", "part &lt;1&gt;", "2 s", "A &amp; B", "n = 3, learn.rate = 0.5"):
        assert shown in html
    assert '<a href="#one">One &amp; all</a>' in html
    assert 'src="data:image/png;base64,iVBORwA="' in html
    assert '<a href="made.json#/rows"><code>made.json#/rows</code></a>' in html
    assert '<a href="made.json#/seconds">' in html
    assert "Time of each part" not in report({}).page


def test_all_files_are_written(tmp_path: Path) -> None:
    made = report({"playing": 0.5})
    page = made.write(tmp_path / "out")
    assert page.read_text("utf-8") == made.page
    assert {path.name for path in page.parent.iterdir()} == {
        *("made.txt", "made.json", "bars.png", "index.html")
    }
    assert (page.parent / "made.txt").read_text("utf-8") == made.text + "\n"
    assert json.loads((page.parent / "made.json").read_text("utf-8")) == {
        "hmi_marl_version": hmi_marl.__version__,
        "command": "do <it>",
        "settings": {"n": 3, "learn": {"rate": 0.5}},
        "rows": [1],
        "seconds": {"playing": 0.5},
    }


def test_durations_have_names() -> None:
    watch = Stopwatch()
    with watch.timing("waiting"):
        pass
    assert list(watch.seconds) == ["waiting"]
    assert 0.0 <= watch.seconds["waiting"] < 1.0
