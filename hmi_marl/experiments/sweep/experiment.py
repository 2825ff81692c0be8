"""Experiment "sweep": train over options, protocols and seeds, and tabulate what came out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import Any

from hmi_marl.checks import Count
from hmi_marl.envs.drivers import PAPER_DRIVERS, DriverName
from hmi_marl.envs.streams import Seed
from hmi_marl.experiments.episode_sums import ALL_DRIVERS, ends_of
from hmi_marl.experiments.experiment import Experiment, Place
from hmi_marl.experiments.sweep.figure import sweep_figure
from hmi_marl.experiments.sweep.options import written
from hmi_marl.experiments.sweep.plan import Combination, SweptRun, plan_runs, varying
from hmi_marl.experiments.sweep.runs import Evaluation, Result, read_result, task
from hmi_marl.experiments.sweep.table import TABLE, write_table
from hmi_marl.files import json_value
from hmi_marl.reporting import statistics
from hmi_marl.reporting.blocks import Block, Figure, Table, Text
from hmi_marl.reporting.statistics import Estimate
from hmi_marl.training.cluster.cluster import Cluster
from hmi_marl.training.jobs import check_job, need_training, processes_each, side_by_side
from hmi_marl.training.protocols.registry import PROTOCOLS
from hmi_marl.training.runs.folder import CHECKPOINT

_SOURCES = ("/combinations",)
"""Place of the numbers in the JSON file."""


@dataclass(frozen=True)
class SweepResults:
    """Results of a sweep, in the order of its runs."""

    sweep: Sweep
    runs: Sequence[tuple[SweptRun, Result]]

    def combinations(self) -> list[tuple[Combination, list[Result]]]:
        """Return every combination with the results of its runs."""
        found: list[tuple[Combination, list[Result]]] = []
        for run, result in self.runs:
            if run.number == 0:
                found.append((run.combination, []))
            found[-1][1].append(result)
        return found


def over_seeds(results: Sequence[Result], metric: str, driver: str = ALL_DRIVERS) -> Estimate:
    """Average a metric over runs, with Student's t interval; NaN where no run has it."""
    values = [result.by_driver[driver].metrics[metric] for result in results]
    known = [value for value in values if value is not None]
    return statistics.mean(known, *ends_of(metric))


@dataclass(frozen=True)
class Sweep(Experiment[SweepResults]):
    """Train over lists and ranges of any option of train, by protocol and seed.

    Every run plays the same evaluation episodes. A run that is finished is not trained again, also
    when the sweep gets more values, protocols or seeds.

    Example: hmi-marl reproduce sweep --over ppo.learning_rate=1e-3,2e-3 --seeds 2

    Raises:
        ValueError, TypeError: an option that there is not, or a value that does not fit, with the
            combination that it is in.
    """

    protocols: tuple[str, ...] = field(default_factory=lambda: tuple(PROTOCOLS))
    """Protocols to train by."""
    over: tuple[str, ...] = ()
    """Options as NAME=VALUE,VALUE or NAME=FROM..TO/COUNT, with /log for equal ratios; a single
    value holds for all runs. PROTOCOL:NAME=... is for one protocol."""
    seeds: Count = 3
    """Runs of each combination."""
    seed: Seed = 0
    """Seed of the first run of each combination; those of the others are mixed from it."""
    episodes: Count = 500
    """Evaluation episodes of each run with each driver."""
    drivers: tuple[DriverName, ...] = PAPER_DRIVERS
    """Drivers of the evaluation: known names, or name:beta,alpha,eta,inflation."""

    name = "sweep"
    title = "Sweep"

    def __post_init__(self) -> None:
        super().__post_init__()
        self.evaluation, self.plan  # noqa: B018  # check the rest

    @classmethod
    def quick(cls) -> Sweep:
        """See :meth:`Experiment.quick`."""
        over = ("steps=100_000,200_000", "num_teams=128")
        return cls(("two-stage", "simultaneous"), over, seeds=2, episodes=100)

    @cached_property
    def plan(self) -> tuple[SweptRun, ...]:
        """All runs."""
        return plan_runs(self.protocols, self.over, self.seeds, self.seed)

    @property
    def evaluation(self) -> Evaluation:
        """Evaluation episodes of every run."""
        return Evaluation(self.drivers, self.episodes)

    def check(self, place: Place) -> None:
        """See :meth:`Experiment.check`."""
        for settings in {run.combination.label: run.settings for run in self.plan}.values():
            check_job(settings, place.cluster)

    def states(self, folder: Path) -> list[str]:
        """Return for each run below ``folder`` whether it is "done", "begun" or "new"."""
        states = []
        for run in self.plan:
            there = folder / run.name
            done = read_result(run, self.evaluation, there) is not None
            begun = (there / CHECKPOINT).is_file()
            states.append("done" if done else "begun" if begun else "new")
        return states

    def run(self, place: Place) -> SweepResults:
        """See :meth:`Experiment.run`."""
        need_training()
        states = self.states(place.folder)
        left = [run for run, state in zip(self.plan, states, strict=True) if state != "done"]
        self._train(left, place, place.cluster)
        found = []
        for run in self.plan:
            result = read_result(run, self.evaluation, place.folder / run.name)
            if result is None:
                raise RuntimeError(f"{place.folder / run.name} has no result of its evaluation")
            found.append((run, result))
        about = {"command": place.command_line, "settings": self.settings()}
        write_table(place.folder / TABLE, found, about)
        return SweepResults(self, found)

    def _train(self, runs: Sequence[SweptRun], place: Place, cluster: Cluster | None) -> None:
        each = processes_each(len(runs), place.workers, cluster)
        command = place.command_line
        tasks = [task(run, self.evaluation, place.folder, command, each) for run in runs]
        with place.watch.timing("training and playing, in this call"):
            side_by_side(tasks, place.workers, cluster)

    def numbers(self, results: SweepResults) -> Mapping[str, Any]:
        """See :meth:`Experiment.numbers`."""
        return {
            "combinations": [
                {
                    "protocol": combination.protocol,
                    "options": json_value(combination.options),
                    "steps": found[0].steps,
                    "seconds": _seconds(found).as_json(),
                    "over_seeds": {
                        driver: {
                            metric: over_seeds(found, metric, driver).as_json()
                            for metric in found[0].by_driver[driver].metrics
                        }
                        for driver in found[0].by_driver
                    },
                }
                for combination, found in results.combinations()
            ],
            "runs": [
                {"folder": run.name, "seed": run.settings.seed, "steps": result.steps}
                | {"by_driver": json_value(result.by_driver)}
                for run, result in results.runs
            ],
        }

    def blocks(self, results: SweepResults) -> Sequence[Block]:
        """See :meth:`Experiment.blocks`."""
        found = results.combinations()
        seconds = sum(result.seconds for _, result in results.runs)
        fixed = _for_all([combination for combination, _ in found])
        points = [(combination, partial(over_seeds, these)) for combination, these in found]
        return [
            Text(
                f"{len(results.runs)} runs: {len(found)} combinations, {self.seeds} seeds each, "
                f"{sum(result.steps for _, result in results.runs):,} environment steps and "
                f"{seconds / 3600:.2f} hours of training in all. Every run played {self.episodes} "
                "evaluation episodes with each driver, the same ones, by its likeliest actions. "
                f"A row for each run and driver is in `{TABLE}`."
                + (f" For all runs: {fixed}." if fixed else "")
            ),
            summary_table(results),
            driver_table(results),
            Figure(
                "sweep",
                "Means and 95 % intervals over seeds",
                partial(sweep_figure, points),
                sources=_SOURCES,
            ),
        ]


def plan_table(sweep: Sweep, folder: Path) -> Table:
    """Show what a sweep would train, in which folders, and what is done already."""
    options = varying([run.combination for run in sweep.plan])
    states = sweep.states(folder)
    rows = [
        [
            run.combination.protocol,
            *_values(run.combination, options),
            str(run.settings.seed),
            f"{run.steps:,}",
            run.name,
            state,
        ]
        for run, state in zip(sweep.plan, states, strict=True)
    ]
    total = sum(run.steps for run in sweep.plan)
    left = sum(run.steps for run, state in zip(sweep.plan, states, strict=True) if state != "done")
    note = f"{len(rows)} runs of {total:,} environment steps, of which {left:,} are left to do."
    fixed = _for_all([run.combination for run in sweep.plan])
    note += f" For all: {fixed}." if fixed else ""
    return Table(
        f"Plan of the sweep in {folder}",
        ["protocol", *options, "seed", "environment steps", "folder", "state"],
        rows,
        note,
    )


def summary_table(results: SweepResults) -> Table:
    """Show every combination, with means over its runs."""
    metrics = {
        "team return": ("team_return", "z.1f"),
        "attention return": ("attention_return", "z.1f"),
        "speed return": ("speed_reward", "z.1f"),
        "alerts/min": ("alerts_per_minute", "z.1f"),
    }
    columns: dict[str, Callable[[list[Result]], str]] = {
        name: lambda these, metric=metric, form=form: over_seeds(these, metric).shown(form)  # type: ignore[misc]
        for name, (metric, form) in metrics.items()
    }
    columns["crashes [%]"] = lambda these: over_seeds(these, "crash_rate").percent()
    columns["environment steps"] = lambda these: f"{these[0].steps:,}"
    columns["seconds of a run"] = lambda these: _seconds(these).shown("z.0f")
    note = (
        "Means over the seeds, in brackets Student's t interval (95 %). All drivers together, each "
        "with the same number of episodes."
    )
    return _table("Results by combination", results, columns, note)


def driver_table(results: SweepResults) -> Table:
    """Show the team return with each driver."""
    names = results.sweep.evaluation.names
    columns: dict[str, Callable[[list[Result]], str]] = {
        name: lambda these, name=name: over_seeds(these, "team_return", name).shown()  # type: ignore[misc]
        for name in names
    }
    return _table("Team return by driver", results, columns, "As above.")


def _table(
    title: str,
    results: SweepResults,
    columns: Mapping[str, Callable[[list[Result]], str]],
    note: str,
) -> Table:
    found = results.combinations()
    options = varying([combination for combination, _ in found])
    rows = [
        [each.protocol, *_values(each, options), *(shown(these) for shown in columns.values())]
        for each, these in found
    ]
    return Table(title, ["protocol", *options, *columns], rows, note, _SOURCES)


def _seconds(results: Sequence[Result]) -> Estimate:
    """Wall time of training a run, over runs [s]."""
    return statistics.mean([result.seconds for result in results], 0.0)


def _for_all(combinations: Sequence[Combination]) -> str:
    """Write the options that have one value in a whole sweep."""
    options, different = combinations[0].options, varying(combinations)
    return ", ".join(
        f"{name} = {written(value)}" for name, value in options.items() if name not in different
    )


def _values(combination: Combination, options: Sequence[str]) -> list[str]:
    given = combination.options
    return [written(given[name]) if name in given else "-" for name in options]
