"""The stages of the paper's reproduction, each of which a command can also run alone.

Each writes into its own folder what its command promises, and hands the same over as an outcome.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tqdm import tqdm

from hmi_marl.agents.learned.policy import find_policy
from hmi_marl.envs.config import DRIVER, VEHICLE_AI
from hmi_marl.experiments import attentive_drivers as attentive
from hmi_marl.experiments import hidden_attention as hidden
from hmi_marl.experiments.attentive_drivers import AttentiveSettings
from hmi_marl.experiments.hidden_attention import HiddenSettings
from hmi_marl.experiments.latent_traits.settings import (
    DEMONSTRATIONS,
    POPULATION,
    SUPERVISIONS,
    TraitReproduction,
)
from hmi_marl.experiments.metrics_table import reproduction, reproduction_report
from hmi_marl.experiments.metrics_table.reproduction import (
    DRIVER_RUN,
    VARIANTS,
    ReproductionSettings,
)
from hmi_marl.experiments.stages import Agent, Outcome, Place, learned_in
from hmi_marl.files import json_value, make_folder, write_bytes, write_json, write_text
from hmi_marl.reporting.blocks import Table, held, page_of, pictures
from hmi_marl.reporting.stopwatch import Stopwatch
from hmi_marl.training.runs.folder import seconds_of
from hmi_marl.training.runs.jobs import Job, need_training, train_all


def learn_driver(job: Job, command_line: str) -> Path:
    """Learn a driver policy alone; returns its run."""
    make_folder(job.folder)
    train_all([job], 1, command_line)
    return job.folder


def driver_weights(place: Place) -> list[Path]:
    """Of the driver that the stages share."""
    card = find_policy(place.driver_run, DRIVER)
    return [card.with_suffix(".safetensors")]


@dataclass(frozen=True)
class TableStage:
    """The paper's table of HMIs and drivers; it learns the driver policy of all stages."""

    size: ReproductionSettings
    name = "table"
    title = "HMIs and drivers"
    paper = (
        "The paper's table of metrics (Sec. VIII-C): speed and distraction returns of four drivers "
        "with the HMI trained for each, with one trained for the average driver, and with none. "
        "Below, each entry holds ours, the exact value, the range that any alert policy can reach, "
        "and the paper's figure; entries that the paper leaves as * are filled in. Twice: with η "
        "as printed and with η = 1 for everybody."
    )

    def settings(self) -> dict[str, Any]:
        """See :class:`hmi_marl.experiments.stages.Stage`."""
        return dict(json_value(self.size))

    def inputs(self, place: Place) -> list[Path]:
        """See :class:`hmi_marl.experiments.stages.Stage`."""
        return learned_in(place.folder)

    def agents(self, place: Place) -> list[Agent]:
        """See :class:`hmi_marl.experiments.stages.Stage`."""
        driver = find_policy(place.folder / DRIVER_RUN, DRIVER)
        found = [Agent("driver", driver, "drives as any driver, told their traits")]
        for job in self.size.hmi_jobs(place.folder):
            card = find_policy(job.folder, VEHICLE_AI)
            what = f"alerts {job.settings.hmi_for}, attention seen"  # type: ignore[attr-defined]
            found.append(Agent(job.folder.name.removeprefix("hmi-"), card, what))
        return found

    def run(self, place: Place) -> Outcome:
        """See :class:`hmi_marl.experiments.stages.Stage`."""
        size, out, watch = self.size, place.folder, Stopwatch()
        make_folder(out)
        first, others = size.driver_job(out), size.hmi_jobs(out)
        with watch.timing("all training of this call, side by side"):
            train_all([first], 1, place.command_line)
            train_all(others, place.workers, place.command_line)
        total = reproduction.cells_in_all() * size.episodes
        with watch.timing("playing"), tqdm(total=total, unit=" episodes", desc="playing") as bar:
            tables = [
                reproduction.play_table(variant, size, out, place.workers, bar.update)
                for variant in VARIANTS
            ]
        trained = seconds_of(job.folder for job in (first, *others))
        seconds = {f"training {name}": spent for name, spent in trained.items()} | watch.seconds
        text = reproduction_report.as_text(tables, seconds)
        numbers = reproduction_report.as_json(tables)
        exhibits = reproduction_report.exhibits(tables)
        about = {"command": place.command_line, "settings": self.settings()}
        write_text(out / "table.txt", text + "\n")
        write_json(out / "table.json", numbers | {"seconds": seconds} | about)
        write_bytes(out / "table.png", *pictures(exhibits))
        html = page_of("The paper's table", exhibits, seconds, place.command_line, self.settings())
        write_text(out / "index.html", html)
        return Outcome(numbers, exhibits, seconds, text)


@dataclass(frozen=True)
class DriverStage:
    """Drivers without distraction, as they learn."""

    size: AttentiveSettings
    name = "driver"
    title = "Drivers without distraction"
    paper = (
        "The paper models caution as perceiving others larger than they are (Sec. VI), which is to "
        "make a driver leave more headway, and prints no figures for it. Below is one policy for a "
        "confident driver (inflation 3) and a cautious one (9), neither ever distracted, as it "
        "learns."
    )

    def settings(self) -> dict[str, Any]:
        """See :class:`hmi_marl.experiments.stages.Stage`."""
        return dict(json_value(self.size))

    def inputs(self, place: Place) -> list[Path]:
        """See :class:`hmi_marl.experiments.stages.Stage`."""
        return learned_in(place.folder)

    def agents(self, place: Place) -> list[Agent]:
        """See :class:`hmi_marl.experiments.stages.Stage`."""
        what = "drives without distraction, confidently or cautiously"
        return [Agent("attentive-driver", find_policy(place.folder, DRIVER), what)]

    def run(self, place: Place) -> Outcome:
        """See :class:`hmi_marl.experiments.stages.Stage`."""
        size, out, watch = self.size, place.folder, Stopwatch()
        make_folder(out)
        job = size.job(out)
        train_all([job], 1, place.command_line)
        with watch.timing("playing"):
            rows = [
                attentive.assess(path, steps, driver, size.episodes, reproduction.EVALUATION_SEED)
                for steps, path in tqdm(attentive.snapshots(out), desc="playing")
                for driver in (attentive.CONFIDENT, attentive.CAUTIOUS)
            ]
        verdicts = attentive.verdicts(*rows[-2:])
        numbers = {"rows": [row.as_json() for row in rows], "verdicts": verdicts}
        write_json(out / "driver.table.json", numbers | {"command": place.command_line})
        seconds = seconds_of([job.folder]) | watch.seconds
        exhibits = (
            Table("As they learn", attentive.HEAD, attentive.table_rows(rows)),
            *held(verdicts),
        )
        return Outcome(numbers, exhibits, seconds, attentive.as_text(rows, verdicts))


@dataclass(frozen=True)
class HiddenStage:
    """HMIs that do not see attention."""

    size: HiddenSettings
    name = "hidden"
    title = "Attention hidden: what knowing the driver is worth"
    paper = (
        "The paper's claim is that an HMI for the driver at the wheel does better than one for the "
        "average driver; its HMIs see distraction. Ours below do not: they infer it from what the "
        "car does. That is not in the paper, and it is where knowing the driver can be worth "
        "something. The Bayes filter, which knows the traits, is the ceiling."
    )

    def settings(self) -> dict[str, Any]:
        """See :class:`hmi_marl.experiments.stages.Stage`."""
        return dict(json_value(self.size))

    def inputs(self, place: Place) -> list[Path]:
        """See :class:`hmi_marl.experiments.stages.Stage`."""
        return learned_in(place.folder) + driver_weights(place)

    def agents(self, place: Place) -> list[Agent]:
        """See :class:`hmi_marl.experiments.stages.Stage`."""
        return [
            Agent(
                f"hidden-{model}",
                find_policy(place.folder / f"hmi-{model}", VEHICLE_AI),
                f"alerts {model}, attention hidden",
            )
            for model in hidden.MODELS
        ]

    def run(self, place: Place) -> Outcome:
        """See :class:`hmi_marl.experiments.stages.Stage`."""
        out, watch = place.folder, Stopwatch()
        make_folder(out)
        jobs = self.size.hmi_jobs(out, place.driver_run)
        train_all(jobs, place.workers, place.command_line)
        with (
            watch.timing("playing"),
            tqdm(total=len(hidden.MODELS), unit=" drivers", desc="playing") as bar,
        ):
            rows = hidden.compare_hidden(
                self.size, out, place.driver_run, lambda name: bar.update()
            )
        numbers = {"rows": [row.as_json() for row in rows]}
        about = {"settings": self.settings(), "command": place.command_line}
        write_json(out / "hidden.json", numbers | about)
        exhibits = (
            Table(hidden.CAPTION, hidden.table_head(rows), hidden.table_rows(rows)),
            Table(hidden.PAIRED, hidden.DIFFERENCES_HEAD, hidden.difference_rows(rows)),
        )
        trained = seconds_of(job.folder for job in jobs)
        return Outcome(numbers, exhibits, trained | watch.seconds, hidden.as_text(rows))


@dataclass(frozen=True)
class TraitsStage:
    """Latent traits in the paper's three settings."""

    size: TraitReproduction
    name = "traits"
    title = "Latent traits"
    paper = (
        "The paper's figure of latent embeddings (Sec. VIII-B) has three panels: unsupervised, "
        "supervised by driver, supervised by preference, each the embeddings of the four drivers. "
        "Its source comes without the pictures; what it prints is the KL divergence averaged over "
        "pairs of driver types, 435, 4940 and 2872 nats. Below is the same figure of ours, and "
        "beside every accuracy what the exact Bayes classifier of the same windows reaches."
    )

    def settings(self) -> dict[str, Any]:
        """See :class:`hmi_marl.experiments.stages.Stage`."""
        return dict(json_value(self.size))

    def inputs(self, place: Place) -> list[Path]:
        """See :class:`hmi_marl.experiments.stages.Stage`."""
        return learned_in(place.folder) + driver_weights(place)

    def agents(self, place: Place) -> list[Agent]:
        """See :class:`hmi_marl.experiments.stages.Stage`."""
        labelled = "no labels", "a fifth labelled by driver", "a fifth labelled by preference"
        told = dict(zip(SUPERVISIONS, labelled, strict=True))
        return [
            Agent(
                f"traits-{supervision}",
                place.folder / f"traits-{supervision}" / "traits.json",
                f"encodes driving into latent traits, learned with {labels}",
            )
            for supervision, labels in told.items()
        ]

    def run(self, place: Place) -> Outcome:
        """See :class:`hmi_marl.experiments.stages.Stage`."""
        need_training()
        from hmi_marl.experiments.latent_traits import reproduction as parts  # needs the data extra

        size, out, watch = self.size, place.folder, Stopwatch()
        make_folder(out)
        with watch.timing("collecting"):
            parts.collect_datasets(size, place.driver_run, out)
        with watch.timing("all training of this call, side by side"):
            parts.learn_all(size, out, place.workers, place.command_line)
        runs = list(size.trainings(out))
        with watch.timing("judging"):
            assessments, pools = parts.assess_runs(
                runs, out / DEMONSTRATIONS, out / POPULATION, str(place.driver_run), size.judge
            )
        trained = seconds_of(runs)
        seconds = {f"training {run}": spent for run, spent in trained.items()} | watch.seconds
        return parts.write_report(
            out, assessments, pools, seconds, place.command_line, self.settings()
        )
