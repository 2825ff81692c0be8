"""Errors for names that are not known: what was wrong, what is near, and where the list is."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches

HELP = "hmi-marl --help"
"""Lists drivers, HMIs, driver policies and subcommands."""
_LISTED = 80
"""Characters up to which the known names are listed where none is near."""


def unknown(kind: str, name: str, known: Iterable[str], where: str = HELP) -> str:
    """A one-line message for a name that is not known.

    Args:
        kind: of name, such as "driver".
        name: that was given.
        known: names, in the order to list them.
        where: all of them are listed.

    >>> unknown("driver", "homr", ["lisa", "marge", "bart", "homer"])
    "unknown driver 'homr'; did you mean homer? hmi-marl --help lists all"
    """
    return f"unknown {kind} {name!r}; {suggest(name, known, where)}"


def suggest(name: str, known: Iterable[str], where: str = HELP) -> str:
    """The end of such a message: the nearest known names, up to three, or a short list of all."""
    spelt = {each.lower(): each for each in known}
    near = get_close_matches(name.lower(), spelt, n=3, cutoff=0.6)
    if near:
        return f"did you mean {' or '.join(spelt[each] for each in near)}? {where} lists all"
    listed = ", ".join(spelt.values())
    if len(listed) <= _LISTED:
        return f"known: {listed} (see {where})"
    return f"{where} lists all"
