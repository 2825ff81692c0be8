"""Web pages that need nothing besides themselves, and the same tables as text."""

from __future__ import annotations

import base64
import re
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

import hmi_marl

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
 tr > :first-child { position: sticky; left: 0; background: var(--paper); }
 .whole { white-space: nowrap; } .word { display: inline-block; max-width: 100%; }
 img { max-width: 100%; height: auto; background: #fff; border-radius: 4px; }
 .clip { width: 100%; max-width: 880px; }
 dt { font-weight: 600; margin-top: .75rem; } dd { margin: 0; }
 h2 { font-size: 1.25rem; margin-top: 2.5rem; } h3 { font-size: 1.05rem; margin-top: 1.75rem; }
 a { color: inherit; } code, .small { font-size: .85rem; color: var(--quiet); }
 .good { color: var(--good); } .bad { color: var(--bad); } .half { color: var(--half); }
 .good, .bad, .half { font-weight: 600; }
 @media (max-width: 40rem) { body { margin: 1rem auto; } th, td { padding: .3rem .35rem;
   font-size: .8rem; } .clip { aspect-ratio: 470 / 228; object-fit: cover; object-position: 0 0; } }
"""


def page(title: str, body: str, command: str, settings: Mapping[str, Any]) -> str:
    """A whole page.

    Args:
        title: its heading.
        body: HTML.
        command: that makes the page again.
        settings: all of them, for the small print.
    """
    told = ", ".join(f"{name} = {value}" for name, value in settings.items())
    return f"""<!doctype html>
<html lang="en"><meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>hmi-marl: {escape(title)}</title>
<style>{_STYLE}</style>
<h1>{escape(title)}</h1>
{body}
<p class="small">Made by hmi-marl {hmi_marl.__version__}: <code>{escape(command)}</code><br>
{escape(told)}</p>
</html>
"""


def html_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table whose rows begin with their own heading; line breaks in an entry are kept."""
    top = "".join(f"<th>{_entry(name)}</th>" for name in head)
    body = "".join(
        f"<tr><th>{_entry(row[0])}</th>"
        + "".join(f"<td>{_entry(entry)}</td>" for entry in row[1:])
        + "</tr>"
        for row in rows
    )
    return f'<div class="wide"><table><tr>{top}</tr>{body}</table></div>'


def text_table(head: Sequence[str], rows: Sequence[Sequence[str]], indent: str = "  ") -> str:
    """The same for a terminal, in columns."""
    lines = [list(head), *(list(row) for row in rows)]
    widths = [max(len(line[column]) for line in lines) for column in range(len(head))]
    return "\n".join(
        indent
        + "  ".join(entry.ljust(width) for entry, width in zip(line, widths, strict=True)).rstrip()
        for line in lines
    )


def image(
    kind: str, content: bytes, description: str, narrow: bytes | None = None, style: str = ""
) -> str:
    """An image, within the page.

    Args:
        kind: png or gif.
        content: of the file.
        description: for whoever does not see it.
        narrow: what a narrow screen shows instead, of the same kind.
        style: a class of the page's style.
    """
    named = f' class="{style}"' if style else ""
    shown = f'<img{named} alt="{escape(description)}" src="{_data(kind, content)}">'
    if narrow is None:
        return shown
    source = f'<source media="(max-width: 40rem)" srcset="{_data(kind, narrow)}">'
    return f"<picture>{source}{shown}</picture>"


def with_commands(text: str) -> str:
    """A text as HTML in which commands stand between backticks; options are not broken in two."""
    parts = text.split("`")
    return "".join(_command(part) if k % 2 else escape(part) for k, part in enumerate(parts))


def _command(text: str) -> str:
    words = (f'<span class="word">{escape(word)}</span>' for word in text.split(" "))
    return f"<code>{' '.join(words)}</code>"


def _data(kind: str, content: bytes) -> str:
    return f"data:image/{kind};base64,{base64.b64encode(content).decode('ascii')}"


def _entry(text: str) -> str:
    """An entry of a table, whose intervals in brackets are not broken over lines."""
    whole = re.sub(r"[\[(][^\])]{1,24}[\])]", r'<span class="whole">\g<0></span>', escape(text))
    return whole.replace("\n", "<br>")
