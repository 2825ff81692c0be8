"""Every table and figure of the paper in one folder, and the one report of them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

from hmi_marl.envs.streams import check_seed
from hmi_marl.experiments.adaptation.settings import QUICK as QUICK_JUDGING
from hmi_marl.experiments.adaptation.settings import AdaptReproduction
from hmi_marl.experiments.adaptation.stage import AdaptStage
from hmi_marl.experiments.attentive_drivers import AttentiveSettings
from hmi_marl.experiments.graded_alerts import QUICK as QUICK_GRADED
from hmi_marl.experiments.graded_alerts import GradedSettings
from hmi_marl.experiments.graded_stage import GradedStage
from hmi_marl.experiments.hidden_attention import HiddenSettings
from hmi_marl.experiments.latent_traits.settings import AssessSettings, TraitReproduction
from hmi_marl.experiments.metrics_table.reproduction import DRIVER_RUN, ReproductionSettings
from hmi_marl.experiments.paper_stages import DriverStage, HiddenStage, TableStage, TraitsStage
from hmi_marl.experiments.stages import Stage, run_stages
from hmi_marl.reproduction.report import write_full_report
from hmi_marl.training.traits.settings import TraitSettings


@dataclass(frozen=True)
class FullSettings:
    """How large each part is."""

    table: ReproductionSettings = field(default_factory=ReproductionSettings)
    """HMIs and drivers."""
    driver: AttentiveSettings = field(default_factory=AttentiveSettings)
    """Drivers without distraction."""
    hidden: HiddenSettings = field(default_factory=HiddenSettings)
    """Attention hidden."""
    adapt: AdaptReproduction = field(default_factory=AdaptReproduction)
    """Drivers who are not known."""
    traits: TraitReproduction = field(default_factory=TraitReproduction)
    """Latent traits."""
    graded: GradedSettings = field(default_factory=GradedSettings)
    """Graded alerts."""

    def with_seed(self, seed: int) -> FullSettings:
        """The same from another seed."""
        seed = check_seed(seed)
        return FullSettings(**{name: replace(part, seed=seed) for name, part in vars(self).items()})

    def stages(self) -> tuple[Stage, ...]:
        """In the order in which they run; the first learns the driver that others share."""
        return (
            TableStage(self.table),
            DriverStage(self.driver),
            HiddenStage(self.hidden),
            AdaptStage(self.adapt),
            TraitsStage(self.traits),
            GradedStage(self.graded),
        )


QUICK_TABLE = ReproductionSettings(driver_steps=1_000_000, hmi_steps=300_000, episodes=400)
QUICK = FullSettings(
    table=QUICK_TABLE,
    driver=AttentiveSettings(steps=1_500_000, snapshots=3, episodes=400),
    hidden=HiddenSettings(hmi_steps=400_000, episodes=400),
    adapt=AdaptReproduction(
        drives=2000,
        updates=300,
        hmi_steps=400_000,
        judge=QUICK_JUDGING,
    ),
    traits=TraitReproduction(
        demonstrated=100_000,
        population=60,
        learn=TraitSettings(steps=150_000, imitation_updates=200),
        judge=AssessSettings(windows=200, episodes=60, ranked=40),
    ),
    graded=QUICK_GRADED,
)
"""A coarse one, in minutes."""


def reproduce_all(
    settings: FullSettings, folder: Path, workers: int, command_line: str, told: str
) -> Path:
    """Do what is not done yet, and write the report; returns its page.

    Args:
        settings: how large.
        folder: of the whole.
        workers: trainings and evaluations at a time. Does not change results.
        typed: the command, kept with what is learned.
        told: the command as the report tells it, without what does not change results.

    Raises:
        ValueError: the folder holds another run, or a file there has been altered.
    """
    stages, shared = settings.stages(), shared_driver(folder)
    return write_full_report(
        folder, run_stages(stages, folder, shared, workers, command_line), told
    )


def shared_driver(folder: Path) -> Path:
    """The run of the driver policy that the stages share."""
    return folder / TableStage.name / DRIVER_RUN
