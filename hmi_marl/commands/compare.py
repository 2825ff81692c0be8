"""``hmi-marl compare``."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import tyro

from hmi_marl.commands.train import use_quiet_threads
from hmi_marl.experiments.protocols.settings import CompareSettings, quick
from hmi_marl.files import make_folder
from hmi_marl.workers import check_workers


@dataclass(frozen=True)
class Compare:
    """Train by every protocol with equal environment steps and several seeds, and compare them.

    Learning curves, final returns and their terms, crashes, alerts, wall time, swapped partners,
    and whether it pays to crash. Writes text, JSON, figures and an HTML page. Goes on by itself
    where it was cut off; a trained run is not trained again.

    Example: hmi-marl compare --protocols two-stage simultaneous --steps 1_000_000 --seeds 2
    """

    size: tyro.conf.OmitArgPrefixes[CompareSettings] = field(default_factory=CompareSettings)
    """What to compare, and how large."""
    quick: bool = False
    """A coarse one instead: 300k steps, 2 seeds, 200 episodes, 128 teams."""
    workers: int | None = None
    """Trainings and evaluations at a time; all cores by default. Does not change results."""
    out: Path | None = None
    """Folder; by default runs/compare, with --quick runs/compare-quick."""

    def run(self, command_line: str) -> None:
        """Learn what is not learned yet, play, write and print."""
        use_quiet_threads()
        from tqdm import tqdm

        from hmi_marl.experiments.protocols import play as compare_play
        from hmi_marl.experiments.protocols import report as compare_report
        from hmi_marl.experiments.protocols.analysis import Comparison
        from hmi_marl.training.runs.jobs import train_all

        size = quick(self.size) if self.quick else self.size
        out = self.out or Path("runs") / ("compare-quick" if self.quick else "compare")
        workers = check_workers(self.workers)
        make_folder(out)
        train_all(size.jobs(out), workers, command_line)
        with tqdm(total=len(size.pairs()) * size.episodes, unit=" episodes", desc="playing") as bar:
            played = compare_play.play_all(size, out, workers, bar.update)
        comparison = Comparison(size, played, compare_play.read_curves(size, out), workers)
        page = compare_report.write_report(out, comparison, command_line)
        print(compare_report.as_text(comparison))
        print(f"\nthe page: {page.resolve().as_uri()}")
