"""``hmi-marl reproduce``."""

from __future__ import annotations

import inspect
import shlex
from dataclasses import dataclass, field, make_dataclass, replace
from functools import cache
from pathlib import Path
from typing import Annotated, Any, ClassVar, Union

import tyro

from hmi_marl.commands.choice import Choice
from hmi_marl.commands.train import use_quiet_threads
from hmi_marl.experiments.experiment import Experiment, Place, coarse, conduct
from hmi_marl.experiments.registry import EXPERIMENTS
from hmi_marl.ownership import check_free, owned
from hmi_marl.reporting.report import PAGE, Stopwatch, print_page
from hmi_marl.training.cluster.cluster import connected
from hmi_marl.workers import check_workers

RUNS = Path("runs/reproduce")
SHIPPED_DRIVER = Path("trained:driver")


@dataclass(frozen=True)
class ReproduceAll:
    """Reproduce every table and figure of the paper, with a verdict on each claim.

    Resumes where it was cut off.

    Example: hmi-marl reproduce --quick
    """

    quick: bool = False
    """Run a coarse version of a quarter of an hour instead."""
    seed: int = 0
    """Seed of everything."""
    workers: int | None = None
    """Trainings and evaluations at a time; all cores by default. Does not change results."""
    ray: str | None = None
    """Train on a Ray cluster instead of in processes here: auto, HOST:PORT, ray://HOST:PORT, or
    local for one on this machine. By default as many trainings at a time as it has cores."""
    out: Path | None = None
    """Folder; by default runs/reproduce/all, with --quick runs/reproduce/all-quick."""

    def run(self, command_line: str) -> None:
        """Run what is not done yet, write the report and print its address."""
        use_quiet_threads()
        from hmi_marl.reproduction.report import REPORT, full_report
        from hmi_marl.reproduction.suite import (
            TIMINGS,
            full_suite,
            read_timings,
            run_suite,
            shared_driver,
        )

        suite, workers = full_suite(self.quick, self.seed), check_workers(self.workers)
        out = self.out or RUNS / ("all-quick" if self.quick else "all")
        # The report names the command without what does not change results.
        again = ["hmi-marl", "reproduce", *["--quick"] * self.quick]
        again += ["--seed", str(self.seed)] if self.seed else []
        driver_run = shared_driver(suite, out)
        with connected(self.ray, self.workers) as cluster, owned(out):
            records = run_suite(suite, out, driver_run, workers, command_line, cluster=cluster)
            timings = read_timings(out / TIMINGS)
            page = full_report(records, shlex.join(again), timings).write(out / REPORT)
        print_page(page)


@dataclass(frozen=True)
class ReproduceOne:
    """Run one experiment; the subclasses have its settings."""

    settings: Experiment[Any]
    quick: bool = False
    """Run a coarse version of minutes instead."""
    workers: int | None = None
    """Trainings and evaluations at a time; all cores by default. Does not change results."""
    ray: str | None = None
    """Train on a Ray cluster instead of in processes here: auto, HOST:PORT, ray://HOST:PORT, or
    local for one on this machine. By default as many trainings at a time as it has cores."""
    out: Path | None = None
    """Folder; by default runs/reproduce/ and the experiment's name, with --quick NAME-quick."""

    driver_run: ClassVar[Path | None] = None

    def run(self, command_line: str) -> None:
        """Learn what is not learned yet, play, judge, write and print."""
        use_quiet_threads()
        experiment, workers = self.settings, check_workers(self.workers)
        if self.quick:
            experiment = coarse(experiment, experiment.quick())
        out = self.out or RUNS / (experiment.name + "-quick" * self.quick)
        driver_run = self.driver_run
        with connected(self.ray, self.workers) as cluster, owned(out):
            place = Place(out, driver_run or out, workers, command_line, cluster=cluster)
            if driver_run is None and experiment.uses_driver:
                place = replace(place, driver_run=_learn_driver(experiment, place))
            print(conduct(experiment, place).text)
        print_page(out / PAGE)


@dataclass(frozen=True)
class ReproduceWithDriver(ReproduceOne):
    """Run one experiment that plays with a driver policy."""

    driver_run: Path | None = None  # type: ignore[misc]
    """Trained run with the driver to take, or trained:NAME; by default a driver is trained here
    where the experiment trains one, else trained:driver."""


@dataclass(frozen=True)
class ReproduceShip:
    """Copy the agents of a finished reproduction to where the package ships them from.

    With --compare the trained pairs and the report of a finished hmi-marl compare instead, with
    --only the agents of a finished hmi-marl reproduce NAME, next to what is there.

    Example: hmi-marl reproduce ship --out hmi_marl/trained --report docs/report
    """

    out: Path
    """Folder for the agents and their index; those of the same names in it are replaced."""
    run_folder: Annotated[Path, tyro.conf.arg(name="run")] = RUNS / "all"
    """Folder of the reproduction."""
    report: Path | None = None
    """Folder to which the report is copied as well, in place of an earlier one; with --compare its
    text, JSON, figures and clips, and an index with their checksums."""
    compare: Path | None = None
    """Folder of a finished comparison, of which the pairs of the first seed are added."""
    only: str | None = None
    """Experiment whose agents alone are added, from its folder (--run)."""

    def run(self, command_line: str) -> None:
        """Copy, without this machine's paths, and print what was copied."""
        from hmi_marl.reproduction.report import REPORT
        from hmi_marl.reproduction.shipping import read_report, ship, ship_more, write_report
        from hmi_marl.reproduction.suite import full_suite, shared_driver

        check_free(self.out)
        if self.compare is not None:
            if self.only is not None:
                raise ValueError("give --compare or --only, not both")
            from hmi_marl.reproduction.comparison import ship_comparison

            for agent in ship_comparison(self.compare, self.out, self.report):
                print(f"{agent.name:<28} {agent.what}")
            return
        name, run_folder = self.only, self.run_folder
        if name is not None:
            if self.report is not None:
                raise ValueError("--report is copied with all agents: leave it out, or --only")
            check_free(run_folder)
            experiment = EXPERIMENTS.find(name).value.load(name)()
            agents = experiment.agents(Place(run_folder, run_folder))
            if not agents:
                raise ValueError(f"{name} has no agents to ship")
            ship_more(agents, self.out)
            for agent in agents:
                print(f"{agent.name:<28} {agent.what}")
            return
        pages = {}
        if self.report is not None:  # all that can fail comes before the agents are replaced
            check_free(self.report)
            pages = read_report(self.run_folder / REPORT)
        suite = full_suite()
        for agent in ship(suite, self.run_folder, shared_driver(suite, self.run_folder), self.out):
            print(f"{agent.name:<20} {agent.what}")
        if self.report is not None:
            write_report(self.report, pages)


@dataclass(frozen=True)
class Reproduce(Choice):
    """Reproduce the paper's results, each number with its exact value and a verdict.

    Example: hmi-marl reproduce --quick
    """


def experiment_command(name: str) -> type[ReproduceOne]:
    """Make the subcommand of a registered experiment: its settings, and where to run it."""
    return _command_of(name, EXPERIMENTS[name].value.load(name))


@cache
def _command_of(name: str, kind: type[Experiment[Any]]) -> type[ReproduceOne]:
    base = ReproduceWithDriver if kind.uses_driver else ReproduceOne
    # Groups within keep their prefixes.
    unprefixed = Annotated[kind, tyro.conf.arg(name="")]  # type: ignore[valid-type]
    settings = ("settings", unprefixed, field(default_factory=kind))
    command = make_dataclass(kind.__name__, [settings], bases=(base,), frozen=True)
    about = inspect.cleandoc(kind.__doc__ or "").partition("\n\nRaises:")[0]
    about, _, example = about.partition("\n\nExample:")
    example = example or f" hmi-marl reproduce {name} --quick"
    command.__doc__ = f"{about}\n\nResumes where it was cut off.\n\nExample:{example}"
    return command


def reproduce_command(name: str = "reproduce") -> type[Reproduce]:
    """Make the command that chooses among all experiments, ``all`` and ``ship``."""
    return _choice_of(tuple((name, experiment_command(name)) for name in EXPERIMENTS))


@cache
def _choice_of(experiments: tuple[tuple[str, type[Any]], ...]) -> type[Reproduce]:
    parts = (("all", ReproduceAll), *experiments, ("ship", ReproduceShip))
    kinds = tuple(Annotated[kind, tyro.conf.subcommand(name)] for name, kind in parts)
    choice = tyro.conf.OmitSubcommandPrefixes[Union[kinds]]  # type: ignore[valid-type] # noqa: UP007
    what = ("what", Annotated[choice, tyro.conf.arg(prefix_name=False)])
    command = make_dataclass(
        "Reproduce", [(*what, field(default_factory=ReproduceAll))], bases=(Reproduce,), frozen=True
    )
    command.__doc__ = Reproduce.__doc__
    return command


def _learn_driver(experiment: Experiment[Any], place: Place) -> Path:
    """Learn the driver policy that an experiment plays with; returns its run."""
    job = experiment.driver_job(place.folder)
    if job is None:
        return SHIPPED_DRIVER
    experiment.check_machine()
    replace(place, workers=1, watch=Stopwatch()).train([job])
    return job.folder
