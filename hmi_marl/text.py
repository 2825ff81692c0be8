"""Texts of others, such as names of drivers and folders, shown as they are and nothing else.

In a terminal they may hold control characters, in HTML tags, in a figure what Matplotlib takes for
mathematics. Every text of others that is shown goes through one of these functions.
"""

from __future__ import annotations

from collections.abc import Iterable
from html import escape

_MOST_QUOTED = 300
"""Most characters of what an error quotes: names of others, or another library's message."""
_LABEL = 40
"""Most characters of a label in a figure."""


def printable(text: str, keep: str = "") -> str:
    """Write characters that do not print as escapes, but for those in ``keep``.

    These are control characters, invisible marks, and bytes of file names that are not UTF-8.
    """
    if text.isprintable():
        return text
    return "".join(
        char if char in keep or char.isprintable() else char.encode("unicode_escape").decode()
        for char in text
    )


def one_line(text: str, most: int = 2000) -> str:
    """Write a text on one line of at most so many characters; the middle of a longer one is cut."""
    return _shortened(printable(" ".join(text.split())), most)


def listed(names: Iterable[str]) -> str:
    """Write names on one line of bounded length, for an error."""
    return one_line(", ".join(names), _MOST_QUOTED)


def quoted(error: object) -> str:
    """Write another library's message, which may quote the file, on one line of bounded length."""
    return one_line(str(error), _MOST_QUOTED)


def in_html(text: str) -> str:
    """Write a text for HTML; lines stay lines."""
    return escape(printable(text, keep="\n"))


def in_figure(text: str, most: int = _LABEL) -> str:
    """Write a text as a label of Matplotlib: no mathematics, and never hidden from a legend."""
    label = _shortened(printable(text), most).replace("$", r"\$")
    return f" {label}" if label.startswith("_") else label  # legends leave out what begins so


def _shortened(text: str, most: int) -> str:
    """Cut the middle of a text of more than so many characters."""
    if len(text) <= most:
        return text
    head = (most - 1) // 2
    return f"{text[:head]}…{text[len(text) - (most - 1 - head) :]}"
