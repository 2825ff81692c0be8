"""Numbers with intervals on the page of results are those of the JSON files that it names."""

import json
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest

DOCS = Path(__file__).parents[1] / "docs"
RUN = (
    "report/reproduce.json",
    "unsupervised/full.json",
    "ablations/ablations.json",
    "map/map.json",
)
"""What the page's sections are written from, but for the comparison."""
COMPARISON = "## Sequential or joint training"
PRINTED = ("### Traits under shifts", "## Speed")
"""Sections with numbers that the commands named there print, and no file here has."""
ELSEWHERE = ("| | control | 0.79 [", "paper inform cohesion imitate", "99.4 % [97.6")
"""Beginnings and parts of other lines with such numbers: z with the control, and other ways without
labels. The paragraph counts as a line."""
NUMBER = r"[+-]?\d+(?:\.\d+)?"
INTERVAL = re.compile(rf"(?<![\d.])({NUMBER})(?: %)? \[({NUMBER}), ({NUMBER})\]")

Triple = tuple[float, float, float]


def estimates(content: Any) -> Iterator[Triple]:
    """Mean and ends of every interval in JSON content."""
    if isinstance(content, dict):
        ends = [content.get(name) for name in ("mean", "low", "high")]
        if all(isinstance(value, (int, float)) for value in ends):
            yield tuple(ends)
        content = list(content.values())
    if isinstance(content, list):
        for item in content:
            yield from estimates(item)


@cache
def shown(files: tuple[str, ...]) -> set[tuple[int, Triple]]:
    """All intervals of these files as a page may show them, by the number of decimals.

    Shares may be shown in percent, and differences turned around.
    """
    every = set()
    for file in files:
        for mean, low, high in estimates(json.loads((DOCS / file).read_text("utf-8"))):
            for unit in (1.0, 100.0):
                for ends in ((mean, low, high), (-mean, -high, -low)):
                    for decimals in range(5):
                        rounded = (float(f"{unit * value:.{decimals}f}") for value in ends)
                        every.add((decimals, tuple(rounded)))
    return every


def sections(page: str) -> dict[str, list[str]]:
    """Lines of tables and whole paragraphs of each section, by its heading."""
    found: dict[str, list[str]] = {}
    for part in re.split(r"^(?=#)", page, flags=re.MULTILINE):
        heading, _, text = part.partition("\n")
        paragraphs = [" ".join(each.split("\n")) for each in text.split("\n\n") if each[:1] != "|"]
        rows = [line for line in text.split("\n") if line.startswith("|")]
        found[heading] = [*paragraphs, *rows]
    return found


def unknown(lines: list[str], files: tuple[str, ...]) -> list[str]:
    """Intervals in these lines that no file has."""
    wrong = []
    for line in lines:
        for match in INTERVAL.finditer(line):
            decimals = max(len(number.partition(".")[2]) for number in match.groups())
            if (decimals, tuple(map(float, match.groups()))) not in shown(files):
                wrong.append(match.group())
    return wrong


def test_every_interval_of_the_page_of_results_is_in_a_file() -> None:
    page = sections((DOCS / "results.md").read_text("utf-8"))
    assert {COMPARISON, *PRINTED} <= page.keys()
    wrong, count = {}, 0
    for heading, lines in page.items():
        if heading in (COMPARISON, *PRINTED):
            continue
        own = [line for line in lines if not any(part in line for part in ELSEWHERE)]
        count += sum(len(INTERVAL.findall(line)) for line in own)
        if missing := unknown(own, RUN):
            wrong[heading] = missing
    assert wrong == {}
    assert count > 200


def test_every_interval_of_the_comparison_is_in_its_file() -> None:
    if not (DOCS / "compare" / "INDEX.json").exists():
        pytest.skip("it was shipped by hand, from several runs of which one has no JSON")
    lines = sections((DOCS / "results.md").read_text("utf-8"))[COMPARISON]
    assert unknown(lines, ("compare/compare.json",)) == []


def test_another_number_is_found() -> None:
    (mean, low, high), *_ = estimates(json.loads((DOCS / RUN[0]).read_text("utf-8")))
    right = f"| a | {mean:.3f} [{low:.3f}, {high:.3f}] |"
    wrong = f"| a | {mean:.3f} [{low:.3f}, {high + 0.002:.3f}] |"
    assert unknown([right], RUN) == []
    assert len(unknown([wrong], RUN)) == 1
