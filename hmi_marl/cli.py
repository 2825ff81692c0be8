"""The ``hmi-marl`` command: parse, call, print."""

from __future__ import annotations

import os
import shlex
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Annotated

import tyro
from tqdm import tqdm

import hmi_marl
from hmi_marl.agents import DRIVER_POLICY_NAMES, HMI_NAMES, oracle
from hmi_marl.envs.attention import check_window
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import DRIVERS, get_driver
from hmi_marl.envs.scene import Scene
from hmi_marl.evaluation import clip, report
from hmi_marl.evaluation.alert_report import alert_report
from hmi_marl.evaluation.bench_config import BenchConfig
from hmi_marl.evaluation.table import TableConfig, TableSettings, check_workers, make_table
from hmi_marl.files import make_folder, write_json

CLIP_FRAMES_PER_STEP = 2
WINDOW_FRAMES_PER_STEP = 6

BAD_INPUT, INTERRUPTED, NOBODY_READS = 2, 130, 141
"""Exit statuses; the last two are what the shell reports after SIGINT and SIGPIPE."""
ERRORS = (ArithmeticError, ImportError, MemoryError, OSError, RuntimeError, TypeError, ValueError)
"""Told in one line. Whatever else is raised is a fault of ours, and shows its trace."""


@dataclass(frozen=True)
class Bench:
    """How fast the worlds are, side by side in one run, as ratios to highway-env's own step.

    Example: hmi-marl bench --teams 1024 --threads 1 2
    """

    bench: tyro.conf.OmitArgPrefixes[BenchConfig] = field(default_factory=BenchConfig)
    """What to measure."""
    out: Path = Path("runs/bench")
    """Folder for the JSON."""

    def run(self, typed: str) -> None:
        """Measure, write and print."""
        from hmi_marl.evaluation import bench

        self.bench.check()
        make_folder(self.out)
        with tqdm(total=bench.measurements(self.bench), unit=" turns", desc="bench") as bar:
            rows = bench.bench(self.bench, bar.update)
        write_json(self.out / "bench.json", bench.as_json(self.bench, rows) | {"command": typed})
        print(bench.as_text(rows))
        print(f"\nwritten: {self.out / 'bench.json'}")


@dataclass(frozen=True)
class Oracle:
    """The exact optimum of the alert problem for one driver, and the audit of the paper's table.

    Example: hmi-marl oracle --driver bart --window 7 --horizon 100
    """

    driver: str = "homer"
    """lisa, marge, bart, homer or average."""
    window: int = oracle.DEFAULT_WINDOW
    """N, for how many steps an alert stays in effect."""
    horizon: int = oracle.DEFAULT_HORIZON
    """Steps in an episode (5 per second)."""
    out: Path = Path("runs/oracle")
    """Folder for the JSON."""

    def run(self, typed: str) -> None:
        """Solve, write and print."""
        driver, window = get_driver(self.driver), check_window(self.window)
        horizon = oracle.check_horizon(self.horizon)
        make_folder(self.out)
        found = alert_report(driver, window, horizon)
        path = self.out / f"{driver.name}-window{window}-horizon{horizon}.json"
        write_json(path, found.as_json())
        print(found.as_text())
        print(f"\nwritten: {path}")


@dataclass(frozen=True)
class Watch:
    """Watch one episode: as a clip with --out, else in a window.

    Example: hmi-marl watch --driver homer --hmi optimal --out clip.gif
    """

    driver: str = "homer"
    """lisa, marge, bart, homer or average."""
    hmi: str = "optimal"
    """never, always, random[:RATE], when-distracted, optimal[:DRIVER], average, belief[:DRIVER]."""
    policy: str = "rule"
    """Who steers: rule or random."""
    seed: int = 0
    """Of the episode."""
    out: Path | None = None
    """A .gif, or an .mp4 with the video extra. Without it a window opens."""
    perceived: bool = False
    """Draw the other vehicles as large as the driver perceives them."""
    hide_attention: bool = False
    """The HMI does not see whether the driver is distracted."""
    alert_window: int = 7
    """N, for how many steps an alert stays in effect."""
    end_at_crash: bool = True
    """Whether a crash ends the episode."""
    vehicles: tuple[int, int] = (1, 20)
    """Least and most other vehicles."""
    duration: float = 20.0
    """Length of the episode [s]."""

    def run(self, typed: str) -> None:
        """Play, and draw as it goes."""
        config = TeamConfig(
            driver=get_driver(self.driver),
            ai_sees_attention=not self.hide_attention,
            alert_window=self.alert_window,
            end_at_crash=self.end_at_crash,
            duration=self.duration,
            scene=Scene(vehicles=self.vehicles),
        )
        moments = clip.episode(config, self.hmi, self.policy, self.seed)
        if self.out is None:
            clip.show(config, moments, WINDOW_FRAMES_PER_STEP, self.perceived)
            return
        make_folder(clip.check_suffix(self.out).parent)
        total = config.horizon * CLIP_FRAMES_PER_STEP + 1
        with tqdm(total=total, unit=" frames", desc=self.out.name) as bar:

            def counted(pictures: clip.Pictures) -> clip.Pictures:
                for picture in pictures:
                    bar.update()
                    yield picture

            clip.record(self.out, config, moments, CLIP_FRAMES_PER_STEP, self.perceived, counted)
        print(f"written: {self.out}")


@dataclass(frozen=True)
class Table:
    """Compare HMIs (rows) for drivers (columns) over seeded episodes, on highway-env by default.

    Writes text, CSV, JSON and an HTML page with a figure and a clip.

    Example: hmi-marl table --hmis NoHMI AvgHMI own --drivers bart homer --episodes 20
    """

    table: tyro.conf.OmitArgPrefixes[TableSettings] = field(default_factory=TableSettings)
    """What is in the table."""
    workers: int | None = None
    """Processes to share the episodes among; all cores by default. Does not change results."""
    clip: bool = True
    """Record a clip for the page, of the last driver with the last HMI."""
    out: Path = Path("runs/table")
    """Folder for everything that is written."""

    def run(self, typed: str) -> None:
        """Play, sum up, write and print; the page says what was ``typed``."""
        config, workers = TableConfig(**vars(self.table)), check_workers(self.workers)
        make_folder(self.out)
        total = config.episodes * len(config.drivers) * len(config.hmis)
        with tqdm(total=total, unit=" episodes", desc="table") as bar:
            cells = make_table(config, workers, bar.update)
        record = partial(_record, config) if self.clip else None
        page = report.write_report(self.out, config, cells, record, typed)
        print(report.as_text(config, cells))
        print(f"\n{report.NOTE}\n\nthe page: {page.resolve().as_uri()}")


def _record(config: TableConfig, path: Path) -> None:
    team = config.team(config.drivers[-1])
    moments = clip.episode(team, config.hmis[-1], config.driver_policy, config.seed, config.world)
    clip.record(path, team, moments, CLIP_FRAMES_PER_STEP)


Command = (
    Annotated[Bench, tyro.conf.subcommand("bench")]
    | Annotated[Oracle, tyro.conf.subcommand("oracle")]
    | Annotated[Table, tyro.conf.subcommand("table")]
    | Annotated[Watch, tyro.conf.subcommand("watch")]
)


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


def _run(arguments: list[str]) -> None:
    if arguments == ["--version"]:
        print(f"hmi-marl {hmi_marl.__version__}")
        return
    try:
        command = tyro.cli(
            Command, prog="hmi-marl", description=_description(), args=arguments or ["--help"]
        )
        command.run(shlex.join(["hmi-marl", *arguments]))
    finally:
        sys.stdout.flush()  # here, where a broken pipe can still be dealt with


if __name__ == "__main__":
    sys.exit(main())
