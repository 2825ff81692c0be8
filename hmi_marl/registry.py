"""Known names: registries of HMIs, driver policies, protocols and experiments, and errors.

An entry holds a name, a line of help and a value. ``--help``, error messages, the documentation and
every place that offers a choice read the same registry, so that a new HMI or experiment is one new
module and one entry. An error for an unknown name gives the nearest known ones and says where the
list is.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Generic, TypeVar

T = TypeVar("T")

HELP = "hmi-marl --help"
"""Lists drivers, HMIs, driver policies and subcommands."""
_LISTED = 80
"""Longest list of known names in a message, in characters."""


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
    argument: str = ""
    """Form of an argument after the name for help, such as ``[:RATE]``; empty for none."""


class Registry(Mapping[str, Entry[T]]):
    """Entries by name, in the order in which they were registered. Case does not matter.

    Args:
        kind: of the entries, for error messages: "HMI", "protocol", ...
        see: the command that lists them.
    """

    def __init__(self, kind: str, see: str = HELP) -> None:
        self.kind, self.see = kind, see
        self._entries: dict[str, Entry[T]] = {}
        self._by_alias: dict[str, str] = {}

    def register(
        self,
        name: str,
        help: str,  # noqa: A002
        value: T,
        aliases: tuple[str, ...] = (),
        argument: str = "",
    ) -> Entry[T]:
        """Add an entry and return it; see :class:`Entry` for the arguments.

        Raises:
            ValueError: the name or an alias is taken, or contains a colon or a slash.
        """
        for each in (name, *aliases):
            if not each or ":" in each or "/" in each:
                raise ValueError(f"a {self.kind} needs a name without ':' and '/', not {each!r}")
            if each.lower() in self._by_alias:
                raise ValueError(f"there is already a {self.kind} called {each!r}")
        entry = Entry(name, help, value, aliases, argument)
        self._entries[name] = entry
        self._by_alias |= {each.lower(): name for each in (name, *aliases)}
        return entry

    def find(self, name: str) -> Entry[T]:
        """Return the entry of a name or alias.

        Raises:
            ValueError: there is none; the message suggests the nearest name.
        """
        return self._entry(name, name)

    def unregister(self, name: str) -> None:
        """Remove the entry of a name or alias.

        Raises:
            KeyError: there is none.
        """
        entry = self._entries.pop(self[name].name)
        self._by_alias = {k: v for k, v in self._by_alias.items() if v != entry.name}

    def split(self, text: str) -> tuple[Entry[T], str]:
        """Return the entry that NAME or NAME:ARGUMENT stands for, and the argument.

        Raises:
            ValueError: there is none, or it takes no argument.
        """
        name, _, argument = text.partition(":")
        entry = self._entry(name, text)
        if argument and not entry.argument:
            raise ValueError(f"{self.kind} {name!r} takes no argument, but got {text!r}")
        return entry, argument

    def _entry(self, name: str, text: str) -> Entry[T]:
        if name not in self:
            raise ValueError(unknown(self.kind, text, self._by_alias, self.see))
        return self[name]

    def helps(self) -> dict[str, str]:
        """Return names with the form of their arguments, and their lines of help."""
        return {name + entry.argument: entry.help for name, entry in self._entries.items()}

    def __getitem__(self, name: str) -> Entry[T]:
        return self._entries[self._by_alias[name.lower()]]

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and name.lower() in self._by_alias

    def __iter__(self) -> Iterator[str]:
        return iter(self._entries)

    def __len__(self) -> int:
        return len(self._entries)


def unknown(kind: str, name: str, known: Iterable[str], where: str = HELP) -> str:
    """Return a one-line message for an unknown name.

    Args:
        kind: the kind of name, such as "driver".
        known: all names, in the order to list them.
        where: the command or page that lists them.

    >>> unknown("driver", "homr", ["lisa", "marge", "bart", "homer"])
    "unknown driver 'homr'; did you mean homer? hmi-marl --help lists all"
    """
    return f"unknown {kind} {name!r}; {suggest(name, known, where)}"


def suggest(name: str, known: Iterable[str], where: str = HELP) -> str:
    """Return the message's end: the nearest known names, up to three, or a short list of all."""
    spelt = {each.lower(): each for each in known}
    near = get_close_matches(name.lower(), spelt, n=3, cutoff=0.6)
    if near:
        return f"did you mean {' or '.join(spelt[each] for each in near)}? {where} lists all"
    listed = ", ".join(spelt.values())
    if len(listed) <= _LISTED:
        return f"known: {listed} (see {where})"
    return f"{where} lists all"
