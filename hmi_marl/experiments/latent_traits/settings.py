"""How large the experiments on latent traits are, in frozen dataclasses that import no torch."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

from hmi_marl.checks import check_count
from hmi_marl.demonstrations.recording import CollectSettings
from hmi_marl.envs.drivers import PAPER_DRIVERS
from hmi_marl.envs.streams import check_seed
from hmi_marl.experiments.metrics_table.reproduction import driver_job
from hmi_marl.training.runs.jobs import Job
from hmi_marl.training.traits.settings import Supervision, TraitSettings

SUPERVISIONS: tuple[Supervision, ...] = ("none", "id", "preference")
DEMONSTRATIONS, POPULATION = "demonstrations", "population"
FEWEST_STRANGERS = 4
"""Whom nothing was learned from: two to fit a regression by, and two to judge it by."""
_FRESH = 1
"""Added to the seed for the population's episodes."""


@dataclass(frozen=True)
class AssessSettings:
    """How much each model is tried.

    Raises:
        ValueError: nothing of something.
    """

    windows: int = 800
    """Most windows of each driver, learned from or held out, that are encoded."""
    episodes: int = 200
    """That the policy drives with each driver's z."""
    ranked: int = 100
    """Held-out windows of each driver by which the recovered reward is judged."""
    seed: int = 1_000_000
    """Of those episodes and of all that is drawn."""

    def __post_init__(self) -> None:
        for name in ("windows", "episodes", "ranked"):
            check_count(name, getattr(self, name))
        if self.ranked < 2:
            raise ValueError("two windows can be ranked, but not one: ranked is at least 2")


@dataclass(frozen=True)
class TraitReproduction:
    """How large the reproduction is.

    Raises:
        ValueError: nothing of something.
    """

    driver_steps: int = 4_000_000
    """Environment steps in which the driver learns, unless one is given."""
    demonstrated: int = 300_000
    """Steps demonstrated by each driver."""
    population: int = 200
    """Unseen drivers, over whom traits are regressed."""
    learn: TraitSettings = field(default_factory=TraitSettings)
    """How each setting is learned; supervision and seed are set for each."""
    seed: int = 0
    """Of the driver, the demonstrations and the first learning of each setting."""
    seeds: int = 1
    """Times that each setting is learned."""
    judge: AssessSettings = field(default_factory=AssessSettings)
    """How much each model is tried."""

    def __post_init__(self) -> None:
        for name in ("driver_steps", "demonstrated", "population", "seeds"):
            check_count(name, getattr(self, name))
        object.__setattr__(self, "seed", check_seed(self.seed))
        if (self.learn.supervision, self.learn.seed) != ("none", 0):
            raise ValueError(
                "every supervision is learned, from --seed on: leave out "
                "--learn.supervision and --learn.seed"
            )
        if self.population < FEWEST_STRANGERS:
            raise ValueError(
                f"traits are regressed over {FEWEST_STRANGERS} drivers or more, but got "
                f"population = {self.population}"
            )

    def driver_job(self, folder: Path) -> Job:
        """One driver policy, conditioned on traits, over the four drivers."""
        return driver_job(PAPER_DRIVERS, self.driver_steps, 512, self.seed, folder)

    def datasets(self, driver_run: Path) -> dict[str, CollectSettings]:
        """What to collect, by folder."""
        common = CollectSettings(driver_policy=str(driver_run), seed=self.seed)
        return {
            DEMONSTRATIONS: replace(common, steps=self.demonstrated),
            POPULATION: replace(
                common,
                drivers=(),
                population=self.population,
                windows=max(common.windows, 2 * self.learn.pool),
                seed=self.seed + _FRESH,
            ),
        }

    def trainings(self, folder: Path) -> dict[Path, TraitSettings]:
        """What to learn, by folder; the first seed of each setting comes first."""
        return {
            folder / f"traits-{supervision}{'' if seed == 0 else f'-{seed}'}": replace(
                self.learn, supervision=supervision, seed=self.seed + seed
            )
            for seed in range(self.seeds)
            for supervision in SUPERVISIONS
        }
