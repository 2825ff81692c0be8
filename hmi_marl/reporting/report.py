"""Reports: blocks and numbers in files, as text, JSON, figures and one page."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import hmi_marl
from hmi_marl.files import json_value, write_bytes, write_json, write_text
from hmi_marl.reporting.blocks import Block, Clip, Figure, Heading, Table, as_html, as_text
from hmi_marl.text import in_html

PAGE = "index.html"

_STYLE = """
 :root { color-scheme: light dark; --ink: #222; --paper: #fff; --line: #ddd; --quiet: #555;
         --good: #1d7a3c; --bad: #b3261e; --half: #8a6100; }
 @media (prefers-color-scheme: dark) {
   :root { --ink: #ddd; --paper: #16181c; --line: #3a3d44; --quiet: #a5a9b1;
           --good: #6cc58a; --bad: #ff8a80; --half: #e0b050; } }
 body { font: 16px/1.5 system-ui, sans-serif; max-width: 62rem; margin: 2rem auto;
        padding: 0 1rem; color: var(--ink); background: var(--paper); overflow-wrap: break-word; }
 .wide { overflow-x: auto; }
 table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums;
         overflow-wrap: normal; }
 th, td { padding: .35rem .6rem; border-bottom: 1px solid var(--line); text-align: left;
          vertical-align: top; }
 tr > :first-child { position: sticky; left: 0; background: var(--paper);
                    min-width: min(9rem, 25vw); overflow-wrap: anywhere; }
 .whole { white-space: nowrap; } .word { display: inline-block; max-width: 100%; }
 img { max-width: 100%; height: auto; background: #fff; border-radius: 4px; }
 .clip { width: 100%; max-width: 880px; }
 dt { font-weight: 600; margin-top: .75rem; } dd { margin: 0; }
 h2 { font-size: 1.25rem; margin-top: 2.5rem; } h3 { font-size: 1.05rem; margin-top: 1.75rem; }
 a { color: inherit; } code, .small { font-size: .85rem; color: var(--quiet); }
 .good { color: var(--good); } .bad { color: var(--bad); } .half { color: var(--half); }
 .good, .bad, .half { font-weight: 600; }
 @media (prefers-color-scheme: dark) { /* white figures turn dark, their hues stay */
   img:not(.clip) { filter: invert(.91) hue-rotate(180deg); } }
 @media (max-width: 40rem) { body { margin: 1rem auto; } th, td { padding: .3rem .35rem;
   font-size: .8rem; } tr > :first-child { max-width: 45vw; }
   .clip { aspect-ratio: 470 / 228; object-fit: cover; object-position: 0 0; } }
"""


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
    def page(self) -> str:
        """HTML page that needs no other file."""
        body = as_html([*self.blocks, *self._times()])
        listed = ", ".join(f"{name} = {value}" for name, value in _flat(self.settings))
        command = f"<code>{in_html(self.command_line)}</code>"
        return f"""<!doctype html>
<html lang="en"><meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>hmi-marl: {in_html(self.title)}</title>
<style>{_STYLE}</style>
<h1>{in_html(self.title)}</h1>
{self._contents()}{body}
<p class="small">Made by hmi-marl {hmi_marl.__version__}: {command}<br>
{in_html(listed)}</p>
</html>
"""

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
        about = {
            "hmi_marl_version": hmi_marl.__version__,
            "command": self.command_line,
            "settings": json_value(self.settings),
        }
        times = {"seconds": dict(self.seconds)} if self.seconds else {}
        write_json(folder / f"{self.name}.json", {**about, **self.numbers, **times})

    def _times(self) -> list[Block]:
        rows = [[part, f"{spent:.0f} s"] for part, spent in self.seconds.items()]
        return [Table("Time of each part", ["part", "time"], rows)] if rows else []

    def _contents(self) -> str:
        links = "".join(
            f'<li><a href="#{in_html(block.anchor)}">{in_html(block.text)}</a></li>'
            for block in self.blocks
            if isinstance(block, Heading) and block.anchor
        )
        return f"<ul>{links}</ul>\n" if links else ""


def print_page(page: Path) -> None:
    """Print where a page can be opened."""
    print(f"\nthe page: {page.resolve().as_uri()}")


def _flat(settings: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Settings by name, those of a group as GROUP.NAME."""
    for name, value in settings.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{name}.")
        else:
            yield prefix + name, value


class Stopwatch:
    """Durations of parts of some work, by name [s]."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def timing(self, part: str) -> Iterator[None]:
        """Time the work done within; times of one part add up."""
        began = time.monotonic()
        yield
        self.seconds[part] = self.seconds.get(part, 0.0) + time.monotonic() - began
