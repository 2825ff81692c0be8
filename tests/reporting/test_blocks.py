import json

import pytest

from hmi_marl.reporting.blocks import (
    Picture,
    Table,
    Told,
    exhibit_from,
    held,
    page_of,
    pictures,
    show,
)

PIECES = (
    Told("a < b"),
    Table("Some <title>", ("driver", "x & y"), (("lisa", "1\n2"), ("bart", "<3>"))),
    Picture('a "picture"', b"\x89PNG\x00"),
)


def test_a_piece_shows_the_same_after_it_was_kept_as_json() -> None:
    kept = [exhibit_from(json.loads(json.dumps(piece.as_json()))) for piece in PIECES]
    assert show(kept) == show(PIECES)
    assert pictures(kept) == [b"\x89PNG\x00"]


def test_text_is_escaped_and_pictures_are_within_the_page() -> None:
    html = page_of("A & B", PIECES, {"part <1>": 2.4}, "do <it>", {"n": 3})
    for raw in ("a < b", "<title>\n", "<3>", "part <1>", "do <it>", '"picture"'):
        assert raw not in html
    for told in ("a &lt; b", "1<br>2", "part &lt;1&gt;", "2 s", "A &amp; B", "n = 3"):
        assert told in html
    assert 'src="data:image/png;base64,iVBORwA="' in html
    assert "Time of each part" not in page_of("A", PIECES, {}, "", {})


def test_what_was_asked_is_told_as_it_came_out() -> None:
    assert held({"one": True, "other": False}) == (Told("holds: one"), Told("MISSED: other"))


@pytest.mark.parametrize(
    "content", [{}, {"kind": "film"}, {"kind": "table"}, {"kind": "picture", "png": "?"}]
)
def test_what_is_no_piece_is_refused(content: dict) -> None:
    with pytest.raises(ValueError, match="report"):
        exhibit_from(content)
