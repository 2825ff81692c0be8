"""``hmi-marl sweep``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from hmi_marl.checks import Count
from hmi_marl.commands.train import use_quiet_threads
from hmi_marl.envs.drivers import PAPER_DRIVERS, DriverName
from hmi_marl.envs.streams import Seed
from hmi_marl.experiments.experiment import Place, conduct
from hmi_marl.experiments.sweep.experiment import Sweep, plan_table
from hmi_marl.reporting.report import PAGE, print_page
from hmi_marl.training.cluster.cluster import connected
from hmi_marl.workers import check_workers


@dataclass(frozen=True)
class SweepCommand:
    """Train over lists and ranges of any option of train, by protocol and seed.

    Every run plays the same evaluation episodes. Writes one table (sweep.parquet), text, JSON, a
    figure with intervals over seeds and an HTML page. Goes on by itself where it was cut off; a
    finished run is not trained again, also when values, protocols or seeds are added.

    Example: hmi-marl sweep joint simultaneous --over steps=1e6,2e6 ppo.learning_rate=1e-3,2e-3
    """

    protocols: Annotated[
        tyro.conf.Positional[tuple[str, ...]], tyro.conf.arg(metavar="PROTOCOL [PROTOCOL ...]")
    ]
    """Protocols to train by; hmi-marl train --help lists them."""
    over: tuple[str, ...] = ()
    """Options of train: NAME=VALUE,VALUE is a list, NAME=FROM..TO/COUNT a range with equal steps,
    NAME=FROM..TO/COUNT/log one with equal ratios, NAME=VALUE one value for all runs. Groups as in
    ppo.gamma, several parts as in drivers=lisa+homer, PROTOCOL:NAME=... for one protocol alone.
    steps is the total of all stages, of which driver_share (0.8) is the driver's."""
    seeds: Count = 3
    """Runs of each combination of values."""
    seed: Seed = 0
    """Seed of the first run of each combination; those of the others are mixed from it."""
    episodes: Count = 500
    """Evaluation episodes of each run with each driver."""
    drivers: tuple[DriverName, ...] = PAPER_DRIVERS
    """Drivers of the evaluation: known names, or name:beta,alpha,eta,inflation."""
    dry_run: bool = False
    """Print the plan, and what of it is done, instead."""
    workers: int | None = None
    """Runs at a time; all cores by default. Does not change results."""
    ray: str | None = None
    """Train on a Ray cluster instead of in processes here: auto, HOST:PORT, ray://HOST:PORT, or
    local for one on this machine. By default as many trainings at a time as it has cores."""
    out: Path = Path("runs/sweep")
    """Folder, with a folder for each run."""

    def run(self, command_line: str) -> None:
        """Train what is not trained yet, play, write and print."""
        use_quiet_threads()
        sweep = Sweep(self.protocols, self.over, self.seeds, self.seed, self.episodes, self.drivers)
        workers = check_workers(self.workers)
        if self.dry_run:
            print(plan_table(sweep, self.out).as_text())
            return
        with connected(self.ray, self.workers) as cluster:
            place = Place(self.out, self.out, workers, command_line, cluster=cluster)
            print(conduct(sweep, place).text)
        print_page(self.out / PAGE)
