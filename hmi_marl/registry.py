"""Registries of HMIs, driver policies, protocols and experiments by name.

An entry holds a name, a line of help and a value. ``--help``, error messages, the documentation and
every place that offers a choice read the same registry, so that a new HMI or experiment is one new
module and one entry.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Generic, TypeVar

from hmi_marl.names import unknown

T = TypeVar("T")


@dataclass(frozen=True)
class Entry(Generic[T]):
    """One named value."""

    name: str
    help: str
    """Description in one line."""
    value: T
    """The named thing: a factory, a class, or a place to import it from."""
    aliases: tuple[str, ...] = ()
    """Other names of the same value."""


class Registry(Mapping[str, Entry[T]]):
    """Entries by name, in the order in which they were registered. Case does not matter.

    Args:
        kind: of the entries, for error messages: "HMI", "protocol", ...
        see: the command that lists them.
    """

    def __init__(self, kind: str, see: str = "hmi-marl --help") -> None:
        self.kind, self.see = kind, see
        self._entries: dict[str, Entry[T]] = {}
        self._by_alias: dict[str, str] = {}

    def register(self, name: str, help: str, value: T, aliases: tuple[str, ...] = ()) -> Entry[T]:  # noqa: A002
        """Add an entry and return it.

        Raises:
            ValueError: the name or an alias is taken, or contains a colon or a slash.
        """
        for each in (name, *aliases):
            if not each or ":" in each or "/" in each:
                raise ValueError(f"a {self.kind} needs a name without ':' and '/', not {each!r}")
            if each.lower() in self._by_alias:
                raise ValueError(f"there is already a {self.kind} called {each!r}")
        entry = Entry(name, help, value, aliases)
        self._entries[name] = entry
        self._by_alias |= {each.lower(): name for each in (name, *aliases)}
        return entry

    def find(self, name: str) -> Entry[T]:
        """Return the entry of a name or alias.

        Raises:
            ValueError: there is none; the message suggests the nearest name.
        """
        if name not in self:
            raise ValueError(unknown(self.kind, name, self._by_alias, self.see))
        return self[name]

    def helps(self) -> dict[str, str]:
        """Return the names and their lines of help."""
        return {name: entry.help for name, entry in self._entries.items()}

    def __getitem__(self, name: str) -> Entry[T]:
        return self._entries[self._by_alias[name.lower()]]

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and name.lower() in self._by_alias

    def __iter__(self) -> Iterator[str]:
        return iter(self._entries)

    def __len__(self) -> int:
        return len(self._entries)
