"""``hmi-marl reproduce``."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

import tyro
from tqdm import tqdm

from hmi_marl.commands.fields import only
from hmi_marl.commands.train import use_quiet_threads
from hmi_marl.envs.plain import plain
from hmi_marl.evaluation import attentive, hidden, reproduction, reproduction_report
from hmi_marl.evaluation.hidden import HiddenSettings
from hmi_marl.evaluation.reproduction import VARIANTS, ReproductionSettings
from hmi_marl.evaluation.trait_settings import DEMONSTRATIONS, POPULATION, TraitReproduction
from hmi_marl.files import make_folder, write_bytes, write_json, write_text
from hmi_marl.training.jobs import Job, need_training, train_all
from hmi_marl.training.settings import check_count
from hmi_marl.training.two_stage import TwoStage
from hmi_marl.workers import check_workers

QUICK = {"driver_steps": 1_000_000, "hmi_steps": 300_000, "episodes": 400}


@dataclass(frozen=True)
class ReproduceTable:
    """The paper's table of HMIs and drivers, every policy in it learnt.

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

    def run(self, typed: str) -> None:
        """Learn what is not learnt yet, play, write and print."""
        use_quiet_threads()
        size = self.size
        if self.quick:
            if replace(size, seed=0) != ReproductionSettings():
                raise ValueError("--quick sets the sizes itself; leave it out to choose them")
            size = ReproductionSettings(**QUICK, seed=size.seed)
        out = self.out or Path("runs/reproduce") / ("table-quick" if self.quick else "table")
        workers = check_workers(self.workers)
        make_folder(out)
        began = time.monotonic()
        first, others = size.driver_job(out), size.hmi_jobs(out)
        train_all([first], 1, typed)
        train_all(others, workers, typed)
        trained = time.monotonic()
        total = reproduction.cells_in_all() * size.episodes
        with tqdm(total=total, unit=" episodes", desc="playing") as bar:
            tables = [
                reproduction.play_table(variant, size, out, workers, bar.update)
                for variant in VARIANTS
            ]
        seconds = {
            f"training {name}": spent
            for name, spent in reproduction.seconds_of([first, *others]).items()
        }
        seconds["all training of this call, side by side"] = trained - began
        seconds["playing"] = time.monotonic() - trained
        text = reproduction_report.as_text(tables, seconds)
        write_text(out / "table.txt", text + "\n")
        content = reproduction_report.as_json(tables, seconds)
        write_json(out / "table.json", content | {"command": typed, "settings": vars(size)})
        drawing = reproduction_report.figure(tables)
        write_bytes(out / "table.png", drawing)
        page = out / "index.html"
        write_text(page, reproduction_report.as_html(tables, seconds, drawing, typed, vars(size)))
        print(text)
        print(f"\nthe page: {page.resolve().as_uri()}")


@dataclass(frozen=True)
class ReproduceDriver:
    """How drivers without distraction learn to drive: speed, crashes and headway by steps.

    Example: hmi-marl reproduce driver --steps 18_000_000
    """

    steps: int = 18_000_000
    """Environment steps to learn from."""
    snapshots: int = 6
    """At how many points on the way to look."""
    episodes: int = 2000
    """Episodes of each driver at each point."""
    seed: int = 0
    """Of the training."""
    out: Path = Path("runs/reproduce/driver")
    """Folder."""

    def run(self, typed: str) -> None:
        """Learn, play, write and print."""
        use_quiet_threads()
        for name in ("steps", "snapshots", "episodes"):
            check_count(name, getattr(self, name))
        drivers = attentive.CONFIDENT, attentive.CAUTIOUS
        settings = TwoStage(
            drivers=tuple(reproduction.spec(driver) for driver in drivers),
            driver_steps=self.steps,
            hmi_steps=0,
            seed=self.seed,
            snapshots=self.snapshots,
        )
        make_folder(self.out)
        train_all([Job(settings, self.out)], 1, typed)
        points = sorted((int(path.name), path) for path in (self.out / "snapshots").iterdir())
        rows = [
            attentive.assess(path, steps, driver, self.episodes, reproduction.EVALUATION_SEED)
            for steps, path in tqdm(points, desc="playing")
            for driver in drivers
        ]
        verdicts = attentive.verdicts(*rows[-2:])
        print(attentive.as_text(rows, verdicts))
        content = {"rows": [row.as_json() for row in rows], "verdicts": verdicts}
        write_json(self.out / "driver.table.json", content | {"command": typed})


@dataclass(frozen=True)
class ReproduceHidden:
    """HMIs that do not see attention: learned ones beside Bayes filters, driver by driver.

    Example: hmi-marl reproduce hidden --driver-run runs/reproduce/table/driver
    """

    size: tyro.conf.OmitArgPrefixes[HiddenSettings] = field(default_factory=HiddenSettings)
    """How large."""
    driver_run: Path | None = None
    """A trained run whose driver to take; without it one is trained here."""
    workers: int | None = None
    """Trainings at a time; all cores by default. Does not change results."""
    out: Path = Path("runs/reproduce/hidden")
    """Folder."""

    def run(self, typed: str) -> None:
        """Learn what is not learnt yet, play, write and print."""
        use_quiet_threads()
        workers = check_workers(self.workers)
        make_folder(self.out)
        driver_run = self.driver_run
        if driver_run is None:
            job = self.size.driver_job(self.out)
            driver_run = job.folder
            train_all([job], 1, typed)
        train_all(self.size.hmi_jobs(self.out, driver_run), workers, typed)
        with tqdm(total=len(hidden.MODELS), unit=" drivers", desc="playing") as bar:
            rows = hidden.compare_hidden(self.size, self.out, driver_run, lambda name: bar.update())
        print(hidden.as_text(rows))
        content = {"rows": [row.as_json() for row in rows], "settings": vars(self.size)}
        write_json(self.out / "hidden.json", content | {"command": typed})


@dataclass(frozen=True)
class ReproduceTraits(TraitReproduction):
    """Latent traits: collect demonstrations, learn the paper's three settings, judge them.

    Goes on where it was cut off. With --seeds 5 every setting is learnt five times, and accuracies
    and KL get intervals.

    Example: hmi-marl reproduce traits --driver-run runs/reproduce/table/driver
    """

    driver_run: Path | None = None
    """A trained run whose driver to take; without it one is trained here."""
    workers: int | None = None
    """Trainings at a time; all cores by default. Does not change results."""
    out: Path = Path("runs/reproduce/traits")
    """Folder."""

    def run(self, typed: str) -> None:
        """Do what is not done yet, judge, write and print."""
        use_quiet_threads()
        workers = check_workers(self.workers)
        need_training()
        from hmi_marl.evaluation.trait_reproduction import (
            Stopwatch,
            assess_runs,
            collect_datasets,
            learn_all,
            seconds_of,
            write_report,
        )

        make_folder(self.out)
        size = only(TraitReproduction, self)
        watch = Stopwatch()
        driver_run = self.driver_run
        if driver_run is None:
            job = size.driver_job(self.out)
            driver_run = job.folder
            train_all([job], 1, typed)
            watch.seconds["training the driver"] = job.curve()[-1]["seconds"]
        with watch.timing("collecting"):
            collect_datasets(size, driver_run, self.out)
        with watch.timing("all training of this call, side by side"):
            learn_all(size, self.out, workers, typed)
        with watch.timing("judging"):
            runs = list(size.trainings(self.out))
            assessments, pools = assess_runs(
                runs,
                self.out / DEMONSTRATIONS,
                self.out / POPULATION,
                str(driver_run),
                size.judge,
            )
        seconds = seconds_of(runs) | watch.seconds
        print(write_report(self.out, assessments, pools, seconds, typed, plain(size)))
        print(f"\nthe page: {(self.out / 'index.html').resolve().as_uri()}")


What = (
    Annotated[ReproduceTable, tyro.conf.subcommand("table")]
    | Annotated[ReproduceDriver, tyro.conf.subcommand("driver")]
    | Annotated[ReproduceHidden, tyro.conf.subcommand("hidden")]
    | Annotated[ReproduceTraits, tyro.conf.subcommand("traits")]
)


@dataclass(frozen=True)
class Reproduce:
    """Make what the paper shows again, with the exact values and a verdict beside each number."""

    what: Annotated[tyro.conf.OmitSubcommandPrefixes[What], tyro.conf.arg(prefix_name=False)]
    """Which part of it."""

    def run(self, typed: str) -> None:
        """Make it."""
        self.what.run(typed)
