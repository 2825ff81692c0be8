"""``hmi-marl adapt``."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import tyro

from hmi_marl.agents.adaptive.factory import Trained
from hmi_marl.commands.train import use_quiet_threads
from hmi_marl.experiments.adaptation.settings import QUICK, AdaptSettings
from hmi_marl.files import json_value, make_folder
from hmi_marl.workers import check_workers


@dataclass(frozen=True)
class Adapt:
    """Evaluate adaptive HMIs on unknown drivers against an HMI that knows the driver.

    Drivers of the four types, of a continuous population, and changes of driver in mid-trip, with
    attention hidden. Tells what knowing the driver is worth, how soon how much of that is earned,
    and what the exact Bayes posterior would earn. Writes text, JSON, a figure, a page and a clip.

    Example: hmi-marl adapt --quick
    """

    size: tyro.conf.OmitArgPrefixes[AdaptSettings] = field(default_factory=AdaptSettings)
    """How large."""
    quick: bool = False
    """A coarse one in a minute or two instead."""
    driver_policy: str = "trained:driver"
    """Who steers: a trained run, or trained:NAME."""
    trained: tyro.conf.OmitArgPrefixes[Trained] = field(default_factory=Trained)
    """What adaptive HMIs are made of: trained runs, or what comes with the package."""
    workers: int | None = None
    """Processes; all cores by default. Does not change results."""
    clip: bool = True
    """Also record adapt.gif: Homer takes the wheel from Bart, the belief drawn below."""
    out: Path | None = None
    """Folder; by default runs/adapt, with --quick runs/adapt-quick."""

    def run(self, command_line: str) -> None:
        """Play, write and print."""
        from tqdm import tqdm

        from hmi_marl.experiments.adaptation import evaluation as adapt
        from hmi_marl.experiments.adaptation import report as adapt_report

        use_quiet_threads()
        size = self.size
        if self.quick:
            if replace(size, seed=0) != AdaptSettings(seed=0):
                raise ValueError("--quick sets the sizes itself; leave it out to choose them")
            size = replace(QUICK, seed=size.seed)
        workers = check_workers(self.workers)
        out = self.out or Path("runs") / ("adapt-quick" if self.quick else "adapt")
        make_folder(out)
        with tqdm(total=adapt.plays(size), unit=" plays", desc="playing") as bar:
            results = adapt.evaluate(size, self.driver_policy, self.trained, workers, bar.update)
        print(adapt_report.write_report(out, results, {}, command_line, json_value(size))[0])
        if self.clip:
            from hmi_marl.experiments.adaptation.clip import record_change

            record_change(out / "adapt.gif", self.driver_policy, self.trained, size)
            print(f"\nthe clip: {out / 'adapt.gif'}")
        print(f"\nthe page: {(out / 'index.html').resolve().as_uri()}")
