"""Code and commands on a page, for the tests of README and site."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
README = ROOT / "README.md"
DOCS = ROOT / "docs"
PAGES = sorted(DOCS.rglob("*.md"))


def blocks(text: str, language: str) -> list[str]:
    """The fenced blocks of a language, in order."""
    return re.findall(rf"^```{language}\n(.*?)^```", text, re.DOTALL | re.MULTILINE)


def commands(text: str) -> list[list[str]]:
    """The arguments of every line that calls hmi-marl, except in what commands print."""
    whole = re.sub(r"^```text\n.*?^```", "", text, flags=re.DOTALL | re.MULTILINE)
    whole = whole.replace("\\\n", " ")
    lines = re.findall(r"^hmi-marl (.*)", whole, re.MULTILINE)
    return [line.split("#")[0].split() for line in lines]
