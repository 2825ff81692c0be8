"""Graded alerts as a stage of the reproduction."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tqdm import tqdm

from hmi_marl.agents.learned.policy import find_policy
from hmi_marl.envs.config import VEHICLE_AI
from hmi_marl.experiments import graded_alerts as graded
from hmi_marl.experiments.graded_alerts import CASES, GradedSettings
from hmi_marl.experiments.stages import Agent, Outcome, Place, learned_in
from hmi_marl.files import json_value, make_folder, write_json, write_text
from hmi_marl.reporting.blocks import Table, Told
from hmi_marl.reporting.stopwatch import Stopwatch
from hmi_marl.training.runs.folder import seconds_of
from hmi_marl.training.runs.jobs import train_all


@dataclass(frozen=True)
class GradedStage:
    """HMIs that choose how strongly to alert, with fatigue and without."""

    size: GradedSettings
    name = "graded"
    title = "Graded alerts, and alert fatigue"
    paper = (
        "The paper's alert is one bit, which it says can be extended to any discrete signal "
        "(Sec. IV). Below an alert has one of several strengths, and alerts that pile up may lose "
        "their effect. The optimum is exact here too."
    )

    def settings(self) -> dict[str, Any]:
        """See :class:`hmi_marl.experiments.stages.Stage`."""
        return dict(json_value(self.size)) | {"cases": json_value(CASES)}

    def inputs(self, place: Place) -> list[Path]:
        """See :class:`hmi_marl.experiments.stages.Stage`."""
        return learned_in(place.folder)

    def agents(self, place: Place) -> list[Agent]:
        """See :class:`hmi_marl.experiments.stages.Stage`."""
        return [
            Agent(
                case.name,
                find_policy(place.folder / case.name, VEHICLE_AI),
                f"alerts {case.describe()}, attention seen",
            )
            for case in CASES
        ]

    def run(self, place: Place) -> Outcome:
        """See :class:`hmi_marl.experiments.stages.Stage`."""
        out, watch = place.folder, Stopwatch()
        make_folder(out)
        jobs = self.size.jobs(out)
        train_all(jobs, place.workers, place.command_line)
        with (
            watch.timing("playing"),
            tqdm(total=len(CASES), unit=" cases", desc="playing") as bar,
        ):
            rows = graded.compare_graded(self.size, out, lambda name: bar.update())
        seconds = seconds_of(job.folder for job in jobs) | watch.seconds
        text, numbers = graded.as_text(rows), {"rows": [json_value(row.as_json()) for row in rows]}
        about = {"seconds": seconds, "settings": self.settings(), "command": place.command_line}
        write_text(out / "graded.txt", text + "\n")
        write_json(out / "graded.json", numbers | about)
        exhibits = (
            Told(graded.CAPTION),
            Table("Attention returns", graded.HEAD, graded.table_rows(rows)),
        )
        return Outcome(numbers, exhibits, seconds, text)
