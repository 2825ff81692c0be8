"""Texts of all pages, in one file for each language: ``texts/en.json``.

Its sections are "shared" and one for each service. Placeholders are those of ``str.format`` with
names, such as ``{trips}``. To translate the pages, copy the file and change the texts.
"""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

from hmi_marl.reading import read_json

FOLDER = Path(__file__).with_name("texts")
LANGUAGE = "en"
SHARED = "shared"


class Texts:
    """Texts of a service by their keys, with those that are shared.

    Args:
        section: of the service, such as "play".
        language: name of the file.

    Raises:
        ValueError: there is no such language or section.
    """

    def __init__(self, section: str, language: str = LANGUAGE) -> None:
        sections = _sections(language)
        if section not in sections:
            raise ValueError(f"{language}.json has no section {section!r}")
        self.language = language
        self._texts = MappingProxyType({**sections[SHARED], **sections[section]})

    def __call__(self, key: str, **values: object) -> str:
        """Return a text with its placeholders filled in.

        Raises:
            KeyError: no such text, or a placeholder without a value.
        """
        return self._texts[key].format_map(values) if values else self._texts[key]

    def __contains__(self, key: str) -> bool:
        return key in self._texts

    def all(self, prefix: str = "") -> dict[str, str]:
        """Return the texts whose keys begin so, for scripts of pages."""
        return {key: text for key, text in self._texts.items() if key.startswith(prefix)}


def languages() -> list[str]:
    """Return the languages that there are files of."""
    return sorted(path.stem for path in FOLDER.glob("*.json"))


def placeholders(text: str) -> set[str]:
    """Return the names that a text needs values of."""
    return set(re.findall(r"{(\w+)}", text))


@cache
def _sections(language: str) -> dict[str, dict[str, str]]:
    if language not in languages():
        raise ValueError(f"texts are in {', '.join(languages())}, not in {language!r}")
    found: Any = read_json(FOLDER / f"{language}.json")
    return {str(name): dict(texts) for name, texts in found.items()}
