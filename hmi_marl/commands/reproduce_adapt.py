"""``hmi-marl reproduce adapt``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from hmi_marl.agents.adaptive.factory import Trained
from hmi_marl.commands.fields import only
from hmi_marl.commands.train import use_quiet_threads
from hmi_marl.experiments.adaptation.settings import AdaptReproduction
from hmi_marl.workers import check_workers


@dataclass(frozen=True)
class ReproduceAdapt(AdaptReproduction):
    """Learn the encoder and the HMI conditioned on z for unknown drivers; judge both.

    Goes on by itself where it was cut off.

    Example: hmi-marl reproduce adapt
    """

    driver_run: Path = Path("trained:driver")
    """Whose driver to take: a trained run, or one that comes with the package."""
    hidden: str = Trained().hidden
    """The HMIs that do not see attention, {} standing for the driver model."""
    workers: int | None = None
    """Processes at a time; all cores by default. Does not change results."""
    out: Path = Path("runs/reproduce/adapt")
    """Folder."""

    def run(self, command_line: str) -> None:
        """Learn what is not learned yet, play, write and print."""
        use_quiet_threads()
        from hmi_marl.experiments.adaptation.stage import AdaptStage
        from hmi_marl.experiments.stages import Place

        place = Place(self.out, self.driver_run, check_workers(self.workers), command_line)
        size = only(AdaptReproduction, self)
        print(AdaptStage(size, self.hidden).run(place).text)
        print(f"\nthe page: {(self.out / 'index.html').resolve().as_uri()}")
