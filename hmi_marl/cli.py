"""The ``hmi-marl`` command: parse, call, print."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro
from tqdm import tqdm

from hmi_marl.agents import DRIVER_POLICY_NAMES, HMI_NAMES, oracle
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import DRIVERS, get_driver
from hmi_marl.envs.scene import Scene
from hmi_marl.evaluation import clip, report
from hmi_marl.evaluation.alert_report import alert_report
from hmi_marl.evaluation.files import write_json
from hmi_marl.evaluation.table import TableConfig, make_table

CLIP_FRAMES_PER_STEP = 2
WINDOW_FRAMES_PER_STEP = 6


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

    def run(self) -> None:
        """Solve, print and write."""
        found = alert_report(self.driver, self.window, self.horizon)
        print(found.as_text())
        path = self.out / f"{found.driver.name}-window{self.window}-horizon{self.horizon}.json"
        write_json(path, found.as_json())
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
    vehicles: tuple[int, int] = (1, 20)
    """Least and most other vehicles."""
    duration: float = 20.0
    """Length of the episode [s]."""

    def run(self) -> None:
        """Play, and draw as it goes."""
        config = TeamConfig(
            driver=get_driver(self.driver),
            ai_sees_attention=not self.hide_attention,
            duration=self.duration,
            scene=Scene(vehicles=self.vehicles),
        )
        moments = clip.episode(config, self.hmi, self.policy, self.seed)
        if self.out is None:
            clip.show(config, moments, WINDOW_FRAMES_PER_STEP, self.perceived)
            return
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
    """Compare HMIs (rows) for drivers (columns) over seeded episodes on highway-env.

    Writes text, CSV, JSON and an HTML page with a figure and a clip.

    Example: hmi-marl table --hmis NoHMI AvgHMI own --drivers bart homer --episodes 20
    """

    table: tyro.conf.OmitArgPrefixes[TableConfig] = field(default_factory=TableConfig)
    """What is in the table."""
    workers: int | None = None
    """Processes to share the episodes among; all cores by default. Does not change results."""
    clip: bool = True
    """Record a clip for the page, of the last driver with the last HMI."""
    out: Path = Path("runs/table")
    """Folder for everything that is written."""

    def run(self) -> None:
        """Play, sum up, print and write."""
        config = self.table
        total = config.episodes * len(config.drivers) * len(config.hmis)
        with tqdm(total=total, unit=" episodes", desc="table") as bar:
            cells = make_table(config, self.workers, bar.update)
        command = shlex.join(["hmi-marl", *sys.argv[1:]])
        record = self._record if self.clip else None
        page = report.write_report(self.out, config, cells, record, command)
        print(report.as_text(config, cells))
        print(f"\n{report.NOTE}\n\nthe page: {page.resolve().as_uri()}")

    def _record(self, path: Path) -> None:
        config = self.table
        team = config.team(config.drivers[-1])
        moments = clip.episode(
            team, config.hmis[-1], config.driver_policy, config.seed, config.world
        )
        clip.record(path, team, moments, CLIP_FRAMES_PER_STEP)


Command = (
    Annotated[Oracle, tyro.conf.subcommand("oracle")]
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
    return f"Human-AI teaming in driving: a distractible driver and their HMI.\n\n{known}"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; returns its exit status. Bad input is told in one line, without a trace."""
    try:
        command = tyro.cli(Command, prog="hmi-marl", description=_description(), args=arguments)
        command.run()
    except (ValueError, TypeError, RuntimeError) as error:
        print(f"hmi-marl: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
