"""Subcommands of ``hmi-marl``: names, one-line helps and the extras that each needs.

A subcommand is an entry here and a typed dataclass with ``run(command_line)`` in a module of its
own, which is imported only when the subcommand is asked for.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from hmi_marl.experiments.registry import EXPERIMENTS
from hmi_marl.extras import EXTRAS, TRAINING, need

_PARQUET, _PROBES, _MINARI = ("pyarrow",), ("sklearn",), ("minari", "h5py")


@dataclass(frozen=True)
class Option:
    """Option that needs modules of its own."""

    shown: str
    """Option as it is typed, for the table and the error."""
    needs: tuple[str, ...]
    """Modules of extras."""
    chosen: Callable[[Any], bool]
    """Whether a parsed command uses it."""


@dataclass(frozen=True)
class Subcommand:
    """Subcommand, or one that chooses among several."""

    name: str
    help: str
    """First line of its class's docstring."""
    where: str | type[Any]
    """Its class, or MODULE:CLASS below ``hmi_marl``, or a function there that makes it by name."""
    needs: tuple[str, ...] = ()
    """Modules of extras, without which it does not begin."""
    options: tuple[Option, ...] = ()
    choices: tuple[Subcommand, ...] | Callable[[], tuple[Subcommand, ...]] = ()
    """Subcommands to choose among, or a function that imports and lists them."""
    choice: str = ""
    """Attribute of its class that holds the part chosen."""

    @property
    def parts(self) -> tuple[Subcommand, ...]:
        """Subcommands to choose among."""
        return self.choices() if callable(self.choices) else self.choices

    def load(self) -> type[Any]:
        """Import its class."""
        if not isinstance(self.where, str):
            return self.where
        module, _, name = self.where.partition(":")
        found = getattr(importlib.import_module(f"hmi_marl.{module}"), name)
        kind: type[Any] = found if isinstance(found, type) else found(self.name)
        return kind

    def check(self, command: Any, path: str = "") -> None:
        """Raise ``ModuleNotFoundError`` if an extra that a parsed command needs is missing."""
        path = f"{path} {self.name}".lstrip()
        for part in self.parts:
            if type(getattr(command, self.choice)) is part.load():
                part.check(getattr(command, self.choice), path)
        chosen = [option for option in self.options if option.chosen(command)]
        words = " ".join([path, *(option.shown for option in chosen)])
        need(words, *self.needs, *(module for option in chosen for module in option.needs))

    def leaves(self, path: str = "") -> Iterator[tuple[str, Subcommand]]:
        """List all that can be run, with the words that are typed for each."""
        path = f"{path} {self.name}".lstrip()
        if not self.parts:
            yield path, self
        for part in self.parts:
            yield from part.leaves(path)


ON_RAY = Option("--ray", ("ray",), lambda command: command.ray is not None)
"""Trains on a cluster."""


def _protocols() -> tuple[Subcommand, ...]:
    from hmi_marl.training.protocols.registry import PROTOCOLS  # not needed by other subcommands

    return tuple(
        Subcommand(name, entry.help, entry.value, TRAINING) for name, entry in PROTOCOLS.items()
    )


def _experiments() -> tuple[Subcommand, ...]:
    """Parts of ``hmi-marl reproduce``: all registered experiments, all at once, and shipping."""
    return (
        Subcommand(
            "all",
            "Reproduce every table and figure of the paper, with a verdict on each claim.",
            "commands.reproduce:ReproduceAll",
            TRAINING + _PARQUET + _PROBES,
            (ON_RAY,),
        ),
        *(
            Subcommand(
                name,
                entry.help,
                "commands.reproduce:experiment_command",
                entry.value.needs,
                (ON_RAY,),
            )
            for name, entry in EXPERIMENTS.items()
        ),
        Subcommand(
            "ship",
            "Copy the agents of a finished reproduction to where the package ships them from.",
            "commands.reproduce:ReproduceShip",
        ),
    )


SUBCOMMANDS = (
    Subcommand(
        "adapt",
        "Evaluate adaptive HMIs on unknown drivers against an HMI that knows the driver.",
        "commands.adapt:Adapt",
    ),
    Subcommand(
        "bench",
        "Measure the speed of the worlds in one run, as ratios to highway-env's own step.",
        "commands.bench:Bench",
    ),
    Subcommand(
        "collect",
        "Record demonstrations of drivers, by default with an HMI that alerts at random.",
        "commands.collect:Collect",
        _PARQUET,
        (Option("--minari", _MINARI, lambda command: command.minari),),
    ),
    Subcommand(
        "compare",
        "Compare sequential with joint training at equal environment steps, over several seeds.",
        "commands.compare:Compare",
        TRAINING,
        (ON_RAY,),
    ),
    Subcommand(
        "export",
        "Write a learned policy as ONNX, for use outside of Python.",
        "commands.export:Export",
        ("onnx",),
    ),
    Subcommand(
        "oracle",
        "Solve the alert problem of one driver exactly, and audit the paper's table.",
        "commands.oracle:Oracle",
    ),
    Subcommand(
        "people",
        "Export, delete and measure what people left at the wheel.",
        "commands.people:PeopleCommand",
        choices=(
            Subcommand(
                "export",
                "Write trips and answers of people into files.",
                "commands.people:ExportPeople",
                options=(
                    Option(
                        "--formats parquet", _PARQUET, lambda command: "parquet" in command.formats
                    ),
                    Option(
                        "--formats minari", _MINARI, lambda command: "minari" in command.formats
                    ),
                ),
            ),
            Subcommand(
                "delete",
                "Delete all data of one person from a database, by the code that they were given.",
                "commands.people:DeletePeople",
            ),
            Subcommand(
                "traits",
                "Measure the traits of a person from recorded trips, and make a driver of them.",
                "commands.people_traits:PeopleTraits",
            ),
        ),
        choice="what",
    ),
    Subcommand(
        "reproduce",
        "Reproduce the paper's results, each number with its exact value and a verdict.",
        "commands.reproduce:reproduce_command",
        choices=_experiments,
        choice="what",
    ),
    Subcommand(
        "sweep",
        "Train over lists and ranges of any option of train, by protocol and seed.",
        "commands.sweep:SweepCommand",
        TRAINING + _PARQUET,
        (ON_RAY,),
    ),
    Subcommand(
        "table",
        "Compare HMIs (rows) for drivers (columns) over seeded episodes.",
        "commands.table:TableCommand",
    ),
    Subcommand(
        "train",
        "Learn the driver's and the HMI's policies, by one of several protocols.",
        "commands.train:Train",
        choices=_protocols,
        choice="protocol",
    ),
    Subcommand(
        "traits",
        "Learn latent driver traits from driving alone, and judge them.",
        "commands.traits:TraitsCommand",
        choices=(
            Subcommand(
                "train",
                "Learn latent driver traits from demonstrations, by adversarial IRL.",
                "commands.traits:TrainTraits",
                TRAINING + _PARQUET,
            ),
            Subcommand(
                "evaluate",
                "Judge trait models on held-out driving: drivers identified, traits, imitation.",
                "commands.traits:EvaluateTraits",
                _PARQUET + _PROBES,
            ),
            Subcommand(
                "posterior",
                "Evaluate the exact posterior over traits over a population, by windows and "
                "seconds.",
                "commands.traits:TraitPosteriors",
                _PARQUET,
            ),
        ),
        choice="what",
    ),
    Subcommand(
        "watch",
        "Watch one episode: as a clip with --out, else in a window.",
        "commands.watch:Watch",
        options=(
            Option(
                "--out clip.mp4",
                ("imageio_ffmpeg",),
                lambda command: command.out is not None and command.out.suffix.lower() == ".mp4",
            ),
        ),
    ),
)
"""All subcommands, in the order in which ``hmi-marl --help`` lists them."""
BY_NAME: Mapping[str, Subcommand] = {each.name: each for each in SUBCOMMANDS}


def extras_table() -> str:
    """Write a Markdown table of the extras that each subcommand needs."""
    rows = ["| command | needs | for an option |", "| --- | --- | --- |"]
    for subcommand in SUBCOMMANDS:
        for path, leaf in subcommand.leaves():
            options = [f"`{each.shown}`: {_extras(each.needs)}" for each in leaf.options]
            rows.append(f"| `hmi-marl {path}` | {_extras(leaf.needs)} | {', '.join(options)} |")
    return "\n".join(rows)


def _extras(modules: tuple[str, ...]) -> str:
    extras = [extra for extra, own in EXTRAS.items() if not set(own).isdisjoint(modules)]
    return ", ".join(f"`{extra}`" for extra in extras) or "nothing more"
