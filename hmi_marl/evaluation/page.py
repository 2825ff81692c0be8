"""Web pages that need nothing besides themselves, and the same tables as text."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

import hmi_marl

_STYLE = """
 body { font: 16px/1.5 system-ui, sans-serif; max-width: 62rem; margin: 2rem auto;
        padding: 0 1rem; color: #222; }
 table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; }
 th, td { padding: .35rem .6rem; border-bottom: 1px solid #ddd; text-align: left;
          vertical-align: top; }
 img { max-width: 100%; } h2 { font-size: 1.1rem; margin-top: 2rem; }
 code, .small { font-size: .85rem; color: #555; }
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
<html lang="en"><meta charset="utf-8"><title>hmi-marl: {escape(title)}</title>
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
    return f"<table><tr>{top}</tr>{body}</table>"


def text_table(head: Sequence[str], rows: Sequence[Sequence[str]], indent: str = "  ") -> str:
    """The same for a terminal, in columns."""
    lines = [list(head), *(list(row) for row in rows)]
    widths = [max(len(line[column]) for line in lines) for column in range(len(head))]
    return "\n".join(
        indent
        + "  ".join(entry.ljust(width) for entry, width in zip(line, widths, strict=True)).rstrip()
        for line in lines
    )


def image(kind: str, content: bytes, description: str) -> str:
    """An image, within the page."""
    data = base64.b64encode(content).decode("ascii")
    return f'<img alt="{escape(description)}" src="data:image/{kind};base64,{data}">'


def _entry(text: str) -> str:
    return escape(text).replace("\n", "<br>")
