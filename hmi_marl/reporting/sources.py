"""Sources of what a report shows: the command that prints it, and its place in the JSON file.

Places are JSON pointers (RFC 6901), such as ``/tables/printed/0/crash_rate``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any
from urllib.parse import quote

from hmi_marl.checks import shown
from hmi_marl.text import in_html


def pointer(*keys: str | int) -> str:
    """Write the JSON pointer of what is found by these keys, one after the other."""
    return "".join("/" + str(key).replace("~", "~0").replace("/", "~1") for key in keys)


def resolve(content: Any, place: str) -> Any:
    """Return what a JSON pointer names.

    Raises:
        ValueError: it names nothing, or is no pointer.
    """
    first, *keys = place.split("/")
    if first:
        raise ValueError(f"a JSON pointer begins with /, but got {shown(place)}")
    found = content
    for key in (key.replace("~1", "/").replace("~0", "~") for key in keys):
        if isinstance(found, Mapping) and key in found:
            found = found[key]
        elif isinstance(found, Sequence) and not isinstance(found, str) and key.isdecimal():
            if int(key) >= len(found):
                raise ValueError(f"{place} names nothing: there are {len(found)} items, not {key}")
            found = found[int(key)]
        else:
            raise ValueError(f"{place} names nothing: there is no {shown(key)}")
    return found


@dataclass(frozen=True)
class Citation:
    """What the sources of a page's blocks refer to."""

    command: str
    """Command that prints what the blocks show."""
    file: str
    """Name of the JSON file in the page's folder."""
    within: str = ""
    """JSON pointer of the content that the blocks' own pointers start from."""
    about: str = ""
    """Address of more about the command; empty for none."""

    def as_html(self, sources: Sequence[str]) -> str:
        """Render the line below a block, with a link to each place; nothing without sources.

        The file is named once.
        """
        if not sources:
            return ""
        command = f"<code>{in_html(self.command)}</code>"
        if self.about:
            command = f'<a href="{in_html(self.about)}">{command}</a>'
        links = [self._link(source, self.file) for source in sources[:1]]
        links += [self._link(source) for source in sources[1:]]
        return f'<p class="source">{command} → {", ".join(links)}</p>'

    def _link(self, source: str, name: str = "") -> str:
        place = self.within + source
        address = f"{self.file}#{quote(place, safe='/~')}"
        return f'<a href="{in_html(address)}"><code>{in_html(f"{name}#{place}")}</code></a>'
