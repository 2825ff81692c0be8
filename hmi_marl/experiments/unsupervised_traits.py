"""Experiment "unsupervised": what names drivers without labels, by losses, budget and size of z.

Every way is the paper's unsupervised setting with one or two settings changed; labelled ones stand
next to them. All are judged as ``hmi-marl reproduce traits`` does, by a linear probe of z from
pools of held-out windows.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any

from hmi_marl.agents.learned.trait_model import load_traits
from hmi_marl.checks import Count, Names, Steps, Whole
from hmi_marl.demonstrations.dataset import Split
from hmi_marl.demonstrations.recording import CollectSettings
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.streams import Seed
from hmi_marl.experiments.criteria import NAMED_WITHOUT_LABELS
from hmi_marl.experiments.experiment import Place
from hmi_marl.experiments.latent_traits import assessment, ceiling
from hmi_marl.experiments.latent_traits.assessment import AssessSettings
from hmi_marl.experiments.latent_traits.experiment import learn_in
from hmi_marl.experiments.recordings import record
from hmi_marl.experiments.training_seeds import SeededExperiment, learned_part
from hmi_marl.files import json_value
from hmi_marl.reporting.blocks import Block, Table, Text
from hmi_marl.reporting.statistics import Estimate, number
from hmi_marl.reporting.verdicts import Part, Verdict
from hmi_marl.training.jobs import need_training, side_by_side
from hmi_marl.training.run_tasks import RunTask
from hmi_marl.training.traits.settings import (
    PAPER_HELD_OUT,
    PAPER_IMITATION,
    LossWeights,
    TraitSettings,
)

DEMONSTRATIONS = "demonstrations"
POOLS = "pools"
"""Unit of replication."""
_FULL = "full"
"""Ending of the names of ways with the full budget."""


@dataclass(frozen=True)
class Way:
    """Settings that differ from those of the paper's unsupervised setting."""

    name: str
    what: str
    """Description for a reader."""
    changes: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))
    """Fields of :class:`TraitSettings`."""


_COHESION = {"weights": LossWeights(cohesion=1.0)}
_IMITATE = {"weights": LossWeights(imitate=1.0)}
WAYS: tuple[Way, ...] = (
    Way("paper", "the paper's losses"),
    Way("cohesion", "and cohesion, weight 1", _COHESION),
    Way("imitate", "and imitation in the encoder", _IMITATE),
    Way("inform", "and log q of z in the policy's reward", {"information_reward": 1.0}),
    Way("latent-8", "the paper's losses, z of 8", {"latent": 8}),
    Way("cohesion-8", "and cohesion, z of 8", _COHESION | {"latent": 8}),
    Way("imitate-8", "and imitation, z of 8", _IMITATE | {"latent": 8}),
    Way("id", "a fifth labelled by driver", {"supervision": "id"}),
    Way("preference", "a fifth labelled by preference", {"supervision": "preference"}),
    Way(f"paper-8-cars-{_FULL}", "the paper's losses, full budget of 8 cars", {"num_teams": 8}),
    Way(f"paper-{_FULL}", "the paper's losses, full budget"),
    Way(f"imitate-{_FULL}", "and imitation, full budget", _IMITATE),
    Way(f"id-{_FULL}", "labelled by driver, full budget", {"supervision": "id"}),
    Way(f"preference-{_FULL}", "by preference, full budget", {"supervision": "preference"}),
)
BY_NAME = {each.name: each for each in WAYS}


@dataclass(frozen=True)
class Named:
    """Drivers named by the z of one way."""

    name: str
    what: str
    labelled: bool
    cars: float
    """Cars that the policy drives in a round."""
    steps: float
    """Environment steps of the policy."""
    updates: float
    """Updates of the discriminator in which something is driven."""
    latent: float
    """Size of z."""
    drivers: Estimate
    """Share of held-out pools whose driver is named right, by a linear probe."""
    nearest: Estimate
    """The same by the nearest mean of a driver's vectors."""
    average_kl: float
    """Average KL between drivers [nats]."""


@dataclass(frozen=True)
class WaysResults:
    """Results of all ways."""

    ways: Sequence[Named]
    exact: Estimate | None
    """Accuracy of the exact Bayes classifier of the same pools; None if there is none."""


@dataclass(frozen=True)
class UnsupervisedTraits(SeededExperiment[WaysResults]):
    """Compare what names drivers without labels, by losses, budget and size of z.

    Raises:
        ValueError: an unknown way, or too few windows to judge by.
    """

    ways: Annotated[tuple[str, ...], Names(tuple(BY_NAME))] = tuple(BY_NAME)
    """Ways by name."""
    demonstrated: Steps = 300_000
    """Steps demonstrated by each of the four drivers."""
    steps: Steps = TraitSettings.steps
    """Environment steps of the policy by default."""
    rounds: Count = 2000
    """Rounds of the full budget, with two updates of the discriminator each."""
    imitation_updates: Count = PAPER_IMITATION
    """Updates of imitation before the policy drives."""
    recorded_seed: Annotated[int, Whole(0, 2**32 - 1)] = 0
    """Seed of the demonstrations, which all ways and training seeds read."""
    seed: Seed = 0
    """Seed of the first training, from which the others are mixed."""
    seeds: Count = 5
    """Trainings of each way."""

    name = "unsupervised"
    title = "Drivers named without labels"
    uses_driver = True
    paper = (
        "The paper's unsupervised setting learns from the adversarial and the information loss "
        "(Sec. VIII-B) until 10^6 steps, with two updates of the discriminator in each round and "
        "500 steps of the generator: 2,000 rounds and 4,000 updates. With the 64 cars of ours 10^6 "
        "steps are 157 rounds. Below, both budgets, and what else separates drivers without labels."
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        size = max(self.training(way).latent_size for way in self.chosen)
        judged = (size + 2) * TraitSettings.pool  # held-out windows of each, for a Gaussian in z
        least = round(judged / PAPER_HELD_OUT) * TeamConfig().horizon
        if self.demonstrated < least:
            raise ValueError(
                f"demonstrated is at least {least} steps to judge z of size {size} by, but got "
                f"{self.demonstrated}"
            )

    @classmethod
    def quick(cls) -> UnsupervisedTraits:
        """See :meth:`Experiment.quick`."""
        some = ("paper", "cohesion", "imitate", "latent-8")
        return cls(ways=some, demonstrated=100_000, steps=100_000, seeds=1, imitation_updates=200)

    @property
    def chosen(self) -> list[Way]:
        """Ways, in the order in which they learn."""
        return [each for each in WAYS if each.name in self.ways]

    def dataset(self, place: Place) -> CollectSettings:
        """Settings of the demonstrations."""
        policy = str(place.driver_run)
        return CollectSettings(
            steps=self.demonstrated, driver_policy=policy, seed=self.recorded_seed
        )

    def training(self, way: Way) -> TraitSettings:
        """Settings of a way's training, with the first seed."""
        base = TraitSettings(
            supervision="none",
            steps=self.steps,
            imitation_updates=self.imitation_updates,
            seed=self.seed,
        )
        found = replace(base, **way.changes)
        if not way.name.endswith(f"-{_FULL}"):
            return found
        return replace(found, steps=self.rounds * found.num_teams * TeamConfig().horizon)

    def run_of(self, way: Way, place: Place) -> Path:
        """Folder of a way's run, with the first seed."""
        return place.folder / f"{way.name}-{self.seed}"

    def by_seed(self, place: Place) -> list[tuple[UnsupervisedTraits, Place]]:
        """See :meth:`SeededExperiment.by_seed`; all write into one folder."""
        return [(alone, place) for alone, _ in super().by_seed(place)]

    def learn(self, each: Sequence[tuple[UnsupervisedTraits, Place]], place: Place) -> None:
        """Record, then learn what is not learned yet, seed by seed."""
        need_training()
        with place.watch.timing("collecting"):
            record({DEMONSTRATIONS: self.dataset(place)}, place.driver_run, place.folder)
        data = (place.folder / DEMONSTRATIONS).absolute()
        runs = {
            alone.run_of(way, place): alone.training(way)
            for alone, _ in each
            for way in self.chosen
        }
        tasks = [
            RunTask(learn_in, (settings, place.command_line), folder, (data,))
            for folder, settings in runs.items()
        ]
        with place.watch.timing("all training of this call, in parallel"):
            side_by_side(tasks, place.workers, place.cluster)
        place.note_training(runs)

    def _split(self, place: Place) -> Split:
        """Read the demonstrations as the runs divide them."""
        from hmi_marl.demonstrations.parquet import read_demonstrations

        data = read_demonstrations(place.folder / DEMONSTRATIONS)
        return Split.of(data, PAPER_HELD_OUT, AssessSettings.windows)

    def play(self, place: Place) -> WaysResults:
        """See :meth:`SeededExperiment.play`."""
        split = self._split(place)
        try:
            evidence = ceiling.exact_evidence(split.unseen, str(place.driver_run))
        except ceiling.NoCeilingError:
            evidence = None
        found, exact = [], None
        for way in place.each(self.chosen, "models"):
            settings = self.training(way)
            model = load_traits(self.run_of(way, place))
            sizes = (settings.pool,)
            (judged,), _ = assessment.identify_drivers(model, split, evidence, sizes)
            exact = None if judged.ceilings is None else judged.ceilings.identity
            rounds = settings.rounds(split.unseen.observed.actions.shape[1])
            found.append(
                Named(
                    way.name,
                    way.what,
                    settings.supervision != "none",
                    float(settings.num_teams),
                    float(settings.steps),
                    float(rounds * settings.updates),
                    float(settings.latent_size),
                    judged.types.linear_probe,
                    judged.types.nearest_centroid,
                    judged.types.average_kl.mean,
                )
            )
        return WaysResults(found, exact)

    def numbers_of(self, results: WaysResults) -> Mapping[str, Any]:
        """See :meth:`SeededExperiment.numbers_of`."""
        return dict(json_value(results))

    def judge_of(self, results: WaysResults) -> list[Verdict]:
        """Judge which ways without labels name enough drivers."""
        least = NAMED_WITHOUT_LABELS
        return [
            Verdict(
                f"without labels, {way.what}: {100 * least:g} % of drivers named",
                (
                    learned_part(
                        "drivers named",
                        way.drivers,
                        self.seeds,
                        POOLS,
                        alone=Part.share,
                        above=least,
                        form="z.1%",
                    ),
                ),
            )
            for way in results.ways
            if not way.labelled
        ]

    def blocks_of(self, results: WaysResults) -> list[Block]:
        """Show what each way names."""
        columns = {
            "way": lambda way: way.what,
            "labels": lambda way: "a fifth" if way.labelled else "none",
            "cars": lambda way: f"{way.cars:.0f}",
            "steps": lambda way: f"{way.steps:,.0f}",
            "updates": lambda way: f"{way.updates:,.0f}",
            "z": lambda way: f"{way.latent:.0f}",
            "named [%]": lambda way: way.drivers.percent(),
            "by nearest mean [%]": lambda way: way.nearest.percent(),
            "average KL": lambda way: number(way.average_kl, ".3g"),
        }
        exact = "" if results.exact is None else f" (exact: {results.exact.percent()} %)"
        return [
            Text(
                "Each way learns from the four drivers' demonstrations and is judged by those held "
                "out, in pools of eight windows; a linear probe of z is fitted with the true names "
                "on the others. Updates: of the discriminator, after imitation. Intervals: 95 %, "
                "over pools, and over training seeds where there are several."
            ),
            Table.of(f"Drivers named{exact}", results.ways, columns, sources=("/ways", "/exact")),
        ]
