from html import unescape

import pytest
from foreign_texts import FOREIGN

from hmi_marl.text import in_figure, in_html, one_line, printable


@pytest.mark.parametrize("text", FOREIGN)
def test_nothing_but_text_is_left(text: str) -> None:
    for shown in (
        printable(text),
        one_line(text),
        in_figure(text),
        in_html(text).replace("\n", ""),
    ):
        assert shown.isprintable()
        shown.encode("utf-8")
    assert len(in_figure(text)) <= 2 * 40
    assert not in_figure(text).startswith("_")
    assert not set("<>\"'") & set(in_html(text))
    assert unescape(in_html(text)) == printable(text, keep="\n")


@pytest.mark.parametrize("text", ["homer", "β of α", "runs/first-1_2", "100 % (a & b)", ""])
def test_plain_text_stays_as_it_is(text: str) -> None:
    assert printable(text) == one_line(text) == in_figure(text) == text


def test_what_does_not_print_is_written_as_an_escape() -> None:
    assert printable("a\x1b[31m\nb\u202e\udcff") == r"a\x1b[31m\nb\u202e\udcff"
    assert printable("a\n\tb", keep="\n") == "a\n\\tb"


def test_long_texts_are_cut_in_the_middle() -> None:
    assert one_line("a" * 50 + "b" * 50, 11) == "aaaaa…bbbbb"
    assert one_line("a  b\n c") == "a b c"
    assert in_figure("runs/" + "x" * 100 + "/homer").endswith("x/homer")


def test_dollars_are_no_mathematics_and_an_underscore_hides_no_label() -> None:
    from matplotlib.figure import Figure

    axes = Figure().subplots()
    for name in ("$a$", r"\$b", "_c"):
        axes.plot([0, 1], label=in_figure(name))
    _, labels = axes.get_legend_handles_labels()
    assert labels == [r"\$a\$", r"\\$b", " _c"]
    texts = [axes.text(0, 0, label) for label in labels]
    # What is drawn, and whether as mathematics.
    assert [text._preprocess_math(text.get_text()) for text in texts] == [
        ("$a$", False),
        (r"\$b", False),
        (" _c", False),
    ]
