"""Error messages for unknown names: the name, the nearest known ones, and where the list is."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches

HELP = "hmi-marl --help"
"""Lists drivers, HMIs, driver policies and subcommands."""
_LISTED = 80
"""Longest list of known names in a message, in characters."""


def unknown(kind: str, name: str, known: Iterable[str], where: str = HELP) -> str:
    """Return a one-line message for an unknown name.

    Args:
        kind: the kind of name, such as "driver".
        name: the unknown name.
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
