"""What a report shows, piece by piece: paragraphs, tables and pictures, as JSON and as HTML.

A report that is put together later, from files, shows the same pieces as the one that is written
where they were made.
"""

from __future__ import annotations

import base64
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

from hmi_marl.reporting.page import html_table, image, page


@dataclass(frozen=True)
class Told:
    """A paragraph."""

    text: str

    def as_html(self) -> str:
        """For a page."""
        return f"<p>{escape(self.text)}</p>"

    def as_json(self) -> dict[str, Any]:
        """JSON content."""
        return {"kind": "told", "text": self.text}


@dataclass(frozen=True)
class Table:
    """A table with its heading; every row begins with its own."""

    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]

    def as_html(self) -> str:
        """For a page."""
        return f"<h3>{escape(self.title)}</h3>\n{html_table(self.head, self.rows)}"

    def as_json(self) -> dict[str, Any]:
        """JSON content."""
        rows = [list(row) for row in self.rows]
        return {"kind": "table", "title": self.title, "head": list(self.head), "rows": rows}


@dataclass(frozen=True)
class Picture:
    """A PNG."""

    description: str
    content: bytes

    def as_html(self) -> str:
        """For a page, within it."""
        return image("png", self.content, self.description)

    def as_json(self) -> dict[str, Any]:
        """JSON content."""
        content = base64.b64encode(self.content).decode("ascii")
        return {"kind": "picture", "description": self.description, "png": content}


Exhibit = Told | Table | Picture


def exhibit_from(content: dict[str, Any]) -> Exhibit:
    """The piece that ``as_json`` told.

    Raises:
        ValueError: no such piece.
    """
    try:
        match content["kind"]:
            case "told":
                return Told(content["text"])
            case "table":
                return Table(content["title"], content["head"], content["rows"])
            case "picture":
                return Picture(content["description"], base64.b64decode(content["png"]))
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"a damaged piece of a report: {error!r}") from None
    raise ValueError(f"a report has no pieces of kind {content['kind']!r}")


def held(verdicts: Mapping[str, bool]) -> tuple[Exhibit, ...]:
    """What was asked, and whether it holds."""
    return tuple(Told(f"{'holds' if h else 'MISSED'}: {claim}") for claim, h in verdicts.items())


def show(exhibits: Iterable[Exhibit]) -> str:
    """All of them as HTML, one below the other."""
    return "\n".join(exhibit.as_html() for exhibit in exhibits)


def pictures(exhibits: Iterable[Exhibit]) -> list[bytes]:
    """The PNGs among them."""
    return [exhibit.content for exhibit in exhibits if isinstance(exhibit, Picture)]


def page_of(
    title: str,
    exhibits: Iterable[Exhibit],
    seconds: Mapping[str, float],
    command: str,
    settings: Mapping[str, Any],
) -> str:
    """A page that needs nothing besides itself.

    Args:
        title: its heading.
        exhibits: what it shows.
        seconds: how long each part took; nothing is told if that is not known.
        command: that makes the page again.
        settings: all of them, for the small print.
    """
    rows = [[part, f"{spent:.0f} s"] for part, spent in seconds.items()]
    times = [Table("Time of each part", ["part", "time"], rows)] if rows else []
    return page(title, show([*exhibits, *times]), command, settings)
