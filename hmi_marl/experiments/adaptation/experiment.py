"""Evaluate adaptive HMIs on unknown drivers against an HMI that knows the driver."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from hmi_marl.agents.adaptive.evidence_model import NAME
from hmi_marl.agents.adaptive.hmis import EXPECTED, Trained, make_adaptive
from hmi_marl.agents.catalogue import make_driver_policy
from hmi_marl.agents.learned.policy import find_policy
from hmi_marl.agents.rollout import begin
from hmi_marl.checks import check_count
from hmi_marl.envs.config import VEHICLE_AI
from hmi_marl.envs.drivers import Traits, get_driver
from hmi_marl.experiments.adaptation import evaluation
from hmi_marl.experiments.adaptation.evaluation import QUICK, AdaptSettings, Result
from hmi_marl.experiments.experiment import Agent, Experiment, Place
from hmi_marl.experiments.policies import HIDDEN_EXPERIMENT, HIDDEN_RUN, MODELS
from hmi_marl.files import json_value
from hmi_marl.reporting.blocks import Block
from hmi_marl.reporting.verdicts import Verdict
from hmi_marl.training.evidence.conditioned import conditioned_hmi, learn_conditioned
from hmi_marl.training.evidence.settings import EvidenceSettings
from hmi_marl.training.jobs import need_training, own_line, side_by_side
from hmi_marl.training.protocols.two_stage import TwoStage

EVIDENCE, CONDITIONED = "evidence", "conditioned"
"""Runs in the experiment's folder."""
CLIP_DRIVERS, CLIP_SEED = ("bart", "homer"), 4
"""Drivers before and after the change in the clip, and its episode."""


class _Judged(Experiment[list[Result]]):
    """Report of an evaluation of adaptive HMIs."""

    name = "adapt"
    title = "The right help for the driver at the wheel"

    def numbers(self, results: list[Result]) -> Mapping[str, Any]:
        """See :meth:`Experiment.numbers`."""
        return {"results": json_value(results)}

    def judge(self, results: list[Result]) -> Sequence[Verdict]:
        """See :meth:`Experiment.judge`."""
        from hmi_marl.experiments.adaptation.report import judge

        return judge(results)

    def blocks(self, results: list[Result]) -> Sequence[Block]:
        """See :meth:`Experiment.blocks`."""
        from hmi_marl.experiments.adaptation.report import blocks

        return blocks(results)


@dataclass(frozen=True)
class AdaptEvaluation(_Judged):
    """Evaluation of trained adaptive HMIs, as ``hmi-marl adapt`` runs it.

    The driver policy is that of the place.
    """

    size: AdaptSettings = field(default_factory=AdaptSettings)
    """Size of the evaluation."""
    trained: Trained = field(default_factory=Trained)
    """Trained models and policies."""

    @classmethod
    def quick(cls) -> AdaptEvaluation:
        """See :meth:`Experiment.quick`."""
        return cls(QUICK)

    def run(self, place: Place) -> list[Result]:
        """See :meth:`Experiment.run`."""
        plays = evaluation.tasks(self.size, str(place.driver_run), self.trained)
        with place.playing(len(plays), "plays") as progress:
            return evaluation.evaluate(plays, place.workers, progress)

    def settings(self) -> dict[str, Any]:
        """See :meth:`Experiment.settings`."""
        return dict(json_value(self.size))


@dataclass(frozen=True)
class Adaptation(_Judged):
    """Learn the encoder and the HMI conditioned on z for unknown drivers; judge both.

    Raises:
        ValueError: no drives, updates or steps.
    """

    drives: int = EvidenceSettings.drives
    """Drives that the encoder learns from."""
    updates: int = EvidenceSettings.updates
    """Gradient steps of the encoder."""
    hmi_steps: int = 8_000_000
    """Environment steps in which the HMI conditioned on z learns."""
    rnn_hidden_dim: int = 32
    """Units of its recurrent layer."""
    num_teams: int = 512
    """Teams that train side by side."""
    seed: int = 0
    """Seed of all training."""
    evaluation: AdaptSettings = field(default_factory=AdaptSettings)
    """Size of the evaluation."""
    hidden: str = ""
    """Runs of the HMIs that do not see attention, {} for the driver model; by default those of the
    experiment ``hidden`` of the same reproduction, or else those that come with the package."""

    uses_driver = True
    paper = (
        "The paper proposes to infer a driver's traits from their driving and to pick the HMI by "
        "them (Sec. III), and leaves that loop open. Below it is closed: the driver is not known, "
        "an encoder reads every step, and the HMI adapts. It is compared with what the exact Bayes "
        "posterior would earn, and with an HMI that knows the driver."
    )

    def __post_init__(self) -> None:
        for name in ("drives", "updates", "hmi_steps", "rnn_hidden_dim"):
            check_count(name, getattr(self, name))

    @classmethod
    def quick(cls) -> Adaptation:
        """See :meth:`Experiment.quick`."""
        return cls(drives=2000, updates=300, hmi_steps=400_000, evaluation=QUICK)

    def encoder(self, driver_run: Path) -> EvidenceSettings:
        """Return the settings of the encoder's training."""
        return EvidenceSettings(
            str(driver_run), drives=self.drives, updates=self.updates, seed=self.seed
        )

    def conditioned(self, driver_run: Path) -> TwoStage:
        """Return the settings of the training of the HMI conditioned on z."""
        return conditioned_hmi(
            str(driver_run), self.hmi_steps, self.rnn_hidden_dim, self.num_teams, self.seed
        )

    def run(self, place: Place) -> list[Result]:
        """See :meth:`Experiment.run`."""
        need_training()
        evidence, conditioned = place.folder / EVIDENCE, place.folder / CONDITIONED
        encoder, hmi = self.encoder(place.driver_run), self.conditioned(place.driver_run)
        side_by_side(_learn_evidence, [(encoder, evidence, place.command_line)], 1)
        side_by_side(learn_conditioned, [(hmi, evidence, conditioned, place.command_line)], 1)
        place.note_training((evidence, conditioned))
        trained = Trained(str(evidence), str(conditioned), self._hidden(place))
        return AdaptEvaluation(self.evaluation, trained).run(place)

    def inputs(self, place: Place) -> list[Path]:
        """See :meth:`Experiment.inputs`."""
        hidden = self._hidden(place)
        cards = [find_policy(Path(hidden.format(model)), VEHICLE_AI) for model in MODELS]
        return super().inputs(place) + [card.with_suffix(".safetensors") for card in cards]

    def agents(self, place: Place) -> list[Agent]:
        """See :meth:`Experiment.agents`."""
        conditioned = find_policy(place.folder / CONDITIONED, VEHICLE_AI)
        return [
            Agent(EVIDENCE, place.folder / EVIDENCE / NAME, "infers the driver, turn by turn"),
            Agent(CONDITIONED, conditioned, "alerts the driver that z describes, attention hidden"),
        ]

    def _hidden(self, place: Place) -> str:
        """Runs of the HMIs that do not see attention, {} for the driver model."""
        runs = place.folder.parent / HIDDEN_EXPERIMENT
        return self.hidden or (str(runs / HIDDEN_RUN) if runs.is_dir() else Trained().hidden)


def record_change(
    path: Path,
    driver_policy: str,
    trained: Trained,
    settings: AdaptSettings,
    seed: int = CLIP_SEED,
) -> None:
    """Write one trip in the middle of which Homer takes the wheel from Bart, as .gif or .mp4.

    Args:
        path: file of the clip.
        driver_policy: driver policy by name, or its run.
        trained: models and policies of the HMI.
        settings: share of revealing steps and caution of the HMI.
        seed: seed of the trip.
    """
    from hmi_marl.reporting import clip  # draws, which takes a while to import

    first, second = CLIP_DRIVERS
    config = replace(evaluation.TEAM, driver=first)
    hmi = make_adaptive(
        EXPECTED,
        config,
        trained=trained,
        revealing=settings.revealing,
        caution=settings.caution,
    )
    driver = make_driver_policy(driver_policy, config)
    teaming = begin(config, driver, hmi, np.array([seed], np.uint64), "highway")
    change = config.horizon // 2, Traits.of([get_driver(second)])
    clip.record(path, config, clip.moments(teaming, driver, hmi, change), 1)


def _learn_evidence(settings: EvidenceSettings, folder: Path, command_line: str) -> None:
    from hmi_marl.training.evidence.run import learn_evidence  # torch, with the threads just set

    learn_evidence(replace(settings, threads=1), folder, command_line=command_line, line=own_line())
