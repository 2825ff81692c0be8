"""``hmi-marl adapt``."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import tyro

from hmi_marl.agents.adaptive.hmis import Trained
from hmi_marl.commands.train import use_quiet_threads
from hmi_marl.experiments.adaptation.evaluation import QUICK, AdaptSettings
from hmi_marl.ownership import owned
from hmi_marl.reporting.report import PAGE, print_page
from hmi_marl.workers import check_workers


@dataclass(frozen=True)
class Adapt:
    """Evaluate adaptive HMIs on unknown drivers against an HMI that knows the driver.

    Drivers of the four types, of a continuous population, and changes of driver in mid-trip, with
    attention hidden. Measures what knowing the driver is worth, how much of that is earned and how
    soon, and what the exact Bayes posterior would earn. Writes text, JSON, a figure, a page and a
    clip.

    Example: hmi-marl adapt --quick
    """

    size: tyro.conf.OmitArgPrefixes[AdaptSettings] = field(default_factory=AdaptSettings)
    """Size of the evaluation."""
    quick: bool = False
    """A coarse one in a minute or two instead."""
    driver_policy: str = "trained:driver"
    """Driver policy: a trained run, or trained:NAME."""
    trained: tyro.conf.OmitArgPrefixes[Trained] = field(default_factory=Trained)
    """Trained runs that adaptive HMIs use, or what comes with the package."""
    workers: int | None = None
    """Processes; all cores by default. Does not change results."""
    clip: bool = True
    """Also record adapt.gif: Homer takes the wheel from Bart, the belief drawn below."""
    out: Path | None = None
    """Folder; by default runs/adapt, with --quick runs/adapt-quick."""

    def run(self, command_line: str) -> None:
        """Play, write and print."""
        use_quiet_threads()
        from hmi_marl.experiments.adaptation.experiment import AdaptEvaluation, record_change
        from hmi_marl.experiments.experiment import Place, coarse, conduct

        size = coarse(self.size, QUICK) if self.quick else self.size
        workers = check_workers(self.workers)
        out = self.out or Path("runs") / ("adapt-quick" if self.quick else "adapt")
        place = Place(out, Path(self.driver_policy), workers, command_line)
        print(conduct(AdaptEvaluation(size, self.trained), place).text)
        if self.clip:
            with owned(out):
                record_change(out / "adapt.gif", self.driver_policy, self.trained, size)
            print(f"\nthe clip: {out / 'adapt.gif'}")
        print_page(out / PAGE)
