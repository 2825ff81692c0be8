"""Reports of one page: blocks and numbers in files, as text, JSON, figures and HTML."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import hmi_marl
from hmi_marl.checks import shown
from hmi_marl.file_index import INDEX, check_digests, digests, read_index, write_index
from hmi_marl.files import json_value, write_bytes, write_json, write_text
from hmi_marl.reporting.blocks import Block, Clip, Figure, Table, as_html, as_text
from hmi_marl.reporting.html import contents, html_page, listed_settings
from hmi_marl.reporting.sources import Citation
from hmi_marl.text import in_html
from hmi_marl.typed_json import read_value

PAGE = "index.html"
INDEX_FORMAT = "hmi-marl report 1"
"""Format of an index of a report's files."""


@dataclass(frozen=True)
class Report:
    """Results of an experiment, ready to be written and printed."""

    name: str
    """Name of its files: NAME.txt and NAME.json."""
    title: str
    """Heading of the page."""
    blocks: Sequence[Block]
    numbers: Mapping[str, Any]
    """JSON content."""
    command_line: str
    """Command that makes it again."""
    settings: Mapping[str, Any]
    """All settings, for the JSON and the page's small print."""
    seconds: Mapping[str, float] = field(default_factory=dict)
    """Durations of its parts [s]; left out if empty."""

    @property
    def text(self) -> str:
        """Text for a terminal."""
        return as_text([*self.blocks, *self._times()])

    @property
    def content(self) -> dict[str, Any]:
        """Content of the JSON file."""
        about = {
            "hmi_marl_version": hmi_marl.__version__,
            "command": self.command_line,
            "settings": json_value(self.settings),
        }
        times = {"seconds": dict(self.seconds)} if self.seconds else {}
        return {**about, **self.numbers, **times}

    @property
    def page(self) -> str:
        """HTML page that needs no other file; its links to numbers lead to NAME.json next to it."""
        cited = Citation(self.command_line, f"{self.name}.json")
        command = f"<code>{in_html(self.command_line)}</code>"
        made = f"Made by hmi-marl {hmi_marl.__version__}: {command}<br>\n"
        return html_page(
            self.title,
            contents(self.blocks) + as_html([*self.blocks, *self._times()], cited),
            foot=f'<p class="small">{made}{in_html(listed_settings(self.settings))}</p>',
        )

    def write(self, folder: Path) -> Path:
        """Write the results, then figures, clips and the page; return the path of the page."""
        self.write_results(folder)
        for block in self.blocks:
            if isinstance(block, (Figure, Clip)):
                content = block.drawn
                write_bytes(folder / f"{block.name}.{block.suffix}", content)
        write_text(folder / PAGE, self.page)
        return folder / PAGE

    def write_results(self, folder: Path) -> None:
        """Write NAME.txt and NAME.json, for which nothing is drawn."""
        write_text(folder / f"{self.name}.txt", self.text + "\n")
        write_json(folder / f"{self.name}.json", self.content)

    def write_index(self, folder: Path) -> None:
        """Write the index of the files that :meth:`write` has written, which completes them."""
        drawn = [block for block in self.blocks if isinstance(block, (Figure, Clip))]
        names = [f"{self.name}.txt", f"{self.name}.json"]
        names += [*(f"{block.name}.{block.suffix}" for block in drawn), PAGE]
        index_report(folder, self.name, names)

    def _times(self) -> list[Block]:
        rows = [[part, f"{spent:.0f} s"] for part, spent in self.seconds.items()]
        return (
            [Table("Time of each part", ["part", "time"], rows, sources=["/seconds"])]
            if rows
            else []
        )


def index_report(folder: Path, name: str, files: Iterable[str]) -> None:
    """Write the index of a report's files, which lie in ``folder``."""
    checksums = digests((folder / file for file in files), folder)
    about = {"version": hmi_marl.__version__, "report": name, "files": checksums}
    write_index(folder, INDEX_FORMAT, about)


def indexed_files(folder: Path, name: str, remedy: str) -> dict[str, str]:
    """Return the checksums of a report's files by their names, as its index has them.

    Args:
        folder, name: where it is, and the name of the report that it has to be.
        remedy: end of the messages, which says what to do.

    Raises:
        FileNotFoundError: there is no index.
        ValueError: it is that of another report, or damaged.
    """
    try:
        content = read_index(folder, INDEX_FORMAT, "a report", remedy)
    except FileNotFoundError:
        raise FileNotFoundError(f"{folder} has no {INDEX} of a whole report; {remedy}") from None
    if content.get("report") != name:
        found = shown(content.get("report"))
        raise ValueError(f"{folder} holds the report {found}, not {name}; {remedy}")
    try:
        files: dict[str, str] = read_value(dict[str, str], content.get("files"), "files")
        check_digests(files)
    except ValueError as error:
        raise ValueError(f"{folder / INDEX} is damaged ({error}); {remedy}") from None
    return files


def print_page(page: Path) -> None:
    """Print where a page can be opened."""
    print(f"\nthe page: {page.resolve().as_uri()}")


class Stopwatch:
    """Durations of parts of some work, by name [s]."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def timing(self, part: str) -> Iterator[None]:
        """Time the work done within; times of one part add up."""
        began = time.monotonic()
        yield
        self.add({part: time.monotonic() - began})

    def add(self, seconds: Mapping[str, float]) -> None:
        """Add durations that were measured elsewhere."""
        for part, spent in seconds.items():
            self.seconds[part] = self.seconds.get(part, 0.0) + spent
