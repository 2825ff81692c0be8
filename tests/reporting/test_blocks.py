import json
from io import BytesIO

import pytest
from matplotlib.figure import Figure as Drawing
from PIL import Image, ImageColor

from hmi_marl.reporting.blocks import (
    Block,
    Clip,
    Figure,
    Heading,
    Table,
    Text,
    Verdicts,
    as_html,
    as_text,
    block_from,
)
from hmi_marl.reporting.drawing import DARK_PAPER, PAPER, canvas, ink, png
from hmi_marl.reporting.sources import Citation
from hmi_marl.reporting.verdicts import Part, Verdict

TWO = Part.exact("a - b", 2.0, above=1.0)
BLOCKS: tuple[Block, ...] = (
    Heading("Part & parcel", "part"),
    Text("a < b, as `hmi-marl table --quick` shows", "In short"),
    Table(
        "Some <title>",
        ("driver", "x & y"),
        (("lisa", "1\n2"), ("bart", "<3>")),
        "a <note>",
        ["/some table"],
    ),
    Figure("bars", 'a "figure"', b"\x89PNG\x00", b"narrow", b"dark", b"both", ["/rows"]),
    Clip("drive", "4 s: <homer>", b"GIF"),
    Verdicts(
        (
            Verdict("a > b", (TWO, Part.exact("a", 3.0, above=2.0)), "two things", "Sec. I"),
            Verdict("c", reason="not run"),
        )
    ),
)


CITED = Citation("hmi-marl <one>", "all.json", "/at", "made.html#one")


def test_a_block_shows_the_same_after_it_was_kept_as_json() -> None:
    kept = [block_from(json.loads(json.dumps(block.as_json()))) for block in BLOCKS]
    assert as_html(kept) == as_html(BLOCKS)
    assert as_text(kept) == as_text(BLOCKS)
    assert as_html(kept, CITED) == as_html(BLOCKS, CITED)
    assert [block.content for block in kept if isinstance(block, Figure)] == [b"\x89PNG\x00"]


def test_the_text_of_every_block() -> None:
    assert (
        as_text(BLOCKS)
        == """\
Part & parcel
=============

In short: a < b, as hmi-marl table --quick shows

Some <title>
  driver  x & y
  lisa    1
          2
  bart    <3>
  a <note>

4 s: <homer>

Verdicts
  supported     a > b
                  a - b 2 (> 1?); a 3 (> 2?); two things
                  exact
  undetermined  c
                  not run"""
    )


def test_html_escapes_what_is_said_and_holds_figures_and_clips() -> None:
    html = as_html(BLOCKS)
    for raw in ("a < b", "<title>", "<3>", "<note>", "<homer>", '"figure"', "a > b"):
        assert raw not in html
    for shown in (
        '<h2 id="part">Part &amp; parcel</h2>',
        "<b>In short</b>",
        '<span class="word">--quick</span></code>',
        "1<br>2",
        'src="data:image/png;base64,iVBORwA="',
        '<source media="(max-width: 40rem)" srcset="data:image/png;base64,bmFycm93">',
        '<source media="(prefers-color-scheme: dark)" srcset="data:image/png;base64,ZGFyaw==">',
        '(prefers-color-scheme: dark)" srcset="data:image/png;base64,Ym90aA=="',
        'src="data:image/gif;base64,R0lG"',
        "1 supported, 1 undetermined.",
        "<td class='good'>supported</td>",
        "<td class='half'>undetermined</td>",
        "<summary>2 parts</summary><ul><li>a - b 2 (&gt; 1?) supported; exact</li>",
    ):
        assert shown in html


def test_sources_are_shown_below_blocks_and_with_each_verdict() -> None:
    html = as_html(BLOCKS, CITED)
    for place in ("/at/rows", "/at/some table", "/at/verdicts/0", "/at/verdicts/1"):
        assert f"<code>all.json#{place}</code></a>" in html
    assert 'href="all.json#/at/some%20table"' in html
    assert html.count('<a href="made.html#one"><code>hmi-marl &lt;one&gt;</code></a>') == 4
    assert "all.json" not in as_html(BLOCKS)


def test_a_figure_that_is_drawn_is_drawn_for_dark_pages_as_well() -> None:
    def draw() -> bytes:
        drawing = canvas(1, 1)
        drawing.text(0.5, 0.5, "x", color=ink())
        return png(drawing, 20)

    figure = Figure("x", "an x", draw, draw)
    assert figure.drawn == figure.drawn_narrow == draw()
    assert figure.drawn_dark == figure.drawn_dark_narrow != figure.drawn
    for picture, paper in ((figure.drawn, PAPER), (figure.drawn_dark or b"", DARK_PAPER)):
        with Image.open(BytesIO(picture)) as image:
            assert image.convert("RGB").getpixel((0, 0)) == ImageColor.getrgb(paper)
    assert Figure("x", "an x", b"PNG").drawn_dark is None
    kept = block_from(json.loads(json.dumps(figure.as_json())))
    assert isinstance(kept, Figure)
    assert kept.as_html() == figure.as_html()


@pytest.mark.parametrize(
    "content",
    [
        {},
        {"kind": "film"},
        {"kind": "table"},
        {"kind": "figure", "content": "?"},
        {"kind": "verdicts", "verdicts": [{"claim": "a", "parts": "maybe"}]},
    ],
)
def test_what_is_no_block_is_refused(content: dict) -> None:
    with pytest.raises(ValueError, match="report"):
        block_from(content)


def test_a_drawing_becomes_a_png() -> None:
    assert png(Drawing(figsize=(1, 1)), dpi=10).startswith(b"\x89PNG")
