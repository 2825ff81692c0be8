"""``hmi-marl compare``."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import tyro

from hmi_marl.commands.train import use_quiet_threads
from hmi_marl.experiments.experiment import Place, conduct
from hmi_marl.experiments.protocols.experiment import ProtocolComparison
from hmi_marl.experiments.protocols.plan import coarse
from hmi_marl.reporting.report import PAGE, print_page
from hmi_marl.training.cluster.cluster import connected
from hmi_marl.workers import check_workers


@dataclass(frozen=True)
class Compare:
    """Compare sequential with joint training at equal environment steps, over several seeds.

    Each protocol is trained on several tasks: attention seen, hidden, and hidden with both agents
    moving at the same time. Results stand between exact references; signals that partners learn
    are measured, and every driver plays with every HMI. Writes text, JSON, figures and an HTML
    page. The whole takes hours and is resumable: a run that is trained is not trained again.

    Example: hmi-marl compare --tasks hidden --protocols two-stage simultaneous --seeds 3
    """

    settings: tyro.conf.OmitArgPrefixes[ProtocolComparison] = field(
        default_factory=ProtocolComparison
    )
    """Protocols to compare, and sizes."""
    quick: bool = False
    """A small one instead, in minutes: attention hidden, two-stage, joint and simultaneous."""
    workers: int | None = None
    """Trainings and evaluations at a time; all cores by default. Does not change results."""
    ray: str | None = None
    """Train on a Ray cluster instead of in processes here: auto, HOST:PORT, ray://HOST:PORT, or
    local for one on this machine. By default as many trainings at a time as it has cores."""
    out: Path | None = None
    """Folder; by default runs/compare, with --quick runs/compare-quick."""

    def run(self, command_line: str) -> None:
        """Learn what is not learned yet, play, write and print."""
        use_quiet_threads()
        settings = coarse(self.settings) if self.quick else self.settings
        out = self.out or Path("runs") / ("compare-quick" if self.quick else "compare")
        workers = check_workers(self.workers)
        with connected(self.ray, self.workers) as cluster:
            place = Place(out, out, workers, command_line, cluster=cluster)
            print(conduct(settings, place).text)
        print_page(out / PAGE)
