"""``hmi-marl reproduce``."""

from __future__ import annotations

import shlex
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

import tyro

from hmi_marl.commands.fields import only
from hmi_marl.commands.reproduce_adapt import ReproduceAdapt
from hmi_marl.commands.reproduce_graded import ReproduceGraded
from hmi_marl.commands.train import use_quiet_threads
from hmi_marl.experiments.attentive_drivers import AttentiveSettings
from hmi_marl.experiments.hidden_attention import HiddenSettings
from hmi_marl.experiments.latent_traits.settings import TraitReproduction
from hmi_marl.experiments.metrics_table.reproduction import ReproductionSettings
from hmi_marl.files import write_bytes
from hmi_marl.workers import check_workers


@dataclass(frozen=True)
class ReproduceAll:
    """Reproduce every table and figure of the paper, with a verdict on each claim.

    Goes on by itself where it was cut off.

    Example: hmi-marl reproduce --quick
    """

    quick: bool = False
    """A coarse one in a quarter of an hour instead."""
    seed: int = 0
    """Of everything."""
    workers: int | None = None
    """Trainings and evaluations at a time; all cores by default. Does not change results."""
    out: Path | None = None
    """Folder; by default runs/reproduce/all, with --quick runs/reproduce/all-quick."""

    def run(self, command_line: str) -> None:
        """Do what is not done yet, write the report and say where it is."""
        use_quiet_threads()
        from hmi_marl.reproduction.suite import QUICK, FullSettings, reproduce_all

        settings = (QUICK if self.quick else FullSettings()).with_seed(self.seed)
        out = self.out or Path("runs/reproduce") / ("all-quick" if self.quick else "all")
        told = ["hmi-marl", "reproduce", *["--quick"] * self.quick]
        told += ["--seed", str(self.seed)] if self.seed else []
        page = reproduce_all(
            settings, out, check_workers(self.workers), command_line, shlex.join(told)
        )
        print(f"the page: {page.resolve().as_uri()}")


@dataclass(frozen=True)
class ReproduceTable:
    """Learn every policy of the paper's table of HMIs and drivers, and make the table.

    Goes on by itself where it was cut off.

    Example: hmi-marl reproduce table --quick
    """

    size: tyro.conf.OmitArgPrefixes[ReproductionSettings] = field(
        default_factory=ReproductionSettings
    )
    """How large."""
    quick: bool = False
    """A coarse one in a few minutes instead."""
    workers: int | None = None
    """Trainings and evaluations at a time; all cores by default. Does not change results."""
    out: Path | None = None
    """Folder; by default runs/reproduce/table, with --quick runs/reproduce/table-quick."""

    def run(self, command_line: str) -> None:
        """Learn what is not learned yet, play, write and print."""
        use_quiet_threads()
        from hmi_marl.experiments.paper_stages import TableStage
        from hmi_marl.experiments.stages import Place
        from hmi_marl.reproduction.suite import QUICK_TABLE

        size = self.size
        if self.quick:
            if replace(size, seed=0) != ReproductionSettings():
                raise ValueError("--quick sets the sizes itself; leave it out to choose them")
            size = replace(QUICK_TABLE, seed=size.seed)
        out = self.out or Path("runs/reproduce") / ("table-quick" if self.quick else "table")
        place = Place(out, out, check_workers(self.workers), command_line)
        print(TableStage(size).run(place).text)
        _tell_page(out)


@dataclass(frozen=True)
class ReproduceDriver:
    """Learn to drive without distraction: speed, crashes and headway by steps.

    Example: hmi-marl reproduce driver --steps 18_000_000
    """

    size: tyro.conf.OmitArgPrefixes[AttentiveSettings] = field(default_factory=AttentiveSettings)
    """How large."""
    out: Path = Path("runs/reproduce/driver")
    """Folder."""

    def run(self, command_line: str) -> None:
        """Learn, play, write and print."""
        use_quiet_threads()
        from hmi_marl.experiments.paper_stages import DriverStage
        from hmi_marl.experiments.stages import Place

        print(DriverStage(self.size).run(Place(self.out, self.out, 1, command_line)).text)


@dataclass(frozen=True)
class ReproduceHidden:
    """Compare learned HMIs that do not see attention with Bayes filters, by driver.

    Example: hmi-marl reproduce hidden --driver-run trained:driver
    """

    size: tyro.conf.OmitArgPrefixes[HiddenSettings] = field(default_factory=HiddenSettings)
    """How large."""
    driver_run: Path | None = None
    """A trained run whose driver to take; without it one is trained here."""
    workers: int | None = None
    """Trainings at a time; all cores by default. Does not change results."""
    out: Path = Path("runs/reproduce/hidden")
    """Folder."""

    def run(self, command_line: str) -> None:
        """Learn what is not learned yet, play, write and print."""
        use_quiet_threads()
        from hmi_marl.experiments.paper_stages import HiddenStage, learn_driver
        from hmi_marl.experiments.stages import Place

        workers = check_workers(self.workers)
        driver_run = self.driver_run or learn_driver(self.size.driver_job(self.out), command_line)
        print(HiddenStage(self.size).run(Place(self.out, driver_run, workers, command_line)).text)


@dataclass(frozen=True)
class ReproduceTraits(TraitReproduction):
    """Learn latent traits in the paper's three settings and judge what was learned.

    Goes on where it was cut off. With --seeds 5 every setting is learned five times, and accuracies
    and KL get intervals.

    Example: hmi-marl reproduce traits --driver-run trained:driver
    """

    driver_run: Path | None = None
    """A trained run whose driver to take; without it one is trained here."""
    workers: int | None = None
    """Trainings at a time; all cores by default. Does not change results."""
    out: Path = Path("runs/reproduce/traits")
    """Folder."""

    def run(self, command_line: str) -> None:
        """Do what is not done yet, judge, write and print."""
        use_quiet_threads()
        from hmi_marl.experiments.paper_stages import TraitsStage, learn_driver
        from hmi_marl.experiments.stages import Place

        workers = check_workers(self.workers)
        size = only(TraitReproduction, self)
        driver_run = self.driver_run or learn_driver(size.driver_job(self.out), command_line)
        print(TraitsStage(size).run(Place(self.out, driver_run, workers, command_line)).text)
        _tell_page(self.out)


@dataclass(frozen=True)
class ReproduceShip:
    """Copy the agents of a finished reproduction to where the package ships them from.

    Example: hmi-marl reproduce ship --out hmi_marl/trained --report docs/report
    """

    out: Path
    """Folder for the agents and their index; what was in it before is replaced."""
    run_folder: Annotated[Path, tyro.conf.arg(name="run")] = Path("runs/reproduce/all")
    """Folder of the reproduction."""
    report: Path | None = None
    """Folder to which the report and its numbers are copied as well."""

    def run(self, command_line: str) -> None:
        """Copy, without this machine's paths, and print what was copied."""
        from hmi_marl.reproduction.report import NUMBERS, PAGE
        from hmi_marl.reproduction.shipping import ship
        from hmi_marl.reproduction.suite import FullSettings, shared_driver

        stages = FullSettings().stages()
        for agent in ship(stages, self.run_folder, shared_driver(self.run_folder), self.out):
            print(f"{agent.name:<20} {agent.what}")
        if self.report is not None:
            for name in (PAGE, NUMBERS):
                write_bytes(self.report / name, (self.run_folder / name).read_bytes())


def _tell_page(out: Path) -> None:
    print(f"\nthe page: {(out / 'index.html').resolve().as_uri()}")


What = (
    Annotated[ReproduceAll, tyro.conf.subcommand("all")]
    | Annotated[ReproduceTable, tyro.conf.subcommand("table")]
    | Annotated[ReproduceDriver, tyro.conf.subcommand("driver")]
    | Annotated[ReproduceHidden, tyro.conf.subcommand("hidden")]
    | Annotated[ReproduceAdapt, tyro.conf.subcommand("adapt")]
    | Annotated[ReproduceTraits, tyro.conf.subcommand("traits")]
    | Annotated[ReproduceGraded, tyro.conf.subcommand("graded")]
    | Annotated[ReproduceShip, tyro.conf.subcommand("ship")]
)


@dataclass(frozen=True)
class Reproduce:
    """Reproduce the paper's results, each number with its exact value and a verdict.

    Example: hmi-marl reproduce --quick
    """

    what: Annotated[tyro.conf.OmitSubcommandPrefixes[What], tyro.conf.arg(prefix_name=False)] = (
        field(default_factory=ReproduceAll)
    )
    """Which part of it."""

    def run(self, command_line: str) -> None:
        """Make it."""
        self.what.run(command_line)
