"""Judge trained trait models, as ``hmi-marl traits evaluate`` does."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from hmi_marl.agents.catalogue import make_driver_policy
from hmi_marl.agents.learned.trait_model import TraitModel, load_traits
from hmi_marl.demonstrations.dataset import Demonstrations, Split
from hmi_marl.envs.config import TeamConfig
from hmi_marl.exact.identify import Identification
from hmi_marl.experiments.experiment import Place
from hmi_marl.experiments.latent_traits import assessment, ceiling
from hmi_marl.experiments.latent_traits.assessment import Assessment, AssessSettings
from hmi_marl.experiments.latent_traits.imitation import check_fits
from hmi_marl.experiments.latent_traits.posterior import PosteriorRow, evaluate_posteriors
from hmi_marl.experiments.latent_traits.prediction import ActionPredictor, has_pairs
from hmi_marl.experiments.latent_traits.report import TraitReport
from hmi_marl.experiments.latent_traits.results import TraitResults
from hmi_marl.experiments.latent_traits.strangers import strangers_pools
from hmi_marl.files import sha256_of
from hmi_marl.training.jobs import calls_with_bars, own_line
from hmi_marl.training.runs.folder import FREE as MACHINE
from hmi_marl.training.traits.settings import PAPER_HELD_OUT, Supervision, TraitSettings

SUPERVISIONS: tuple[Supervision, ...] = ("none", "id", "preference", "self")
"""The paper's three settings in its order, then the self-supervised one."""


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
        """See :meth:`Experiment.check`; what the demonstrations hold is checked in the run."""
        _ = self.fitting_models
        if self.driver_policy is not None:
            make_driver_policy(self.driver_policy, TeamConfig())

    def run(self, place: Place) -> TraitResults:
        """Judge the runs on what they held out, several at a time.

        Raises:
            FileNotFoundError, ValueError: no such runs or demonstrations, or runs that learned from
                other demonstrations or that pool or hold out differently.
        """
        judging, count = _Judging.read(self), len(self.runs)
        exact = one_step = None
        try:
            exact = ceiling.exact_evidence(judging.split.unseen, self.driver_policy)
            one_step = ceiling.from_one_step(judging.split.unseen, self.driver_policy)
        except ceiling.NoCeilingError as error:
            print(error, file=sys.stderr)
        workers = min(place.workers, count)
        if workers == 1:
            judged = [judging.judge(self, exact)]
        else:  # each worker reads the demonstrations once, and judges each so many-th model
            tasks = [(self, exact, number, workers) for number in range(workers)]
            judged = list(calls_with_bars(_judge_some, tasks, workers))
        found: dict[str, list[Assessment]] = {}
        for number in range(count):
            one = judged[number % workers][number // workers]
            found.setdefault(one.supervision, []).append(one)
        ordered: dict[str, list[Assessment]] = {
            name: found[name] for name in SUPERVISIONS if name in found
        }
        posterior = self._posterior(judging.unknown, judging.pool)
        return TraitResults(ordered, judging.pool, one_step, posterior)

    def unknown(
        self, models: Sequence[TraitModel], data: Demonstrations, pool: int
    ) -> Demonstrations | None:
        """Read the population without drivers who have demonstrated; None if there is none.

        Raises:
            ValueError: it is not fit to judge by.
        """
        from hmi_marl.demonstrations.parquet import read_demonstrations

        if self.population is None:
            return None
        unknown = assessment.unseen_drivers(read_demonstrations(self.population), data)
        if unknown.truth is None:
            raise ValueError("traits can be regressed only where the truth is known")
        strangers_pools(unknown.observed.driver, pool)
        check_fits(models[0], unknown.observed)
        return unknown

    @cached_property
    def fitting_models(self) -> tuple[list[TraitModel], float]:
        """The models, and the share of windows that they held out.

        Raises:
            FileNotFoundError, ValueError: a run or a folder of demonstrations is not there, or they
                do not fit together.
        """
        models = [load_traits(run) for run in self.runs]
        share = self._share(models)
        _check_seeds(self.runs, models)
        if self.population is not None:
            digest = _digest(self.population)
            for run, model in zip(self.runs, models, strict=True):
                if _learned_from(run, model)[1] == digest:
                    raise ValueError(
                        f"{run} has learned from {self.population}; name a population that it has "
                        "not"
                    )
        return models, share

    def _share(self, models: Sequence[TraitModel]) -> float:
        """Share of windows that the runs held out of the demonstrations, the same for all.

        Raises:
            ValueError: they hold out or pool differently, or learned from other demonstrations, as
                only self-supervised ones may.
        """
        digest, first = _digest(self.demonstrations), None
        for run, model in zip(self.runs, models, strict=True):
            held_out, learned = _learned_from(run, model)
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
class _Judging:
    """What all models are judged by."""

    pool: int
    split: Split
    windows: tuple[int, ...]
    unknown: Demonstrations | None
    """Strangers whom none has learned from."""

    @classmethod
    def read(cls, evaluation: TraitEvaluation) -> _Judging:
        """Read the demonstrations and the population of an evaluation."""
        from hmi_marl.demonstrations.parquet import read_demonstrations

        models, share = evaluation.fitting_models
        data, pool = read_demonstrations(evaluation.demonstrations), models[0].card.pool
        split = Split.of(data, share, evaluation.size.windows)
        latent = max(model.card.latent for model in models)
        windows = assessment.pool_sizes(split, pool, latent)
        return cls(pool, split, windows, evaluation.unknown(models, data, pool))

    def judge(
        self,
        evaluation: TraitEvaluation,
        exact: Identification | None,
        first: int = 0,
        every: int = 1,
    ) -> list[Assessment]:
        """Judge each so many-th model from one on; by default all."""
        unknown, size, predictor = self.unknown, evaluation.size, None
        if unknown is not None and has_pairs(unknown.observed.driver, self.pool):
            predictor = ActionPredictor(unknown, self.pool, size.seed)
        some = evaluation.fitting_models[0][first::every]
        total, line = assessment.PARTS * len(some), own_line()
        with tqdm(total=total, unit=" parts", desc="judging", position=line) as bar:
            return [
                assessment.assess(
                    model, self.split, exact, unknown, size, self.windows, bar.update, predictor
                )
                for model in some
            ]


def _judge_some(
    evaluation: TraitEvaluation, exact: Identification | None, first: int, every: int
) -> list[Assessment]:
    """Judge each so many-th model from one on, in a process of its own."""
    return _Judging.read(evaluation).judge(evaluation, exact, first, every)


def _digest(demonstrations: Path) -> str:
    """Return the checksum of demonstrations, once their file can be opened."""
    from hmi_marl.demonstrations.step_file import StepFile
    from hmi_marl.demonstrations.stored import OBSERVED

    return sha256_of(StepFile(demonstrations / OBSERVED).path)


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
