"""``hmi-marl reproduce graded``."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import tyro

from hmi_marl.commands.train import use_quiet_threads
from hmi_marl.experiments.graded_alerts import QUICK, GradedSettings
from hmi_marl.workers import check_workers


@dataclass(frozen=True)
class ReproduceGraded:
    """Compare learned HMIs with the exact optimum: graded alerts, alert fatigue.

    Goes on by itself where it was cut off.

    Example: hmi-marl reproduce graded
    """

    size: tyro.conf.OmitArgPrefixes[GradedSettings] = field(default_factory=GradedSettings)
    """How large."""
    quick: bool = False
    """A coarse one in a minute instead, too short to reach the optimum everywhere."""
    workers: int | None = None
    """Trainings at a time; all cores by default. Does not change results."""
    out: Path | None = None
    """Folder; by default runs/reproduce/graded, with --quick runs/reproduce/graded-quick."""

    def run(self, command_line: str) -> None:
        """Learn what is not learned yet, play, write and print."""
        use_quiet_threads()
        from hmi_marl.experiments.graded_stage import GradedStage
        from hmi_marl.experiments.stages import Place

        size = self.size
        if self.quick:
            if replace(size, seed=0) != GradedSettings():
                raise ValueError("--quick sets the sizes itself; leave it out to choose them")
            size = replace(QUICK, seed=size.seed)
        out = self.out or Path("runs/reproduce") / ("graded-quick" if self.quick else "graded")
        nobody = out / "driver"  # the rule-based driver drives, so that none is to be learned
        place = Place(out, nobody, check_workers(self.workers), command_line)
        print(GradedStage(size).run(place).text)
