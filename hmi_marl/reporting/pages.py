"""Reports of several pages in one folder, with shared navigation and one JSON file of numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import hmi_marl
from hmi_marl.files import json_value, write_json, write_text
from hmi_marl.reporting.blocks import Block, as_html, as_text
from hmi_marl.reporting.html import contents, html_page, navigation
from hmi_marl.reporting.report import PAGE
from hmi_marl.reporting.sources import Citation
from hmi_marl.text import in_html


@dataclass(frozen=True)
class Page:
    """One page of a report."""

    name: str
    """Name of its file, without the suffix."""
    short: str
    """Name in the navigation."""
    title: str
    blocks: Sequence[Block]
    cited: Citation
    """What the sources of its blocks refer to."""
    repeatable: bool = True
    """Whether the same settings make the same page; durations do not, and are not in the text."""

    @property
    def address(self) -> str:
        """Name of its file."""
        return f"{self.name}.html"


@dataclass(frozen=True)
class PagedReport:
    """Pages and numbers, ready to be written; the first page is ``index.html``.

    Raises:
        ValueError: two pages would have the same file, or the first is another.
    """

    name: str
    """Name of its files: NAME.txt and NAME.json."""
    pages: Sequence[Page]
    numbers: Mapping[str, Any]
    """JSON content."""
    command_line: str
    """Command that makes it again."""
    settings: Mapping[str, Any]
    """All settings, for the JSON."""
    more: Mapping[str, Any] = field(default_factory=dict)
    """Content of further JSON files, by their names."""

    def __post_init__(self) -> None:
        names = [page.address for page in self.pages]
        if names[:1] != [PAGE]:
            raise ValueError(f"a report's first page is {PAGE}")
        if twice := sorted({name for name in names if names.count(name) > 1}):
            raise ValueError(f"a report has two pages in {twice[0]}; name them otherwise")

    @property
    def text(self) -> str:
        """Text for a terminal, page after page."""
        parts = []
        for page in (page for page in self.pages if page.repeatable):
            title = f"{page.title}\n{'#' * len(page.title)}"
            parts += [title, as_text(page.blocks)]
        return "\n\n".join(part for part in parts if part)

    @property
    def content(self) -> dict[str, Any]:
        """Content of the JSON file."""
        about = {"hmi_marl_version": hmi_marl.__version__, "command": self.command_line}
        return {**about, "settings": json_value(self.settings), **json_value(self.numbers)}

    def html(self, page: Page) -> str:
        """HTML of one of the pages."""
        made = f"Made by hmi-marl {hmi_marl.__version__}: <code>{in_html(self.command_line)}</code>"
        listed = {each.address: each.short for each in self.pages}
        return html_page(
            page.title,
            contents(page.blocks) + as_html(page.blocks, page.cited),
            navigation(listed, page.address),
            f'<p class="small">{made}</p>',
        )

    def write(self, folder: Path) -> Path:
        """Write text and numbers, then the pages, the first one last; return its path."""
        write_text(folder / f"{self.name}.txt", self.text + "\n")
        for name, content in {f"{self.name}.json": self.content, **self.more}.items():
            write_json(folder / name, content)
        for page in reversed(self.pages):
            write_text(folder / page.address, self.html(page))
        return folder / PAGE
