"""Numbers that a report shows, against the places of its JSON file that it names as their sources.

Every number of a table's entries and of a card must be found, rounded as it is shown, at one of the
sources: as it is, in percent, thousands or millions. Verdicts must be at theirs as a whole.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import pytest

from hmi_marl.reporting.blocks import Block, Clip, Figure, Table, Verdicts
from hmi_marl.reporting.cards import Cards, Tally
from hmi_marl.reporting.pages import PagedReport
from hmi_marl.reporting.report import Report
from hmi_marl.reporting.sources import resolve

_NUMBER = re.compile(r"(?<![\w.])\d[\d,]*(?:\.\d+)?(?:e[+-]?\d+)?")
_FORMS = (".0f", ".1f", ".2f", ".3f", ".4f", ".3g", ".4g", "g")
_SCALES = (1.0, 100.0, 1e-3, 1e-6)


def numbers_in(text: str) -> set[str]:
    """Numbers of a text as they are written, without signs."""
    return {found.replace(",", "") for found in _NUMBER.findall(text)}


def _leaves(content: Any) -> Iterator[Any]:
    if isinstance(content, Mapping):
        yield from content  # names count as texts
        content = list(content.values())
    if isinstance(content, Sequence) and not isinstance(content, str):
        for each in content:
            yield from _leaves(each)
    else:
        yield content


def numbers_at(content: Any) -> set[str]:
    """All ways to write the numbers of JSON content."""
    found: set[str] = set()
    for leaf in _leaves(content):
        if isinstance(leaf, str):
            found |= numbers_in(leaf)
        elif isinstance(leaf, (int, float)) and not isinstance(leaf, bool):
            sizes = {abs(leaf) * scale for scale in _SCALES}
            sizes |= {abs(scale * leaf) for scale in _SCALES}  # which may round otherwise
            found |= {format(size, form) for size in sizes for form in _FORMS}
    return found


def missing(blocks: Iterable[Block], content: Any, within: str = "") -> list[str]:
    """What of the blocks has no source, or shows what is not there."""
    odd = []
    for block in blocks:
        if isinstance(block, Cards):
            for card in block.cards:
                places = [resolve(content, place) for place in card.sources]
                odd += _odd(card.title, f"{card.value} {card.sentence}", places)
            continue
        if not isinstance(block, (Table, Figure, Clip, Verdicts, Tally)):
            continue
        if not block.sources:
            odd.append(f"{block} has no source")
            continue
        places = [resolve(content, within + source) for source in block.sources]
        if isinstance(block, Table):
            text = "\n".join(entry for row in block.rows for entry in row)
            odd += _odd(block.title, text, places)
        elif isinstance(block, Verdicts):
            shown = [verdict.as_json() for verdict in block.verdicts]
            kept = [{n: each[n] for n in new} for new, each in zip(shown, *places, strict=True)]
            odd += [] if kept == shown else [f"{block.title} are others"]
    return odd


def _odd(title: str, text: str, places: Sequence[Any]) -> list[str]:
    unknown = numbers_in(text) - numbers_at(places)
    return [f"{title}: {number} is at none of its sources" for number in sorted(unknown)]


def missing_in(report: PagedReport | Report) -> list[str]:
    """The same of all that a report shows."""
    if isinstance(report, Report):
        return missing(report.blocks, report.content)
    odd = []
    for page in report.pages:
        content = {f"{report.name}.json": report.content, **report.more}[page.cited.file]
        odd += [f"{page.name}: {each}" for each in missing(page.blocks, content, page.cited.within)]
    return odd


@contextmanager
def reports_written() -> Iterator[list[Report]]:
    """Reports that are written within, each once."""
    found: list[Report] = []
    with pytest.MonkeyPatch.context() as patch:
        write = Report.write
        patch.setattr(Report, "write", lambda own, folder: found.append(own) or write(own, folder))
        yield found
