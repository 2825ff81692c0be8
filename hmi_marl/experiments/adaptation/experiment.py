"""Evaluate adaptive HMIs on unknown drivers against an HMI that knows the driver."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from hmi_marl.agents.adaptive.evidence_model import NAME
from hmi_marl.agents.adaptive.hmis import Trained, make_adaptive
from hmi_marl.agents.adaptive.trip_encoder import TripEncoder
from hmi_marl.agents.catalogue import make_driver_policy
from hmi_marl.agents.learned.network import NetworkConfig
from hmi_marl.agents.learned.policy import find_policy
from hmi_marl.agents.learned.trait_model import find_traits, load_traits
from hmi_marl.agents.rollout import begin
from hmi_marl.checks import Count, Units
from hmi_marl.envs.config import VEHICLE_AI
from hmi_marl.envs.drivers import Traits, get_driver
from hmi_marl.envs.streams import Seed
from hmi_marl.experiments import criteria
from hmi_marl.experiments.adaptation import evaluation
from hmi_marl.experiments.adaptation.evaluation import (
    POPULATION,
    QUICK,
    TEAM,
    AdaptSettings,
    Result,
)
from hmi_marl.experiments.adaptation.figure import figure
from hmi_marl.experiments.adaptation.hmis import (
    ADAPTIVE,
    CONDITIONED,
    EXPECTED,
)
from hmi_marl.experiments.adaptation.tables import tables
from hmi_marl.experiments.adaptation.trips import Closed
from hmi_marl.experiments.experiment import (
    HIDDEN_EXPERIMENT,
    HIDDEN_RUN,
    MODELS,
    TRAITS_EXPERIMENT,
    Agent,
    Place,
    traits_run,
)
from hmi_marl.experiments.training_seeds import SeededExperiment, learned_part
from hmi_marl.files import json_value
from hmi_marl.reporting.blocks import Block, Text
from hmi_marl.reporting.verdicts import Part, Verdict
from hmi_marl.training.conditioned.run_tasks import conditioned_task
from hmi_marl.training.conditioned.settings import ConditionedSettings
from hmi_marl.training.evidence.run_tasks import evidence_task
from hmi_marl.training.evidence.settings import EvidenceSettings
from hmi_marl.training.jobs import need_training, side_by_side

EVIDENCE_RUN, CONDITIONED_RUN = "evidence", "conditioned"
"""Runs in the experiment's folder."""
CLIP_DRIVERS, CLIP_SEED = ("bart", "homer"), 4
"""Drivers before and after the change in the clip, and its episode."""
NOTE = (
    "Attention is hidden, and the driver is not known. Every HMI meets the same drivers on the "
    "same roads. Shares are of the gap between two exact rules, AvgHMI's and that of the driver at "
    "the wheel, and may exceed 100 % by chance; where there is no clear gap, no share is given. "
    "HMIs marked Bayes use the exact evidence of the chain instead of the learned one, which reads "
    "the features of the encoder and a^H. Verdicts are on HMIs with the learned evidence: the one "
    "of expected value and, where it says so, the one conditioned on z. Intervals are over drivers "
    "and, where evidence and HMI were trained several times, over these trainings."
)
DRIVES = "drivers"
"""Unit of replication: drivers of the population, or drives of one type."""


def closed_parts(who: str, found: Closed, least: float, seeds: int = 1) -> tuple[Part, Part]:
    """State that there is a gap to close, and that at least this share of it is closed."""
    # The gap is one between exact rules, which no training touches.
    gap = Part.mean(f"{who}: gap per trip", found.gap, DRIVES, above=0.0, paired=True)
    about: dict[str, Any] = {"paired": True, "above": least, "form": "z.1%"}
    return gap, learned_part(f"{who}: share of it closed", found.share, seeds, DRIVES, **about)


class _Judged(SeededExperiment[list[Result]]):
    """Report of an evaluation of adaptive HMIs."""

    name = "adapt"
    title = "The right help for the driver at the wheel"
    short = "Adaptation"

    def numbers_of(self, results: list[Result]) -> Mapping[str, Any]:
        """See :meth:`SeededExperiment.numbers_of`."""
        return {"results": json_value(results)}

    def judge_of(self, results: list[Result]) -> list[Verdict]:
        """Judge the HMIs of expected value and conditioned on z, with the learned evidence."""
        by_group = {result.group: result for result in results}
        targets = [
            (driver, when, least)
            for driver in criteria.GAP_DRIVERS
            for when, least in criteria.GAP_CLOSED.items()
        ]
        population = criteria.POPULATION_GAP_CLOSED
        targets += [(POPULATION, when, least) for when, least in population.items()]
        judged = [(group, EXPECTED, when, least) for group, when, least in targets]
        conditioned = criteria.CONDITIONED_GAP_CLOSED
        judged += [(POPULATION, CONDITIONED, when, least) for when, least in conditioned.items()]
        verdicts = []
        for group, hmi, when, least in judged:
            by = " by the HMI conditioned on z" if hmi == CONDITIONED else ""
            claim = f"{group}: {100 * least:.0f} % of the gap closed{by} after {when}"
            found = by_group[group].shares[hmi][when]
            parts = closed_parts(group, found, least, self.seeds)
            verdicts.append(Verdict(claim, parts))
        for result in results:
            if result.after_change:
                most = criteria.MOST_REGRET
                claim = f"{result.group}: within {100 * most:.0f} % of knowing after 20 s"
                regret = result.after_change[EXPECTED]
                about: dict[str, Any] = {"paired": True, "below": most, "form": "z.2%"}
                part = learned_part("regret", regret, self.seeds, DRIVES, **about)
            else:
                most = criteria.FIRST_SECONDS_LOSS
                claim = f"{result.group}: first 5 s worse than AvgHMI by less than {most:g}"
                gain = result.first_seconds[EXPECTED]
                about = {"paired": True, "above": -most}
                part = learned_part("gain over AvgHMI", gain, self.seeds, DRIVES, **about)
            verdicts.append(Verdict(claim, (part,)))
        return verdicts

    def blocks_of(self, results: list[Result]) -> list[Block]:
        """Show the figure and all tables."""
        return [Text(NOTE), figure(results), *tables(results)]


@dataclass(frozen=True)
class AdaptEvaluation(_Judged):
    """Evaluation of trained adaptive HMIs, as ``hmi-marl adapt`` runs it.

    The driver policy is that of the place.
    """

    size: AdaptSettings = field(default_factory=AdaptSettings)
    """Size of the evaluation."""
    trained: Trained = field(default_factory=Trained)
    """Trained models and policies."""
    seed, seeds = 0, 1

    @classmethod
    def quick(cls) -> AdaptEvaluation:
        """See :meth:`Experiment.quick`."""
        return cls(QUICK)

    def check(self, place: Place) -> None:
        """See :meth:`Experiment.check`; loads every model once."""
        make_driver_policy(str(place.driver_run), TEAM)
        for kind in (CONDITIONED, EXPECTED):
            make_adaptive(ADAPTIVE[kind][0], TEAM, trained=self.trained)
        for model in MODELS:
            self.trained.hidden_hmi(model, TEAM)

    def learn(self, each: Sequence[tuple[AdaptEvaluation, Place]], place: Place) -> None:
        """Learn nothing: it evaluates what is trained."""

    def play(self, place: Place) -> list[Result]:
        """See :meth:`SeededExperiment.play`."""
        return _play(self.size, [self.trained], place)[0]

    def settings(self) -> dict[str, Any]:
        """See :meth:`Experiment.settings`."""
        return dict(json_value(self.size))


@dataclass(frozen=True)
class Adaptation(_Judged):
    """Learn to infer the driver, and an HMI conditioned on z, for unknown drivers; judge both.

    Raises:
        ValueError: no drives, updates or rounds.
    """

    drives: Count = EvidenceSettings.drives
    """Drives that the evidence model learns from."""
    updates: Count = EvidenceSettings.updates
    """Gradient steps of the evidence model."""
    strangers: Count = ConditionedSettings.strangers
    """Drivers with drawn traits that the HMI conditioned on z learns with."""
    types: Count = ConditionedSettings.types
    """Teams with each of the four types that it learns with."""
    rounds: Count = ConditionedSettings.rounds
    """Rounds of driving and learning in which it learns."""
    rnn_hidden_dim: Units = 64
    """Units of its recurrent layer."""
    traits: str = ""
    """Trait model whose encoder reads the trips: a run, or trained:NAME; by default the
    self-supervised one of the experiment ``traits`` of the same reproduction and the same training
    seed, or else the one that comes with the package."""
    seed: Seed = 0
    """Seed of the first training, from which the others are mixed."""
    seeds: Count = 5
    """Trainings of evidence model and HMI; the driver policy and the HMIs for known drivers are the
    same for all."""
    evaluation: AdaptSettings = field(default_factory=AdaptSettings)
    """Size of the evaluation."""
    hidden: str = ""
    """Runs of the HMIs that do not see attention, {} for the driver model; by default those of the
    experiment ``hidden`` of the same reproduction, or else those that come with the package."""

    uses_driver = True
    paper = (
        "The paper proposes to infer a driver's traits from their driving and to pick the HMI by "
        "them (Sec. III), and leaves that loop open. Below it is closed: the driver is not known, "
        "the encoder of z reads every step, and the HMI adapts. It is compared with what the exact "
        "Bayes posterior would earn, and with an HMI that knows the driver."
    )

    @classmethod
    def quick(cls) -> Adaptation:
        """See :meth:`Experiment.quick`."""
        return cls(
            drives=2000, updates=300, strangers=96, types=8, rounds=8, seeds=1, evaluation=QUICK
        )

    def evidence(self, driver_run: Path) -> EvidenceSettings:
        """Return the settings of the evidence model's training."""
        return EvidenceSettings(
            str(driver_run),
            traits=self.traits,
            drives=self.drives,
            updates=self.updates,
            seed=self.seed,
        )

    def conditioned(self, driver_run: Path) -> ConditionedSettings:
        """Return the settings of the training of the HMI conditioned on z."""
        network = NetworkConfig((64,), rnn_hidden_dim=self.rnn_hidden_dim)
        found = ConditionedSettings(
            str(driver_run),
            traits=self.traits,
            strangers=self.strangers,
            types=self.types,
            rounds=self.rounds,
            batch=1,
            network=network,
            revealing=self.evaluation.revealing,
            seed=self.seed,
        )
        return replace(found, batch=min(ConditionedSettings.batch, found.trips_per_round))

    def check(self, place: Place) -> None:
        """See :meth:`Experiment.check`."""
        super().check(place)
        for alone, where in self.by_seed(place):
            alone.evidence(where.driver_run), alone.conditioned(where.driver_run)
            TripEncoder(load_traits(alone.traits), TEAM)
        trained = Trained(hidden=self._hidden(place))
        for model in MODELS:
            trained.hidden_hmi(model, TEAM)

    def by_seed(self, place: Place) -> list[tuple[Adaptation, Place]]:
        """See :meth:`SeededExperiment.by_seed`."""
        hidden = self._hidden(place)
        return [
            (replace(alone, hidden=hidden, traits=self._traits(place, number)), where)
            for number, (alone, where) in enumerate(super().by_seed(place))
        ]

    def learn(self, each: Sequence[tuple[Adaptation, Place]], place: Place) -> None:
        """Learn the evidence models, then the HMIs that read z as they infer it."""
        need_training()
        models, hmis, runs = [], [], []
        for alone, where in each:
            evidence, conditioned = where.folder / EVIDENCE_RUN, where.folder / CONDITIONED_RUN
            model, hmi = alone.evidence(where.driver_run), alone.conditioned(where.driver_run)
            models.append(evidence_task(model, evidence, place.command_line))
            hmis.append(conditioned_task(hmi, evidence, conditioned, place.command_line))
            runs += [evidence, conditioned]
        for tasks in (models, hmis):
            side_by_side(tasks, place.workers, place.cluster)
        place.note_training(runs)

    def play(self, place: Place) -> list[Result]:
        """See :meth:`SeededExperiment.play`."""
        return _play(self.evaluation, [self._trained(place)], place)[0]

    def play_each(
        self, each: Sequence[tuple[Adaptation, Place]], place: Place
    ) -> list[list[Result]]:
        """See :meth:`SeededExperiment.play_each`; what is the same for all is played once."""
        trained = [alone._trained(where) for alone, where in each]
        return _play(self.evaluation, trained, place)

    def inputs(self, place: Place) -> list[Path]:
        """See :meth:`Experiment.inputs`."""
        hidden = self._hidden(place)
        cards = [find_policy(Path(hidden.format(model)), VEHICLE_AI) for model in MODELS]
        cards += [find_traits(self._traits(place, number)) for number in range(self.seeds)]
        return super().inputs(place) + [card.with_suffix(".safetensors") for card in cards]

    def agents(self, place: Place) -> list[Agent]:
        """See :meth:`Experiment.agents`."""
        conditioned = find_policy(place.folder / CONDITIONED_RUN, VEHICLE_AI)
        return [
            Agent(
                EVIDENCE_RUN,
                place.folder / EVIDENCE_RUN / NAME,
                "infers the driver, turn by turn, from the features of traits-self and a^H",
            ),
            Agent(
                CONDITIONED_RUN,
                conditioned,
                "alerts the driver that z describes, as far as it is known, attention hidden",
            ),
        ]

    def _trained(self, place: Place) -> Trained:
        """Models that one training seed learned and reads."""
        evidence, conditioned = place.folder / EVIDENCE_RUN, place.folder / CONDITIONED_RUN
        return Trained(str(evidence), str(conditioned), self._hidden(place), self.traits)

    def _hidden(self, place: Place) -> str:
        """Runs of the HMIs that do not see attention, {} for the driver model."""
        runs = place.folder.parent / HIDDEN_EXPERIMENT
        return self.hidden or (str(runs / HIDDEN_RUN) if runs.is_dir() else Trained().hidden)

    def _traits(self, place: Place, number: int) -> str:
        """Trait model for a training seed, counted from 0."""
        if self.traits:
            return self.traits
        folder = place.folder.parent / TRAITS_EXPERIMENT
        runs = (folder / traits_run("self", each) for each in (number, 0))
        return next((str(run) for run in runs if run.is_dir()), Trained().traits)


def _play(size: AdaptSettings, trained: Sequence[Trained], place: Place) -> list[list[Result]]:
    """Play with the models of each training seed."""
    plays = evaluation.tasks(size, str(place.driver_run), trained)
    with place.playing(len(plays), "plays") as progress:
        return evaluation.evaluate(plays, trained, place.workers, progress)


def record_change(
    path: Path, driver_policy: str, trained: Trained, settings: AdaptSettings, seed: int = CLIP_SEED
) -> None:
    """Write one trip in the middle of which Homer takes the wheel from Bart, as .gif or .mp4."""
    from hmi_marl.reporting import clip  # draws, which takes a while to import

    first, second = CLIP_DRIVERS
    config = replace(evaluation.TEAM, driver=first)
    kind = ADAPTIVE[EXPECTED][0]
    hmi = make_adaptive(
        kind, config, trained=trained, revealing=settings.revealing, caution=settings.caution
    )
    driver = make_driver_policy(driver_policy, config)
    teaming = begin(config, driver, hmi, np.array([seed], np.uint64), "highway")
    change = config.horizon // 2, Traits.of([get_driver(second)])
    clip.record(path, config, clip.moments(teaming, driver, hmi, change), 1)
