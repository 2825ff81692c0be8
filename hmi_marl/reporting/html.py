"""HTML around the blocks of a page: style, navigation, contents.

A page holds all that it needs and no scripts, so that it works from a folder, and below any
address. It follows the reader's dark mode, and fits a phone.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from hmi_marl.reporting.blocks import Block, Heading
from hmi_marl.reporting.drawing import DARK_PAPER, PAPER
from hmi_marl.text import in_html

_STYLE = (
    f"""
 :root {{ color-scheme: light dark; --ink: #222; --paper: {PAPER}; --line: #ddd; --quiet: #555;
         --good: #1d7a3c; --bad: #b3261e; --half: #8a6100; }}
 @media (prefers-color-scheme: dark) {{
   :root {{ --ink: #ddd; --paper: {DARK_PAPER}; --line: #3a3d44; --quiet: #a5a9b1;
           --good: #6cc58a; --bad: #ff8a80; --half: #e0b050; }} }}
"""
    + """
 body { font: 16px/1.5 system-ui, sans-serif; max-width: 62rem; margin: .75rem auto;
        padding: 0 1rem; color: var(--ink); background: var(--paper); overflow-wrap: break-word; }
 nav { display: flex; flex-wrap: wrap; gap: .2rem .85rem; padding-bottom: .5rem; font-size: .85rem;
       border-bottom: 1px solid var(--line); }
 nav a { color: var(--quiet); text-decoration: none; }
 nav a:hover { text-decoration: underline; }
 nav [aria-current] { color: var(--ink); font-weight: 600; }
 h1 { font-size: 1.6rem; line-height: 1.25; margin: .9rem 0 .6rem; }
 h2 { font-size: 1.25rem; margin-top: 2.5rem; } h3 { font-size: 1.05rem; margin-top: 1.75rem; }
 .wide, .drawn { overflow-x: auto; }
 table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums;
         overflow-wrap: normal; }
 th, td { padding: .35rem .6rem; border-bottom: 1px solid var(--line); text-align: left;
          vertical-align: top; }
 tr > :first-child { position: sticky; left: 0; background: var(--paper);
                    min-width: min(9rem, 25vw); overflow-wrap: anywhere; }
 .whole { white-space: nowrap; } .word { display: inline-block; max-width: 100%; }
 img { max-width: 100%; height: auto; border-radius: 4px; }
 .clip { width: 100%; max-width: 880px; }
 a { color: inherit; } code, .small, .source { font-size: .85rem; color: var(--quiet); }
 .source { margin: .35rem 0 1.25rem; font-size: .75rem; overflow-wrap: anywhere; }
 .source code { font-size: inherit; }
 .good { color: var(--good); } .bad { color: var(--bad); } .half { color: var(--half); }
 .good, .bad, .half { font-weight: 600; }
 .tally { display: flex; flex-wrap: wrap; gap: .25rem 2rem; align-items: baseline; }
 .tally b { font-size: 1.4rem; } .tally + .source { margin: .1rem 0 .8rem; }
 .cards { display: grid; grid-template-columns: repeat(3, 1fr); gap: 1rem; }
 .card { border: 1px solid var(--line); border-radius: 6px; padding: .75rem .75rem 0;
         min-width: 0; }
 .card h2 { font-size: 1rem; margin: 0 0 .4rem; line-height: 1.3; } .card p { margin: .25rem 0; }
 .card .value { font-size: 1.3rem; font-weight: 600; font-variant-numeric: tabular-nums; }
 .card p { font-size: .9rem; line-height: 1.4; }
 .card .source { font-size: .7rem; margin-bottom: .75rem; }
 .card img { display: block; width: 100%; }
 @media (max-width: 60rem) { .cards { grid-template-columns: 1fr; } .card { max-width: 32rem; } }
 @media (max-width: 40rem) {
   body { margin: 1rem auto; } th, td { padding: .3rem .35rem; font-size: .8rem; }
   tr > :first-child { max-width: 45vw; }
   .drawn:not(.narrow) img { max-width: none; max-height: 22rem; }
   .clip { aspect-ratio: 470 / 228; object-fit: cover; object-position: 0 0; }
   .stack, .stack tbody, .stack tr, .stack td { display: block; }
   .stack tr { display: flex; flex-direction: column; padding: .5rem 0;
     border-bottom: 1px solid var(--line); }
   .stack tr:first-child { display: none; } .stack td { border: 0;
     font-size: .9rem; overflow-wrap: anywhere; }
   .stack td:last-child { order: 1; } .stack td:nth-child(2) { order: 2; }
   .stack tr > :first-child { position: static; max-width: none; font-weight: 600; } }
"""
)


def html_page(title: str, body: str, navigation: str = "", foot: str = "") -> str:
    """Make a page of these parts, which are HTML but for the title."""
    return f"""<!doctype html>
<html lang="en"><meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>hmi-marl: {in_html(title)}</title>
<style>{_STYLE}</style>
{navigation}<h1>{in_html(title)}</h1>
{body}
{foot}
</html>
"""


def navigation(pages: Mapping[str, str], current: str) -> str:
    """Make the links to all pages of a report, by address; the ``current`` one is marked."""
    links = "\n".join(
        f'<a href="{in_html(address)}"{" aria-current=page" if address == current else ""}>'
        f"{in_html(name)}</a>"
        for address, name in pages.items()
    )
    return f"<nav>{links}</nav>\n"


def contents(blocks: Iterable[Block]) -> str:
    """Make links to the headings that have an anchor; nothing without any."""
    links = "".join(
        f'<li><a href="#{in_html(block.anchor)}">{in_html(block.text)}</a></li>'
        for block in blocks
        if isinstance(block, Heading) and block.anchor
    )
    return f"<ul>{links}</ul>\n" if links else ""


def listed_settings(settings: Mapping[str, Any]) -> str:
    """Write settings in a line; see :func:`flat`."""
    return ", ".join(f"{name} = {value}" for name, value in flat(settings))


def flat(settings: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield settings and their values, those of a group as GROUP.NAME."""
    for name, value in settings.items():
        if isinstance(value, Mapping):
            yield from flat(value, f"{prefix}{name}.")
        else:
            yield prefix + name, value
