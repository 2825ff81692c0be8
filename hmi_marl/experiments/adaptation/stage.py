"""Getting to know the driver at the wheel, as a stage of the reproduction."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from tqdm import tqdm

from hmi_marl.agents.adaptive.evidence_model import NAME
from hmi_marl.agents.adaptive.factory import Trained
from hmi_marl.agents.learned.policy import find_policy
from hmi_marl.envs.config import VEHICLE_AI
from hmi_marl.experiments.adaptation import evaluation as adapt
from hmi_marl.experiments.adaptation import report as adapt_report
from hmi_marl.experiments.adaptation.settings import AdaptReproduction
from hmi_marl.experiments.hidden_attention import MODELS
from hmi_marl.experiments.paper_stages import HiddenStage
from hmi_marl.experiments.stages import Agent, Outcome, Place, learned_in
from hmi_marl.files import json_value, make_folder
from hmi_marl.reporting.stopwatch import Stopwatch
from hmi_marl.training.evidence.conditioned import learn_conditioned
from hmi_marl.training.evidence.settings import EvidenceSettings
from hmi_marl.training.runs.folder import seconds_of
from hmi_marl.training.runs.jobs import need_training, own_line, side_by_side

EVIDENCE, CONDITIONED = "evidence", "conditioned"
"""Runs in the stage's folder."""


@dataclass(frozen=True)
class AdaptStage:
    """Drivers who are not known, with HMIs that get to know them."""

    size: AdaptReproduction
    hidden: str = ""
    """The HMIs that do not see attention, {} standing for the driver model; by default those of the
    stage beside this one."""
    name = "adapt"
    title = adapt_report.TITLE
    paper = (
        "The paper proposes to infer a driver's traits from their driving and to pick the HMI by "
        "them (Sec. III), and leaves that loop open. Below it is closed: the driver is not known, "
        "an encoder reads every step, and the HMI adapts. Beside it what the exact Bayes posterior "
        "would earn, and an HMI that knew the driver all along."
    )

    def settings(self) -> dict[str, Any]:
        """See :class:`hmi_marl.experiments.stages.Stage`."""
        return dict(json_value(self.size))

    def inputs(self, place: Place) -> list[Path]:
        """See :class:`hmi_marl.experiments.stages.Stage`."""
        hmis = [find_policy(self._hidden(place, model), VEHICLE_AI) for model in MODELS]
        shared = [find_policy(place.driver_run, "driver"), *hmis]
        return learned_in(place.folder) + [card.with_suffix(".safetensors") for card in shared]

    def agents(self, place: Place) -> list[Agent]:
        """See :class:`hmi_marl.experiments.stages.Stage`."""
        conditioned = find_policy(place.folder / CONDITIONED, VEHICLE_AI)
        return [
            Agent(EVIDENCE, place.folder / EVIDENCE / NAME, "tells who drives, turn by turn"),
            Agent(CONDITIONED, conditioned, "alerts whoever z says, attention hidden"),
        ]

    def run(self, place: Place) -> Outcome:
        """See :class:`hmi_marl.experiments.stages.Stage`."""
        need_training()
        size, out, watch = self.size, place.folder, Stopwatch()
        make_folder(out)
        evidence, conditioned = out / EVIDENCE, out / CONDITIONED
        settings = size.evidence(place.driver_run)
        side_by_side(_learn_evidence, [(settings, evidence, place.command_line)], 1)
        hmi = size.conditioned(place.driver_run)
        side_by_side(learn_conditioned, [(hmi, evidence, conditioned, place.command_line)], 1)
        trained = Trained(str(evidence), str(conditioned), str(self._hidden(place, "{}")))
        total = adapt.plays(size.judge)
        with watch.timing("playing"), tqdm(total=total, unit=" plays", desc="playing") as bar:
            results = adapt.evaluate(
                size.judge, str(place.driver_run), trained, place.workers, bar.update
            )
        learned = seconds_of((evidence, conditioned))
        seconds = {f"training {run}": spent for run, spent in learned.items()} | watch.seconds
        text, shown = adapt_report.write_report(
            out, results, seconds, place.command_line, self.settings()
        )
        return Outcome(adapt_report.as_json(results), shown, seconds, text)

    def _hidden(self, place: Place, model: str) -> Path:
        if self.hidden:
            return Path(self.hidden.format(model))
        return place.folder.parent / HiddenStage.name / f"hmi-{model}"


def _learn_evidence(settings: EvidenceSettings, folder: Path, command_line: str) -> None:
    from hmi_marl.training.evidence.run import learn_evidence  # torch, with the threads just set

    learn_evidence(replace(settings, threads=1), folder, command_line=command_line, line=own_line())
