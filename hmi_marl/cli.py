"""The ``hmi-marl`` command: parse, import what the subcommand needs, call, print."""

from __future__ import annotations

import io
import os
import re
import shlex
import sys
from collections.abc import Callable, Sequence
from contextlib import redirect_stderr, redirect_stdout, suppress
from dataclasses import make_dataclass
from typing import Annotated, Any, NoReturn, Union

import hmi_marl
from hmi_marl import interrupts
from hmi_marl.commands.registry import BY_NAME, SUBCOMMANDS
from hmi_marl.registry import unknown
from hmi_marl.text import one_line

BAD_INPUT, BROKEN_PIPE = 2, 141
"""Exit statuses; the last is that of a shell after SIGPIPE. For signals: :mod:`interrupts`."""
ERRORS = (ArithmeticError, ImportError, MemoryError, OSError, RuntimeError, TypeError, ValueError)
"""Errors that are printed in one line. Any other is a bug and shows its traceback."""
_WIDE = {"COLUMNS": "10000"}
"""Columns of a terminal so wide that tyro breaks no line of an error."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command and return its exit status. Errors take one line, without a traceback."""
    if isinstance(sys.stdout, io.TextIOWrapper):  # file names may be no text
        sys.stdout.reconfigure(errors="backslashreplace")
    try:
        with interrupts.raised():
            _run(list(sys.argv[1:] if arguments is None else arguments))
    except KeyboardInterrupt:
        return interrupts.report()
    except BrokenPipeError:  # as in `hmi-marl oracle | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # or exit reports it
        return BROKEN_PIPE
    except Exception as error:
        if interrupts.was_stopped():  # some extensions turn what interrupts them into this
            return interrupts.report()
        if not isinstance(error, ERRORS):
            raise
        print(f"hmi-marl: {one_line(_reported(error)) or type(error).__name__}", file=sys.stderr)
        return BAD_INPUT
    return 0


def _reported(error: Exception) -> str:
    """Return an error's message; one of the system begins with the file that it is about."""
    if not isinstance(error, OSError) or not error.strerror:
        return str(error)
    file, reason = error.filename, error.strerror
    return f"{os.fsdecode(file)}: {reason}" if isinstance(file, (str, bytes)) else reason


def parse(arguments: Sequence[str]) -> Any:
    """Parse a command line into its subcommand's dataclass, without checking it.

    Imports only the module of that subcommand.

    Raises:
        SystemExit: after printing help (status 0) or an error of one line (status 2).
    """
    name, *rest = arguments or ["--help"]
    if name.startswith("-"):
        return _parse(_overview(), "hmi-marl", [name, *rest], _description())
    if name not in BY_NAME:
        _refuse(unknown("subcommand", name, BY_NAME))
    subcommand, prog = BY_NAME[name], f"hmi-marl {name}"
    parts = [part.name for part in subcommand.parts]
    if parts and rest and not rest[0].startswith("-") and rest[0] not in parts:
        _refuse(unknown(f"subcommand of {name}", rest[0], parts, f"{prog} --help"))
    return _parse(subcommand.load(), prog, rest, parts=parts)


def _run(arguments: list[str]) -> None:
    if arguments == ["--version"]:
        print(f"hmi-marl {hmi_marl.__version__}")
        return
    try:
        command = parse(arguments)
        BY_NAME[arguments[0]].check(command)
        command.run(shlex.join(["hmi-marl", *arguments]))
    finally:
        sys.stdout.flush()  # here, where a broken pipe can still be handled


def _overview() -> Any:
    """Return the subcommands without their options, so that none of their modules is imported."""
    import tyro

    kinds = tuple(
        Annotated[
            make_dataclass(each.name, []), tyro.conf.subcommand(each.name, description=each.help)
        ]
        for each in SUBCOMMANDS
    )
    return Union[kinds]  # noqa: UP007  # made at run time


def _description() -> str:
    """Return the help text with all drivers, HMIs and driver policies."""
    from hmi_marl.agents.catalogue import known_names
    from hmi_marl.envs.config import DRIVER, VEHICLE_AI
    from hmi_marl.envs.drivers import DRIVERS

    kinds = (
        ("drivers", {name: str(driver) for name, driver in DRIVERS.items()}),
        ("HMIs", known_names(VEHICLE_AI)),
        ("driver policies", known_names(DRIVER)),
    )
    known = "\n\n".join(
        f"{title}:\n" + "\n".join(f"  {name:<24} {meaning}" for name, meaning in kind.items())
        for title, kind in kinds
    )
    return (
        "Human-AI teaming in driving: a distractible driver and their HMI.\n\n"
        "Example: hmi-marl oracle --driver homer\n\n"
        f"{known}\n\n"
        "hmi-marl SUBCOMMAND --help lists its options, hmi-marl --version prints the version."
    )


def _parse(
    kind: Any,
    prog: str,
    arguments: list[str],
    description: str | None = None,
    parts: Sequence[str] = (),
) -> Any:
    """Parse arguments with tyro, and print an error in one line.

    ``description`` is shown in help in place of the docstring of the dataclass ``kind``; ``parts``
    are the names of its subcommands.
    """
    import tyro

    def parsed(arguments: list[str]) -> Any:
        return tyro.cli(
            kind,
            prog=prog,
            description=description,
            args=arguments,
            config=(tyro.conf.CascadeSubcommandArgs, tyro.conf.OmitSubcommandPrefixes),
        )

    if not {"-h", "--help"}.isdisjoint(arguments):
        return parsed(arguments)
    from hmi_marl.workers import environment  # which help does without

    printed, errors = _text(), _text()  # into which tyro draws the boxes that are read below
    try:
        with environment(_WIDE), redirect_stdout(printed), redirect_stderr(errors):
            return parsed(arguments)
    except SystemExit as stop:
        if not stop.code:  # such as a shell's completions
            sys.stdout.write(_written(printed))
            raise
    return _refuse(_reason(_written(errors), parsed, prog, arguments, parts))


def _reason(
    error: str,
    parsed: Callable[[list[str]], object],
    prog: str,
    arguments: list[str],
    parts: Sequence[str],
) -> str:
    """Return in one line what is wrong with arguments that tyro refuses with an error."""
    part = [argument for argument in arguments if argument in parts][-1:]
    lists, first = " ".join([prog, *part, "--help"]), _first_part(error)
    if not first.startswith("Error parsing "):  # which it says where it knows every option
        rows = re.findall(r"│ +((?:--?[\w.-]+(?:, )?)+)", _help(parsed, part))
        options = [option for row in rows for option in row.split(", ")]
        for argument in arguments:
            option = argument.partition("=")[0].replace("_", "-")
            if option.startswith("--") and option not in (*options, "--"):
                return unknown("option", option, options, lists)
    return _explained(first, lists)


def _help(parsed: Callable[[list[str]], object], part: list[str]) -> str:
    """Return the help that tyro prints, with no line broken."""
    from hmi_marl.workers import environment

    text = _text()
    with environment(_WIDE), redirect_stdout(text), redirect_stderr(text), suppress(SystemExit):
        parsed([*part, "--help"])
    return _written(text)


def _text() -> io.TextIOWrapper:
    return io.TextIOWrapper(io.BytesIO(), encoding="utf-8")  # tyro looks for an encoding


def _written(text: io.TextIOWrapper) -> str:
    text.seek(0)
    return text.read()


def _first_part(box: str) -> str:
    """Return the text of tyro's boxed error up to its first rule, in one line."""
    lines = [line.strip(" │") for line in box.splitlines() if line[:1] == "│"]
    end = next((place for place, line in enumerate(lines) if line.startswith("──")), len(lines))
    return one_line(" ".join(lines[:end])).rstrip(".") or "cannot parse the arguments"


def _explained(error: str, lists: str) -> str:
    """Rephrase tyro's error if it is about a name or a group of options."""
    if found := re.match(
        r"invalid choice '(.*)' for argument '(.*)'\. Expected one of (.*)", error
    ):
        value, argument, choices = found.groups()
        return unknown(f"value of {argument}", value, re.findall(r"'(.*?)'", choices), lists)
    if found := re.match(r"Error parsing [\w.]+: (.*)", error):  # of a group of options
        return found[1]
    return f"{error}; see {lists}"


def _refuse(reason: str) -> NoReturn:
    print(f"hmi-marl: {one_line(reason)}", file=sys.stderr)
    raise SystemExit(BAD_INPUT)


if __name__ == "__main__":
    sys.exit(main())
