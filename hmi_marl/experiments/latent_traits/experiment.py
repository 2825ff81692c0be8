"""Learn latent driver traits in the paper's three settings and self-supervised, and judge them."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from hmi_marl.agents.catalogue import make_driver_policy
from hmi_marl.agents.learned.trait_model import TraitModel, load_traits
from hmi_marl.checks import Count, Steps
from hmi_marl.demonstrations.dataset import Demonstrations
from hmi_marl.demonstrations.recording import CollectSettings
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import PAPER_DRIVERS
from hmi_marl.envs.streams import Seed, part_seed
from hmi_marl.experiments.experiment import Agent, Place, driver_job, driver_weights
from hmi_marl.experiments.latent_traits import assessment, ceiling
from hmi_marl.experiments.latent_traits.assessment import Assessment, AssessSettings
from hmi_marl.experiments.latent_traits.imitation import check_fits
from hmi_marl.experiments.latent_traits.posterior import PosteriorRow, evaluate_posteriors
from hmi_marl.experiments.latent_traits.report import TraitReport, TraitResults
from hmi_marl.experiments.latent_traits.strangers import MIN_STRANGERS, strangers_pools
from hmi_marl.files import json_value, sha256_of
from hmi_marl.ownership import owned
from hmi_marl.training.jobs import Job, need_training, own_line, side_by_side
from hmi_marl.training.run_tasks import RunTask
from hmi_marl.training.runs.folder import FREE as MACHINE
from hmi_marl.training.runs.folder import check_same
from hmi_marl.training.runs.start import check_machine
from hmi_marl.training.traits.settings import PAPER_HELD_OUT, Supervision, TraitSettings

SUPERVISIONS: tuple[Supervision, ...] = ("none", "id", "preference", "self")
"""The paper's three settings in its order, then the self-supervised one."""
DEMONSTRATIONS, POPULATION, STRANGERS = "demonstrations", "population", "strangers"
_POPULATION_PART, _STRANGERS_PART = 2**32, 2**32 + 1
"""Parts of the experiment that their episodes are; the first parts are its runs."""
_FREE = ("driver_policy", "num_teams")
"""Settings that a recorded dataset may differ in: the policy's folder (its weights are compared
instead), and memory."""


@dataclass(frozen=True)
class TraitEvaluation(TraitReport):
    """Evaluation of trained models, as ``hmi-marl traits evaluate`` runs it."""

    runs: tuple[Path, ...]
    """Folders of trained runs."""
    demonstrations: Path
    """Demonstrations that they learned from, or self-supervised ones have not learned from."""
    population: Path | None = None
    """Demonstrations of drivers that none has learned from."""
    driver_policy: str | None = None
    """Run of the driver policy of the demonstrations; by default as recorded in them."""
    size: AssessSettings = field(default_factory=AssessSettings)
    """Size of the evaluation."""

    @classmethod
    def quick(cls) -> TraitEvaluation:
        """Raise ``ValueError``: there are no default runs."""
        raise ValueError("an evaluation of trait models names the runs to evaluate")

    def check(self, place: Place) -> None:
        """See :meth:`Experiment.check`; what the runs learned from is checked in the run."""
        for run in self.runs:
            load_traits(run)
        if self.driver_policy is not None:
            make_driver_policy(self.driver_policy, TeamConfig())

    def run(self, place: Place) -> TraitResults:
        """Judge the runs on what they held out.

        The figure of embeddings is written first, long before the rest. The first model of a
        setting is judged in every respect, others by identification alone.

        Raises:
            FileNotFoundError, ValueError: no such runs or demonstrations, or runs that learned from
                other demonstrations or that pool or hold out differently.
        """
        from hmi_marl.demonstrations.parquet import read_demonstrations

        models = [load_traits(run) for run in self.runs]
        data = read_demonstrations(self.demonstrations)
        pool = models[0].card.pool
        share = self._share(models)
        _check_seeds(self.runs, models)
        split = assessment.Split.of(data, share, self.size.windows)
        windows = assessment.pool_sizes(split, pool, max(model.card.latent for model in models))
        unknown = None
        if self.population is not None:
            unknown = assessment.unseen_drivers(read_demonstrations(self.population), data)
            strangers_pools(unknown, pool)
            check_fits(models[0], unknown.observed)
        embeddings = [assessment.embed(model, split) for model in models]
        settings = [assessment.supervision_of(model) for model in models]
        found: dict[str, list[Assessment]] = {}
        parts = 1 + assessment.PARTS * len(models)
        with tqdm(total=parts, unit=" parts", desc="judging") as bar:
            exact = None
            try:
                exact = ceiling.exact_evidence(split.unseen, self.driver_policy)
            except ceiling.NoCeilingError as error:
                bar.write(str(error), file=sys.stderr)
            bar.update()
            for model, name, embedding in zip(models, settings, embeddings, strict=True):
                whole = name not in found
                one = assessment.assess(
                    model, split, exact, unknown, self.size, windows, bar.update, whole, embedding
                )
                found.setdefault(name, []).append(one)
        ordered: dict[str, list[Assessment]] = {
            name: found[name] for name in SUPERVISIONS if name in found
        }
        return TraitResults(ordered, pool, self._posterior(unknown, pool))

    def _share(self, models: Sequence[TraitModel]) -> float:
        """Share of windows that the runs held out of the demonstrations, the same for all.

        Raises:
            ValueError: they hold out or pool differently, or learned from other demonstrations, as
                only self-supervised ones may.
        """
        from hmi_marl.demonstrations.parquet import OBSERVED

        digest, first = sha256_of(self.demonstrations / OBSERVED), None
        population = None
        if self.population is not None:
            population = sha256_of(self.population / OBSERVED)
        for run, model in zip(self.runs, models, strict=True):
            held_out, learned = _learned_from(run, model)
            if learned == population:
                raise ValueError(
                    f"{run} has learned from {self.population}; name a population that it has not"
                )
            if learned == digest:
                first = first or (run, held_out)
                if held_out != first[1]:
                    raise ValueError(f"{run} holds out other windows than {first[0]}")
            elif assessment.supervision_of(model) != "self":
                raise ValueError(
                    f"{run} learned from other demonstrations than {self.demonstrations}"
                )
            if model.card.pool != models[0].card.pool:
                raise ValueError(f"{run} pools other windows than {self.runs[0]}")
        return PAPER_HELD_OUT if first is None else first[1]

    def _posterior(self, unknown: Demonstrations | None, pool: int) -> PosteriorRow | None:
        """Judge the exact posterior of some of the strangers, if there are enough."""
        count = self.size.posteriors
        if unknown is None or not count:
            return None
        judged = np.unique(unknown.observed.driver)[1::2][:count]
        some = unknown.take(np.isin(unknown.observed.driver, judged))
        try:
            return evaluate_posteriors(some, "hidden-known", pool, None, self.driver_policy)
        except ceiling.NoCeilingError:
            return None

    def settings(self) -> dict[str, Any]:
        """See :meth:`Experiment.settings`."""
        return dict(vars(self.size))


@dataclass(frozen=True)
class LatentTraits(TraitReport):
    """Learn latent traits in the paper's three settings and self-supervised, and judge them.

    With --seeds 5 every setting is learned five times, and accuracies and KL get intervals.

    Raises:
        ValueError: a size below its least, or a setting that the experiment sets itself.
    """

    driver_steps: Steps = 4_000_000
    """Environment steps in which the driver learns, unless one is given."""
    demonstrated: Steps = 300_000
    """Steps demonstrated by each driver."""
    strangers: Count = 2000
    """Drivers of a continuous population that the self-supervised setting learns from."""
    population: Count = 1000
    """Drivers of the population that nothing has learned from: one half fits the probes of traits,
    the other half is judged."""
    learn: TraitSettings = field(default_factory=TraitSettings)
    """Settings of each learning; supervision and seed are set for each."""
    seed: Seed = 0
    """Seed of the driver, the demonstrations and the first learning of each setting."""
    seeds: Count = 1
    """Times that each setting is learned."""
    evaluation: AssessSettings = field(default_factory=AssessSettings)
    """Size of the evaluation of each model."""

    uses_driver = True
    paper = (
        "The paper's figure of latent embeddings (Sec. VIII-B) has three panels: unsupervised, "
        "supervised by driver, supervised by preference, each the embeddings of the four drivers. "
        "Its source comes without the pictures; what it prints is the KL divergence averaged over "
        "pairs of driver types, 435, 4940 and 2872 nats. Below is the same figure of ours, and "
        "with every accuracy what the exact Bayes classifier of the same windows reaches."
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        default = TraitSettings()
        if (self.learn.supervision, self.learn.seed) != (default.supervision, default.seed):
            raise ValueError(
                "every supervision is learned, from --seed on: leave out "
                "--learn.supervision and --learn.seed"
            )
        if self.population < MIN_STRANGERS:
            raise ValueError(
                f"traits are regressed over {MIN_STRANGERS} drivers or more, but got "
                f"population = {self.population}"
            )
        if self.strangers < 2:
            raise ValueError("the self-supervised setting learns from two strangers or more")

    @classmethod
    def quick(cls) -> LatentTraits:
        """See :meth:`Experiment.quick`."""
        return cls(
            demonstrated=100_000,
            strangers=200,
            population=60,
            learn=TraitSettings(steps=150_000, imitation_updates=200, encoder_updates=60),
            evaluation=AssessSettings(windows=200, episodes=60, ranked=40),
        )

    def check_machine(self) -> None:
        """See :meth:`Experiment.check_machine`."""
        check_machine(self.learn.device, self.learn.threads)

    def driver_job(self, folder: Path) -> Job:
        """See :meth:`Experiment.driver_job`."""
        return driver_job(PAPER_DRIVERS, self.driver_steps, 512, self.seed, folder)

    def datasets(self, driver_run: Path) -> dict[str, CollectSettings]:
        """Return what to collect, by folder."""
        common = CollectSettings(driver_policy=str(driver_run), seed=self.seed)
        people = replace(
            common, drivers=(), windows=max(common.windows, 2 * self.learn.pool), population=1
        )

        def drawn(count: int, part: int) -> CollectSettings:
            return replace(people, population=count, seed=int(part_seed(self.seed, part)))

        return {
            DEMONSTRATIONS: replace(common, steps=self.demonstrated),
            POPULATION: drawn(self.population, _POPULATION_PART),
            STRANGERS: drawn(self.strangers, _STRANGERS_PART),
        }

    def trainings(self, folder: Path) -> dict[Path, TraitSettings]:
        """Return what to learn, by folder; the first seed of each setting comes first."""
        return {
            folder / f"traits-{supervision}{'' if number == 0 else f'-{number}'}": replace(
                self.learn, supervision=supervision, seed=int(part_seed(self.seed, number))
            )
            for number in range(self.seeds)
            for supervision in SUPERVISIONS
        }

    def run(self, place: Place) -> TraitResults:
        """See :meth:`Experiment.run`."""
        need_training()
        out, watch = place.folder, place.watch
        runs, data = self.trainings(out), out / DEMONSTRATIONS
        with watch.timing("collecting"):
            self.collect(place.driver_run, out)
        with watch.timing("all training of this call, in parallel"):
            tasks = [
                RunTask(_learn, (job, place.command_line), folder, (_data(out, job).absolute(),))
                for folder, job in runs.items()
            ]
            side_by_side(tasks, place.workers, place.cluster)
        place.note_training(runs)
        with watch.timing("judging"):
            return TraitEvaluation(
                tuple(runs), data, out / POPULATION, str(place.driver_run), self.evaluation
            ).run(place)

    def collect(self, driver_run: Path, folder: Path) -> None:
        """Record what is not recorded yet, and check that it is enough to judge by.

        Raises:
            FileNotFoundError: there is no such driver policy.
            ValueError: a dataset that is there was recorded otherwise, or there is too little.
        """
        from hmi_marl.demonstrations.parquet import (  # needs the data extra
            TRUTH,
            read_about,
            read_demonstrations,
            write_demonstrations,
        )
        from hmi_marl.demonstrations.recording import collect

        for name, dataset in self.datasets(driver_run).items():
            truth = folder / name / TRUTH
            if truth.is_file():  # which is written last
                about = read_about(truth)
                before = _binding(about.get("settings", {}))
                check_same(before, _binding(json_value(dataset)), truth.parent)
                (weights,) = driver_weights(Place(folder, driver_run))
                if about["driver_policy"].get("sha256") != sha256_of(weights):
                    raise ValueError(
                        f"{truth.parent} was recorded with another driver policy than that of "
                        f"{driver_run}; choose another --out, or remove the folder"
                    )
                continue
            total = dataset.total_steps
            with (
                owned(folder / name),
                tqdm(total=total, unit=" steps", unit_scale=True, desc=name) as bar,
            ):
                write_demonstrations(folder / name, collect(dataset, bar.update))
        learn, demonstrations = self.learn, read_demonstrations(folder / DEMONSTRATIONS)
        share = replace(learn, supervision="none").held_out_share
        split = assessment.Split.of(demonstrations, share, self.evaluation.windows)
        latent = max(settings.latent_size for settings in self.trainings(folder).values())
        assessment.pool_sizes(split, learn.pool, latent)
        strangers_pools(read_demonstrations(folder / POPULATION), learn.pool)

    def agents(self, place: Place) -> list[Agent]:
        """See :meth:`Experiment.agents`."""
        labels = (
            "no labels",
            "a fifth labelled by driver",
            "a fifth labelled by preference",
            "no labels, from who belongs together among strangers",
        )
        return [
            Agent(
                f"traits-{supervision}",
                place.folder / f"traits-{supervision}" / "traits.json",
                f"encodes driving into latent traits, learned with {given}",
            )
            for supervision, given in zip(SUPERVISIONS, labels, strict=True)
        ]


def _check_seeds(runs: Sequence[Path], models: Sequence[TraitModel]) -> None:
    """Raise ``ValueError`` unless runs of one supervision differ in their seed and nothing else."""
    first: dict[str, tuple[Path, dict[str, Any]]] = {}
    seen: dict[tuple[str, int], Path] = {}
    for run, model in zip(runs, models, strict=True):
        settings = dict(model.card.training["settings"])
        seed, supervision = settings.pop("seed", None), assessment.supervision_of(model)
        if (supervision, seed) in seen:
            raise ValueError(f"{run} and {seen[supervision, seed]} have the same seed")
        seen[supervision, seed] = run
        other, before = first.setdefault(supervision, (run, settings))
        odd = [n for n in settings if n not in MACHINE and settings[n] != before.get(n)]
        if odd:
            raise ValueError(
                f"{run} was learned with another {odd[0]} than {other}: runs of one supervision "
                "count as seeds of one setting; judge them one at a time"
            )


def _learned_from(run: Path, model: TraitModel) -> tuple[float, str]:
    """Read the share that a run held out, and the checksum of its demonstrations."""
    training = model.card.training
    try:
        settings = training["settings"]
        share = settings["held_out"]
        if share is None:
            share = replace(TraitSettings(), supervision=settings["supervision"]).held_out_share
        return float(share), str(training["demonstrations"])
    except (KeyError, TypeError, ValueError):
        raise ValueError(f"the card of {run} does not name its demonstrations") from None


def _data(folder: Path, job: TraitSettings) -> Path:
    """Folder of the dataset that a run learns from."""
    return folder / (STRANGERS if job.supervision == "self" else DEMONSTRATIONS)


def _binding(settings: dict[str, Any]) -> dict[str, Any]:
    return {"settings": {name: value for name, value in settings.items() if name not in _FREE}}


def _learn(settings: TraitSettings, command_line: str, folder: Path, demonstrations: Path) -> None:
    from hmi_marl.training.traits.run import learn_traits  # torch, with the threads just set

    settings = replace(settings, threads=1)
    learn_traits(settings, demonstrations, folder, command_line=command_line, line=own_line())
