"""The ``hmi-marl`` command: parse, call, print."""

from __future__ import annotations

import os
import shlex
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import tyro

import hmi_marl
from hmi_marl.agents import DRIVER_POLICY_NAMES, HMI_NAMES
from hmi_marl.commands.adapt import Adapt
from hmi_marl.commands.bench import Bench
from hmi_marl.commands.collect import Collect
from hmi_marl.commands.compare import Compare
from hmi_marl.commands.export import Export
from hmi_marl.commands.oracle import Oracle
from hmi_marl.commands.reproduce import Reproduce
from hmi_marl.commands.table import Table
from hmi_marl.commands.train import Train
from hmi_marl.commands.traits import Traits
from hmi_marl.commands.watch import Watch
from hmi_marl.envs.drivers import DRIVERS

BAD_INPUT, INTERRUPTED, NOBODY_READS = 2, 130, 141
"""Exit statuses; the last two are what the shell reports after SIGINT and SIGPIPE."""
ERRORS = (ArithmeticError, ImportError, MemoryError, OSError, RuntimeError, TypeError, ValueError)
"""Told in one line. Whatever else is raised is a fault of ours, and shows its trace."""


Command = (
    Annotated[Adapt, tyro.conf.subcommand("adapt")]
    | Annotated[Bench, tyro.conf.subcommand("bench")]
    | Annotated[Collect, tyro.conf.subcommand("collect")]
    | Annotated[Compare, tyro.conf.subcommand("compare")]
    | Annotated[Export, tyro.conf.subcommand("export")]
    | Annotated[Oracle, tyro.conf.subcommand("oracle")]
    | Annotated[Reproduce, tyro.conf.subcommand("reproduce")]
    | Annotated[Table, tyro.conf.subcommand("table")]
    | Annotated[Train, tyro.conf.subcommand("train")]
    | Annotated[Traits, tyro.conf.subcommand("traits")]
    | Annotated[Watch, tyro.conf.subcommand("watch")]
)


@dataclass(frozen=True)
class _CommandLine:
    """What was typed. Its one field gives errors a name to begin with."""

    command: Annotated[tyro.conf.OmitSubcommandPrefixes[Command], tyro.conf.arg(prefix_name=False)]


def _description() -> str:
    kinds = (
        ("drivers", {name: str(driver) for name, driver in DRIVERS.items()}),
        ("HMIs", HMI_NAMES),
        ("driver policies", DRIVER_POLICY_NAMES),
    )
    known = "\n\n".join(
        f"{title}:\n" + "\n".join(f"  {name:<16} {meaning}" for name, meaning in kind.items())
        for title, kind in kinds
    )
    return (
        "Human-AI teaming in driving: a distractible driver and their HMI.\n\n"
        f"{known}\n\nhmi-marl --version prints the version."
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; returns its exit status. Errors are told in one line, without a trace."""
    try:
        _run(list(sys.argv[1:] if arguments is None else arguments))
    except BrokenPipeError:  # as in `hmi-marl oracle | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # or Python's exit tells it
        return NOBODY_READS
    except ERRORS as error:
        told = " ".join(str(error).split()) or type(error).__name__
        print(f"hmi-marl: {told}", file=sys.stderr)
        return BAD_INPUT
    except KeyboardInterrupt:
        print("hmi-marl: interrupted", file=sys.stderr)
        return INTERRUPTED
    return 0


def parse(arguments: Sequence[str]) -> Command:
    """The subcommand that was typed, its arguments understood but not yet checked."""
    typed = tyro.cli(
        _CommandLine,
        prog="hmi-marl",
        description=_description(),
        args=list(arguments) or ["--help"],
        config=(tyro.conf.CascadeSubcommandArgs,),
    )
    return typed.command


def _run(arguments: list[str]) -> None:
    if arguments == ["--version"]:
        print(f"hmi-marl {hmi_marl.__version__}")
        return
    try:
        parse(arguments).run(shlex.join(["hmi-marl", *arguments]))
    finally:
        sys.stdout.flush()  # here, where a broken pipe can still be dealt with


if __name__ == "__main__":
    sys.exit(main())
