"""Fill the parts of pages that are made from the code: one source for each text.

A page names such a part by a comment in a line of its own, ``<!-- made: environment -->``, up to
``<!-- end -->``; the text in between is for readers of the page in the repository.
"""

from __future__ import annotations

import contextlib
import importlib
import inspect
import io
import os
import pkgutil
import re
from collections.abc import Callable, Iterator
from dataclasses import MISSING, fields, is_dataclass
from pathlib import Path
from typing import get_type_hints
from unittest import mock

from hmi_marl import merge_v0
from hmi_marl.checks import Checked, allowed
from hmi_marl.cli import parse
from hmi_marl.commands.registry import extras_table
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.observations import (
    Layout,
    driver_layout,
    state_layout,
    vehicle_ai_layout,
)
from hmi_marl.extras import EXTRAS

ROOT = Path(__file__).parents[2]
_PART = re.compile(
    r"^<!-- made: ([\w .-]+) -->\n(?:.*?\n)??<!-- end -->$", re.MULTILINE | re.DOTALL
)
_WIDTH = "96"
"""Columns of the help texts."""


def fill(page: str) -> str:
    """Return the page with its made parts filled in.

    Raises:
        ValueError: a comment that names no part, or a part that has no end.
    """
    if re.search(r"^<!-- (?:made|end)", _PART.sub("", page), re.MULTILINE):
        raise ValueError("a made part is '<!-- made: NAME -->', lines, '<!-- end -->'")
    return _PART.sub(lambda found: _make(found[1]), page)


def _make(name: str) -> str:
    kind, _, argument = name.partition(" ")
    makers: dict[str, Callable[[], str]] = {
        "environment": environment,
        "layouts": layouts,
        "settings": settings,
        "commands": commands,
        "extras": extras_table,
        "example": lambda: example(argument),
        "file": lambda: _without_title((ROOT / argument).read_text(encoding="utf-8")),
    }
    if kind not in makers:
        raise ValueError(f"unknown part {name!r}; known: {', '.join(makers)}")
    return makers[kind]().strip()


def environment() -> str:
    """Return the environment's page: the docstring of its module."""
    return _without_title(inspect.getdoc(merge_v0) or "")


def layouts() -> str:
    """Return a table of each seat's observation and of the state, with the defaults."""
    config = TeamConfig()
    made = {
        "driver": driver_layout(config),
        "vehicle_ai": vehicle_ai_layout(config),
        "state()": state_layout(config),
    }
    return "\n\n".join(
        f"### `{name}`, {layout.size} numbers\n\n{_table(layout)}" for name, layout in made.items()
    )


def settings() -> str:
    """Every public settings dataclass with its numbers, their ranges and defaults."""
    _import_all_that_is_installed()
    parts, kinds = [], Checked.__subclasses__()
    while kinds:
        kind = kinds.pop(0)
        kinds += kind.__subclasses__()
        ours = is_dataclass(kind) and kind.__module__.startswith("hmi_marl.")
        rows = list(_ranges(kind)) if ours and not kind.__name__.startswith("_") else []
        if rows and f"{kind.__module__}.{kind.__qualname__}" not in {name for name, _ in parts}:
            head = "| field | range | default |\n| --- | --- | --- |"
            parts.append((f"{kind.__module__}.{kind.__qualname__}", "\n".join([head, *rows])))
    return "\n\n".join(
        f"### `{name.removeprefix('hmi_marl.')}`\n\n{rows}" for name, rows in sorted(parts)
    )


def _import_all_that_is_installed() -> None:
    """Import the package's modules, without those that need an extra.

    The site is made with the extra ``docs`` alone. No settings are missed: the command line reads
    them without any extra, so they are in modules that need none.
    """
    extras = {module for modules in EXTRAS.values() for module in modules}
    for package in "agents", "demonstrations", "envs", "experiments", "people", "training":
        folder = [str(ROOT / "hmi_marl" / package)]
        for module in pkgutil.walk_packages(folder, f"hmi_marl.{package}."):
            try:
                importlib.import_module(module.name)
            except ModuleNotFoundError as error:
                if (error.name or "").partition(".")[0] not in extras:
                    raise


def _ranges(kind: type) -> Iterator[str]:
    """Rows of a dataclass's fields that have a range, without those of its base classes."""
    hints, own = get_type_hints(kind, include_extras=True), vars(kind).get("__annotations__", {})
    for field in fields(kind):
        if field.name in own and (words := allowed(hints[field.name])):
            default = "" if field.default is MISSING else f"`{field.default!r}`"
            yield f"| `{field.name}` | {words} | {default} |"


def _table(layout: Layout) -> str:
    rows = ["| columns | name | bounds | |", "| --- | --- | --- | --- |"]
    for part in layout.parts:
        where = layout[part.name]
        bounds = f"{part.low:g} to {part.high:g}"
        rows.append(f"| {where.start}:{where.stop} | `{part.name}` | {bounds} | {part.meaning} |")
    return "\n".join(rows)


def example(name: str) -> str:
    """Return the code of an example for another trainer, without its title.

    Its fence is ``py``: code in ``python`` fences is run where the site is made, and trainers that
    need an environment of their own are not installed there. The tests of trainers run these.
    """
    code = (ROOT / "examples" / "trainers" / f"{name}.py").read_text(encoding="utf-8")
    _, _, body = code.removeprefix('"""').partition('"""\n\n')
    return f"`examples/trainers/{name}.py`:\n\n```py\n{body.strip()}\n```"


def commands() -> str:
    """Return the ``--help`` of every command."""
    return "\n\n".join(
        f"## {' '.join(['hmi-marl', *command])}\n\n```text\n{text}\n```"
        for command, text in _helps()
    )


def _helps(command: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], str]]:
    text = _help(command)
    yield command, text
    _, _, subcommands = text.partition("─ subcommands ")
    for name in re.findall(r"^│   • ([\w-]+)", subcommands, re.MULTILINE):
        yield from _helps((*command, name))


def _help(command: tuple[str, ...]) -> str:
    printed = io.TextIOWrapper(io.BytesIO(), encoding="utf-8")  # an encoding with box-drawing lines
    with (
        mock.patch.dict(os.environ, {"COLUMNS": _WIDTH, "NO_COLOR": "1"}),
        contextlib.redirect_stdout(printed),
        contextlib.suppress(SystemExit),
    ):
        parse([*command, "--help"])
    printed.seek(0)
    return "\n".join(line.rstrip() for line in printed).strip("\n")


def _without_title(text: str) -> str:
    return re.sub(r"\A# .*\n", "", text)
