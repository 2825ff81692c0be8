"""Experiment "ablations": the self-supervised encoder with one part changed at a time.

Only the encoder is learned, as the self-supervised setting does before anything drives: no reward
and no policy. All variants and training seeds read the same recordings.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

from hmi_marl.checks import Count, CountOrZero, Names, Whole
from hmi_marl.demonstrations.recording import CollectSettings
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.streams import Seed, part_seed
from hmi_marl.experiments.experiment import Place
from hmi_marl.experiments.recordings import record
from hmi_marl.experiments.trait_ablations.exact import exact_r2
from hmi_marl.experiments.trait_ablations.judging import (
    JUDGED,
    MANY,
    NAMED,
    STRANGERS,
    Judged,
    Trial,
    score,
)
from hmi_marl.experiments.trait_ablations.report import AblationReport
from hmi_marl.experiments.trait_ablations.rows import AblationResults, rows_of
from hmi_marl.experiments.trait_ablations.variants import (
    BASELINE,
    BY_NAME,
    POOLS,
    VARIANTS,
    Variant,
)
from hmi_marl.training.jobs import need_training
from hmi_marl.training.traits.settings import TraitSettings
from hmi_marl.workers import calls

RECORDINGS, PARTS = "recordings", "parts"
"""Folders of what is recorded and of what has been found, below that of the experiment."""
_JUDGED_PART, _NAMED_PART = 2**32 + 5, 2**32 + 6
"""Parts of the seed of the recordings."""
_POOL = TraitSettings.pool


@dataclass(frozen=True)
class TraitAblations(AblationReport):
    """Learn the self-supervised encoder again with one part changed at a time, and compare.

    Raises:
        ValueError: an unknown variant, or too few strangers or windows.
    """

    variants: Annotated[tuple[str, ...], Names(tuple(BY_NAME), BASELINE.name)] = tuple(BY_NAME)
    """Variants by name."""
    strangers: Annotated[int, Whole(2, 100_000)] = 2000
    """Strangers that all but the variants of the population learn from."""
    windows: Annotated[int, Whole(2, 1000)] = 2 * _POOL
    """Windows of 20 s of each of them."""
    judged: Annotated[int, Whole(4, 100_000)] = 1000
    """Other strangers: one half fits the probes, the other half is judged."""
    named: Annotated[int, Whole(_POOL + max(POOLS), 1_000_000)] = 600
    """Windows of each of the four types that are named."""
    average_updates: CountOrZero = TraitSettings.average_updates
    """Updates of the average driver's policy."""
    encoder_updates: Count = TraitSettings.encoder_updates
    """Updates of each encoder."""
    drivers_per_update: Annotated[int, Whole(2, 100_000)] = TraitSettings.drivers_per_update
    """Drivers in each of these."""
    posteriors: CountOrZero = 100
    """Judged strangers whose exact posterior stands next to the encoders; 0 to leave it out."""
    recorded_seed: Annotated[int, Whole(0, 2**32 - 1)] = 0
    """Seed of the recordings, which all variants and training seeds read."""
    seed: Seed = 0
    """Seed of the first training, from which the others are mixed."""
    seeds: Count = 3
    """Trainings of each variant."""

    uses_driver = True

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (self.posteriors == 0 or 3 <= self.posteriors <= self.judged // 2):
            raise ValueError(
                "posteriors are of the judged half of the strangers: 0, or 3 to "
                f"{self.judged // 2}, not {self.posteriors}"
            )
        for variant in self.chosen:
            if (variant.windows or 0) > self.windows:
                raise ValueError(
                    f"windows is at least {variant.windows} for {variant.name!r}, but got "
                    f"{self.windows}"
                )

    @classmethod
    def quick(cls) -> TraitAblations:
        """See :meth:`Experiment.quick`."""
        some = ("loss-cosine", "pooling-maximum", "inputs-no-state", "latent-2", "strangers-100")
        return cls(
            variants=(BASELINE.name, *some),
            strangers=300,
            judged=200,
            named=96,
            average_updates=100,
            encoder_updates=60,
            posteriors=0,
            seeds=1,
        )

    @property
    def chosen(self) -> list[Variant]:
        """Variants, in the order in which they learn."""
        return [each for each in VARIANTS if each.name in self.variants]

    def datasets(self, place: Place) -> dict[str, CollectSettings]:
        """Return what to record, by folder; that of many strangers only if it is needed."""
        people = CollectSettings(
            drivers=(),
            population=self.strangers,
            windows=self.windows,
            driver_policy=str(place.driver_run),
            seed=self.recorded_seed,
        )
        judged, named = (
            int(part_seed(self.recorded_seed, part)) for part in (_JUDGED_PART, _NAMED_PART)
        )
        most = max(each.strangers or 0 for each in self.chosen)
        many = {MANY: replace(people, population=most)} if most > self.strangers else {}
        return {
            NAMED: CollectSettings(
                steps=self.named * TeamConfig().horizon,
                driver_policy=str(place.driver_run),
                seed=named,
            ),
            JUDGED: replace(people, population=self.judged, windows=max(POOLS), seed=judged),
            STRANGERS: people,
            **many,
        }

    def trial(self, variant: Variant) -> Trial:
        """Return what is to be learned and judged of a variant, with the first seed."""
        settings = TraitSettings(
            latent=variant.latent,
            average_updates=self.average_updates,
            encoder_updates=self.encoder_updates,
            drivers_per_update=self.drivers_per_update,
            seed=self.seed,
        )
        strangers = variant.strangers or self.strangers
        return Trial(
            variant.design,
            settings,
            MANY if strangers > self.strangers else STRANGERS,
            strangers,
            variant.windows or self.windows,
            POOLS if variant is BASELINE else (_POOL,),
        )

    def check(self, place: Place) -> None:
        """See :meth:`Experiment.check`."""
        super().check(place)
        if place.cluster is not None:
            raise ValueError("the encoders of ablations learn on this machine: leave --ray out")

    def by_seed(self, place: Place) -> list[tuple[TraitAblations, Place]]:
        """See :meth:`SeededExperiment.by_seed`; all write into one folder."""
        return [(alone, place) for alone, _ in super().by_seed(place)]

    def learn(self, each: Sequence[tuple[TraitAblations, Place]], place: Place) -> None:
        """Record, then learn and judge what is not judged yet, seed by seed."""
        need_training()
        recordings, datasets = place.folder / RECORDINGS, self.datasets(place)
        many = {name: datasets.pop(name) for name in (MANY,) if name in datasets}
        tasks = [
            (alone.trial(variant), recordings, alone.file(variant, where))
            for alone, where in each
            for variant in alone.chosen
        ]
        for now in filter(None, (datasets, many)):  # what takes longest, last
            own = [task for task in tasks if task[0].dataset in now]
            with place.watch.timing("recording"):
                record(now, place.driver_run, recordings)
            with place.playing(len(own), "encoders", "learning") as progress:
                for _ in calls(score, own, place.workers):
                    progress(1)
        if self.posteriors:
            with place.watch.timing("exact posteriors"):
                list(calls(exact_r2, [self._exact(place)], 1))

    def _exact(self, place: Place) -> tuple[Path, int, int, Path, Path]:
        """Arguments of :func:`exact_r2`."""
        recordings, file = place.folder / RECORDINGS, place.folder / PARTS / "exact.json"
        return recordings, self.posteriors, _POOL, place.driver_run, file

    def file(self, variant: Variant, place: Place) -> Path:
        """File of a variant's results, with the first seed."""
        return place.folder / PARTS / f"{variant.name}-{self.seed}.json"

    def play(self, place: Place) -> AblationResults:
        """See :meth:`SeededExperiment.play`; reads what has been judged."""
        recordings = place.folder / RECORDINGS
        found: dict[str, Judged] = {
            each.name: score(self.trial(each), recordings, self.file(each, place))
            for each in self.chosen
        }
        places = {
            "strangers": self.strangers,
            "windows": self.windows,
            "latent": TraitSettings().latent_size,
        }
        exact = exact_r2(*self._exact(place)) if self.posteriors else None
        return AblationResults(rows_of(found, self.chosen, places, _POOL), exact)
