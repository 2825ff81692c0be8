"""Blocks of a report: paragraphs, tables, figures, clips and verdicts.

One description of a block renders as text for a terminal, as HTML for a page and as JSON, from
which it can be read again: a report assembled later, from files, shows the same blocks. A block
names the places of its numbers in the report's JSON file (:attr:`Block.sources`).
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from base64 import b64encode
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, TypeVar

from hmi_marl.checks import shown
from hmi_marl.files import json_value
from hmi_marl.reporting.drawing import on_dark
from hmi_marl.reporting.sources import Citation
from hmi_marl.reporting.verdicts import Outcome, Verdict
from hmi_marl.text import in_html, printable
from hmi_marl.typed_json import read_as

T = TypeVar("T")
Picture = bytes | Callable[[], bytes]
"""PNG or GIF, or a function that draws one."""
OUTCOME_CLASSES: Mapping[Outcome, str] = {
    Outcome.SUPPORTED: "good",
    Outcome.UNDETERMINED: "half",
    Outcome.NOT_SUPPORTED: "bad",
}
"""Style classes of the page by outcome."""


class Block(ABC):
    """Part of a report."""

    kind: ClassVar[str]
    """Name of its class in JSON."""
    sources: Sequence[str] = ()
    """JSON pointers to its numbers in the JSON file of its report."""

    @abstractmethod
    def as_text(self) -> str:
        """Render for a terminal."""

    @abstractmethod
    def as_html(self) -> str:
        """Render for a page."""

    def cited_html(self, cited: Citation) -> str:
        """Render for a page, with its sources."""
        return f"{self.as_html()}\n{cited.as_html(self.sources)}".rstrip()

    def as_json(self) -> dict[str, Any]:
        """JSON content, from which :func:`block_from` reads it again."""
        return {"kind": self.kind} | {
            name: _base64(value) if isinstance(value, bytes) else json_value(value)
            for name, value in vars(self).items()
        }


@dataclass(frozen=True)
class Heading(Block):
    """Title of a section."""

    text: str
    anchor: str = ""
    """Name for links; titles that have one are listed at the top of the page."""
    kind: ClassVar = "heading"

    def as_text(self) -> str:
        """Render for a terminal."""
        return f"{self.text}\n{'=' * len(self.text)}"

    def as_html(self) -> str:
        """Render for a page."""
        anchor = f' id="{in_html(self.anchor)}"' if self.anchor else ""
        return f"<h2{anchor}>{in_html(self.text)}</h2>"


@dataclass(frozen=True)
class Text(Block):
    """Paragraph; commands in it stand between backticks."""

    text: str
    lead: str = ""
    """A few words in bold before it."""
    kind: ClassVar = "text"

    def as_text(self) -> str:
        """Render for a terminal."""
        text = self.text.replace("`", "")
        return f"{self.lead}: {text}" if self.lead else text

    def as_html(self) -> str:
        """Render for a page."""
        lead = f"<b>{in_html(self.lead)}</b><br>" if self.lead else ""
        return f"<p>{lead}{_with_commands(self.text)}</p>"


@dataclass(frozen=True)
class Table(Block):
    """Table whose rows begin with their heading; entries may have several lines."""

    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    note: str = ""
    """Explanation below the table."""
    sources: Sequence[str] = ()
    kind: ClassVar = "table"

    def __post_init__(self) -> None:
        for row in self.rows:
            if not len(row) == len(self.head) > 0:
                raise ValueError(f"a row of {len(row)} entries in {len(self.head)} columns")

    @classmethod
    def of(
        cls,
        title: str,
        items: Iterable[T],
        columns: Mapping[str, Callable[[T], str]],
        note: str = "",
        sources: Sequence[str] = (),
    ) -> Table:
        """Make a table with a row for each item; columns are what they show of it, by heading."""
        rows = [[shown(item) for shown in columns.values()] for item in items]
        return cls(title, list(columns), rows, note, sources)

    def as_text(self) -> str:
        """Render in columns for a terminal."""
        lines = [list(self.head)]
        for row in self.rows:
            entries = [entry.split("\n") for entry in row]
            for k in range(max(map(len, entries))):
                lines.append([entry[k] if k < len(entry) else "" for entry in entries])
        widths = [max(len(line[column]) for line in lines) for column in range(len(self.head))]
        shown = [
            "  " + "  ".join(e.ljust(w) for e, w in zip(line, widths, strict=True)).rstrip()
            for line in lines
        ]
        return "\n".join([*([self.title] if self.title else []), *shown, *_lines(self.note)])

    def as_html(self) -> str:
        """Render for a page."""
        top = "".join(f"<th>{_entry(name)}</th>" for name in self.head)
        body = "".join(
            f"<tr><th>{_entry(row[0])}</th>"
            + "".join(f"<td>{_entry(entry)}</td>" for entry in row[1:])
            + "</tr>"
            for row in self.rows
        )
        title = f"<h3>{in_html(self.title)}</h3>\n" if self.title else ""
        note = f'\n<p class="small">{in_html(self.note)}</p>' if self.note else ""
        return f'{title}<div class="wide"><table><tr>{top}</tr>{body}</table></div>{note}'


@dataclass(frozen=True)
class Figure(Block):
    """PNG of a figure, or a function that draws it when it is first shown.

    So a report's numbers are written before its figures are drawn. A function draws it for light
    and for dark pages; see :mod:`hmi_marl.reporting.drawing`.
    """

    name: str
    """Name of its file, without the suffix."""
    description: str
    """Text for readers who do not see it."""
    content: Picture
    narrow: Picture | None = None
    """For narrow screens."""
    dark: bytes | None = None
    """For dark pages, of a figure that is a PNG."""
    dark_narrow: bytes | None = None
    sources: Sequence[str] = ()
    kind: ClassVar = "figure"
    suffix: ClassVar = "png"

    @cached_property
    def drawn(self) -> bytes:
        """The PNG."""
        return self.content if isinstance(self.content, bytes) else self.content()

    @cached_property
    def drawn_narrow(self) -> bytes | None:
        """The PNG for narrow screens."""
        return self.narrow() if callable(self.narrow) else self.narrow

    @cached_property
    def drawn_dark(self) -> bytes | None:
        """The PNG for dark pages."""
        return _on_dark(self.content, self.dark)

    @cached_property
    def drawn_dark_narrow(self) -> bytes | None:
        """The PNG for dark pages on narrow screens."""
        return _on_dark(self.narrow, self.dark_narrow)

    def as_text(self) -> str:
        """Nothing on a terminal."""
        return ""

    def as_html(self) -> str:
        """Render for a page, with the pictures inside it; wide ones scroll on a narrow screen."""
        kind = "drawn" if self.drawn_narrow is None else "drawn narrow"
        return f'<div class="{kind}">{self.picture()}</div>'

    def picture(self) -> str:
        """Render the picture alone, that of them which suits the reader's screen."""
        narrow, dark = "(max-width: 40rem)", "(prefers-color-scheme: dark)"
        others = {
            f"{narrow} and {dark}": self.drawn_dark_narrow,
            narrow: self.drawn_narrow,
            dark: self.drawn_dark,
        }
        listed = "".join(
            f'<source media="{media}" srcset="{_data(self.suffix, png)}">'
            for media, png in others.items()
            if png is not None
        )
        shown = f'<img alt="{in_html(self.description)}" src="{_data(self.suffix, self.drawn)}">'
        return f"<picture>{listed}{shown}</picture>"

    def as_json(self) -> dict[str, Any]:
        """JSON content, with the figure drawn."""
        about = {"kind": self.kind, "name": self.name, "description": self.description}
        drawn = {
            "content": self.drawn,
            "narrow": self.drawn_narrow,
            "dark": self.drawn_dark,
            "dark_narrow": self.drawn_dark_narrow,
        }
        pictures = {n: None if png is None else _base64(png) for n, png in drawn.items()}
        return about | pictures | {"sources": list(self.sources)}


def _on_dark(picture: Picture | None, dark: bytes | None) -> bytes | None:
    if dark is not None or not callable(picture):
        return dark
    with on_dark():
        return picture()


@dataclass(frozen=True)
class Clip(Block):
    """Animated GIF of an episode."""

    name: str
    """Name of its file, without the suffix."""
    caption: str
    content: Picture
    """GIF, or a function that draws it when it is first shown."""
    sources: Sequence[str] = ()
    kind: ClassVar = "clip"
    suffix: ClassVar = "gif"

    @cached_property
    def drawn(self) -> bytes:
        """The GIF."""
        return self.content if isinstance(self.content, bytes) else self.content()

    def as_json(self) -> dict[str, Any]:
        """JSON content, with the clip drawn."""
        about = {"kind": self.kind, "name": self.name, "caption": self.caption}
        return about | {"content": _base64(self.drawn), "sources": list(self.sources)}

    def as_text(self) -> str:
        """Render the caption for a terminal."""
        return self.caption

    def as_html(self) -> str:
        """Render for a page, with the clip inside it."""
        alt = in_html(self.caption or "clip of one episode")
        source = _data(self.suffix, self.drawn)
        return f'<img class="clip" alt="{alt}" src="{source}"><p>{in_html(self.caption)}</p>'


@dataclass(frozen=True)
class Verdicts(Block):
    """Statements with their outcomes and reasons."""

    verdicts: Sequence[Verdict]
    title: str = "Verdicts"
    note: str = ""
    sources: Sequence[str] = ("/verdicts",)
    kind: ClassVar = "verdicts"

    def as_text(self) -> str:
        """Render for a terminal: outcome and claim, then the numbers, then what they rest on."""
        width = max((len(verdict.outcome) for verdict in self.verdicts), default=0)
        lines = []
        for verdict in self.verdicts:
            lines.append(f"  {verdict.outcome:<{width}}  {verdict.claim}")
            told = (line for line in (verdict.summary, verdict.basis) if line)
            lines += [f"  {'':<{width}}    {line}" for line in told]
        return "\n".join([self.title, *lines, *_lines(self.note)])

    def as_html(self) -> str:
        """Render for a page, outcomes coloured, with all parts of each verdict to be unfolded."""
        return self._html([""] * len(self.verdicts))

    def cited_html(self, cited: Citation) -> str:
        """Render for a page, with the place of each verdict in the JSON file."""
        places = [
            cited.as_html([f"{source}/{k}" for source in self.sources])
            for k in range(len(self.verdicts))
        ]
        return self._html(places)

    def _html(self, places: Sequence[str]) -> str:
        counts = Counter(verdict.outcome for verdict in self.verdicts)
        summary = ", ".join(
            f"{counts[outcome]} {outcome}" for outcome in Outcome if counts[outcome]
        )
        rows = "".join(map(_verdict_row, self.verdicts, places))
        note = f" {in_html(self.note)}" if self.note else ""
        return (
            f"<h3>{in_html(self.title)}</h3>\n<p>{in_html(summary)}.{note}</p>\n"
            "<div class='wide'><table class='stack'><tr><th>claim</th>"
            f"<th>by the numbers of this run</th><th>verdict</th></tr>{rows}</table></div>"
        )


def _verdict_row(verdict: Verdict, place: str) -> str:
    where = f"<br><span class='small'>{in_html(verdict.where)}</span>" if verdict.where else ""
    basis = f"<br><span class='small'>{in_html(verdict.basis)}</span>" if verdict.basis else ""
    parts = ""
    if len(verdict.parts) > 1:
        confidence = verdict.correction.confidence
        items = "".join(
            f"<li>{in_html(part.shown(confidence))} {outcome}; {in_html(part.basis())}</li>"
            for part, outcome in zip(verdict.parts, verdict.outcomes, strict=True)
        )
        parts = f"<details><summary>{len(verdict.parts)} parts</summary><ul>{items}</ul></details>"
    outcome = verdict.outcome
    return (
        f"<tr><td>{in_html(verdict.claim)}{where}</td>"
        f"<td>{in_html(verdict.summary)}{basis}{parts}{place}</td>"
        f"<td class='{OUTCOME_CLASSES[outcome]}'>{outcome}</td></tr>"
    )


def block_from(content: Any) -> Block:
    """Read a block from its JSON content, or raise ``ValueError`` if it describes no block."""
    kinds = {block.kind: block for block in Block.__subclasses__()}
    given = dict(content) if isinstance(content, dict) else {}
    kind = given.pop("kind", None)
    if not isinstance(kind, str) or kind not in kinds:
        raise ValueError(f"a report has no blocks of kind {shown(kind)}")
    try:
        return read_as(kinds[kind], given)
    except ValueError as error:
        raise ValueError(f"a damaged block of a report: {error}") from None


def as_text(blocks: Iterable[Block]) -> str:
    """Render blocks for a terminal, without control characters."""
    texts = (printable(block.as_text(), keep="\n") for block in blocks)
    return "\n\n".join(text for text in texts if text)


def as_html(blocks: Iterable[Block], cited: Citation | None = None) -> str:
    """Render blocks as HTML, one below the other, each with its sources if these are ``cited``."""
    return "\n".join(block.cited_html(cited) if cited else block.as_html() for block in blocks)


def _lines(note: str) -> list[str]:
    return [f"  {note}"] if note else []


def _base64(content: bytes) -> str:
    return b64encode(content).decode("ascii")


def _data(suffix: str, content: bytes) -> str:
    return f"data:image/{suffix};base64,{_base64(content)}"


def _with_commands(text: str) -> str:
    """Render a text whose commands stand between backticks; options are not broken in two."""
    parts = text.split("`")
    return "".join(_command(part) if k % 2 else in_html(part) for k, part in enumerate(parts))


def _command(text: str) -> str:
    words = (f'<span class="word">{in_html(word)}</span>' for word in text.split(" "))
    return f"<code>{' '.join(words)}</code>"


def _entry(text: str) -> str:
    """Render an entry of a table; intervals in brackets are not broken over lines."""
    whole = re.sub(r"[\[(][^\])]{1,24}[\])]", r'<span class="whole">\g<0></span>', in_html(text))
    return whole.replace("\n", "<br>")
