"""Experiment "protocols": compare the protocols, judge them, and show tables and figures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from hmi_marl.envs.rewards import TERMS
from hmi_marl.experiments import criteria
from hmi_marl.experiments.experiment import Experiment, Place
from hmi_marl.experiments.protocols.analysis import (
    CURVES,
    Comparison,
    Dependence,
    Finding,
    Gaming,
    crash_rate,
    curves_of,
    dependence_of,
    gaming_of,
    over_seeds,
    pooled,
    swap_matrix,
    worst_finding,
)
from hmi_marl.experiments.protocols.plan import (
    ALL_DRIVERS,
    TWO_STAGE,
    ComparisonSettings,
    Sums,
    play_all,
)
from hmi_marl.files import json_value
from hmi_marl.reporting import statistics
from hmi_marl.reporting.blocks import Block, Figure, Table, Text, canvas, png
from hmi_marl.reporting.statistics import number
from hmi_marl.reporting.verdicts import Outcome, Verdict
from hmi_marl.training.jobs import train_all
from hmi_marl.training.protocols.registry import compared
from hmi_marl.training.runs.folder import read_curve

COLOURS = ("#3b3b3b", "#e0a030", "#32a050", "#5aa9e0", "#b0508c")
"""Colours of the protocols, in the order in which they are registered."""
CURVE_TITLES = {
    "team_return": "team return",
    "speed_reward": "speed return",
    "attention_return": "attention return",
    "crash_rate": "crash rate",
}
ABOUT_CURVES = (
    "Means over the seeds, interpolated at common environment steps, with the 95 % band of "
    "Student's t, cut off at the values that occurred (two seeds: thin lines instead). These are "
    "the training episodes, so with actions that were drawn (explored), not the likeliest, by the "
    "policies that learn at the time. In two-stage's first part, and alternating's, there is no "
    "HMI."
)
_OUTCOMES: dict[Finding, Outcome] = {
    "fine": Outcome.SUPPORTED,
    "crashes more": Outcome.PARTLY,
    "GAMED": Outcome.NOT_SUPPORTED,
    "unknown": Outcome.UNTESTABLE,
}


@dataclass(frozen=True)
class ProtocolComparison(ComparisonSettings, Experiment[Comparison]):
    """Train by every protocol with equal environment steps and several seeds, and compare them.

    Learning curves, final returns and their terms, crashes, alerts, wall time, swapped partners,
    and whether crashing pays.

    Raises:
        ValueError, TypeError: a value out of its range, saying what to use instead.
    """

    name = "protocols"
    files = "compare"
    title = "Protocols compared"

    @classmethod
    def quick(cls) -> ProtocolComparison:
        """See :meth:`Experiment.quick`."""
        return cls().coarse()

    def run(self, place: Place) -> Comparison:
        """See :meth:`Experiment.run`."""
        jobs = self.jobs(place.folder)
        train_all(jobs, place.workers, place.command_line, cluster=place.cluster)
        with place.playing(len(self.pairs()) * self.episodes, "episodes") as progress:
            played = play_all(self, place.folder, place.workers, progress)
        curves = {job.folder.name: read_curve(job.folder) for job in jobs}
        return Comparison(self, played, curves, place.workers)

    def judge(self, results: Comparison) -> list[Verdict]:
        """Judge whether each protocol is gamed; two-stage is the reference."""
        gaming = gaming_of(results)
        verdicts = []
        for protocol in results.settings.protocols:
            if protocol == TWO_STAGE:
                continue
            worst = worst_finding(gaming, protocol)
            rows = [row for row in gaming if row.protocol == protocol and row.finding == worst]
            reason: str = worst
            if worst != "fine":
                reason += f" with {', '.join(row.driver for row in rows)}"
            claim = f"{protocol}: crashes no more than {TWO_STAGE}, and crashing does not pay"
            verdicts.append(Verdict(claim, _OUTCOMES[worst], reason))
        return verdicts

    def numbers(self, results: Comparison) -> dict[str, Any]:
        """JSON content, with every seed's numbers."""
        settings, played, gaming = results.settings, results.played, gaming_of(results)
        return {
            "steps_each": settings.steps_each,
            "workers": results.workers,
            "protocols": {
                label: {
                    "crash_rate_pooled": json_value(crash_rate(pooled(played, pairs))),
                    "over_seeds": {
                        metric: over_seeds(played, pairs, metric).as_json()
                        for metric in played[pairs[0]][ALL_DRIVERS].metrics()
                    },
                }
                for label, pairs in results.groups().items()
            },
            "findings": {name: worst_finding(gaming, name) for name in settings.protocols},
            "gaming": json_value(gaming),
            "dependence": json_value(dependence_of(results)),
            "swap_matrix": {
                "protocols": list(settings.protocols),
                "team_return_by_seed_driver_hmi": swap_matrix(results).tolist(),
            },
            "pairs": [
                vars(pair) | {"by_driver": {name: _metrics(sums) for name, sums in drivers.items()}}
                for pair, drivers in played.items()
            ],
            "training_seconds": {run.name: results.seconds(run) for run in settings.runs},
            "curves": {name: json_value(curves_of(results, name)) for name in settings.protocols},
        }

    def blocks(self, results: Comparison) -> list[Block]:
        """Show all tables and figures, each with a note."""
        settings = results.settings
        driver_steps, hmi_steps = settings.steps_apart
        return [
            Text(
                f"Every run: {settings.steps_each:,} environment steps. Two-stage and alternating "
                f"give {driver_steps:,} of them to the driver and {hmi_steps:,} to the HMI; in the "
                "others both learn in all."
            ),
            summary_table(results),
            Text(ABOUT_CURVES, "Learning curves"),
            Figure("curves", "Learning curves", partial(curves_figure, results)),
            Figure("terms", "The eight reward terms", partial(terms_figure, results)),
            terms_table(results),
            Figure("swap", "Swapped partners", partial(swap_figure, results)),
            swap_table(results),
            dependence_table(results),
            gaming_table(results),
            time_table(results),
        ]


def _metrics(sums: Sums) -> dict[str, Any]:
    counted = {name: getattr(sums, name) for name in ("episodes", "crashes", "steps", "alerts")}
    return counted | dict(json_value(sums.metrics()))


def summary_table(comparison: Comparison) -> Table:
    """Show the protocols and the baselines of known policies."""
    metrics = {
        "team return": ("team_return", "z.1f"),
        "per step": ("team_return_per_step", "z.2f"),
        "attention return": ("attention_return", "z.1f"),
        "speed return": ("speed_reward", "z.1f"),
        "crashes [%]": ("", ""),
        "alerts/min": ("alerts_per_minute", "z.1f"),
        "steps": ("length", "z.1f"),
        "headway [s]": ("time_headway", ".2f"),
    }
    rows = [
        [
            label,
            *(
                over_seeds(comparison.played, pairs, metric).shown(form)
                if metric
                else crash_rate(pooled(comparison.played, pairs)).percent()
                for metric, form in metrics.values()
            ),
        ]
        for label, pairs in comparison.groups().items()
    ]
    note = (
        f"Means over {comparison.settings.seeds} seeds of {comparison.settings.episodes} episodes "
        "each, the same ones for every pair, likeliest actions; in brackets Student's t interval "
        "(95 %) over the seeds. Crashes: episodes of all seeds together with Wilson's interval, "
        "which does not show how runs differ. when-distracted is the exact alert optimum for the "
        "paper's drivers. steps: of an episode; a crash ends it. headway: mean of the episodes' "
        "medians while a vehicle is ahead."
    )
    return Table("Final team return, crashes and alerts", ["driver and HMI", *metrics], rows, note)


def terms_table(comparison: Comparison) -> Table:
    """Show the eight reward terms per episode."""
    rows = [
        [label, *(over_seeds(comparison.played, pairs, term).shown() for term in TERMS)]
        for label, pairs in comparison.groups().items()
    ]
    note = "Per episode. In the figure a dot for each seed."
    return Table("The eight reward terms", ["driver and HMI", *TERMS], rows, note)


def swap_table(comparison: Comparison) -> Table:
    """Show the team return of every driver with every HMI; own pairs in asterisks."""
    protocols, matrix = comparison.settings.protocols, swap_matrix(comparison)
    rows = []
    for i, protocol in enumerate(protocols):
        entries = [statistics.mean(matrix[:, i, j]).shown() for j in range(len(protocols))]
        entries[i] = f"*{entries[i]}*"
        rows.append([protocol, *entries])
    note = (
        "Team return per episode of the driver of one run with the HMI of another of the same "
        "seed, the same episodes for all; own pairs are marked."
    )
    head = ["driver of", *(f"HMI of {name}" for name in protocols)]
    return Table("Swapped partners", head, rows, note)


def dependence_table(comparison: Comparison) -> Table:
    """Show how much partners depend on each other."""
    note = (
        "Own pairs minus swapped pairs, ½ [M(a,a) + M(b,b)] - ½ [M(a,b) + M(b,a)] with M the team "
        "return of a's driver with b's HMI: 0 if partners could be exchanged freely, however good "
        "each is. On protocol: mean over the other protocols (each number is shared by both of a "
        "pair); on seed: over the other runs of the protocol. Intervals are over the seeds, whose "
        "pairs overlap among the latter."
    )
    columns: dict[str, Callable[[Dependence], str]] = {
        "protocol": lambda row: row.protocol,
        "own pair": lambda row: row.own.shown(),
        "driver, others' HMIs": lambda row: row.driver_with_others.shown(),
        "HMI, others' drivers": lambda row: row.hmi_with_others.shown(),
        "dependence on protocol": lambda row: row.on_protocol.shown("+z.1f"),
        "pairs across seeds": lambda row: row.other_seeds.shown(),
        "dependence on seed": lambda row: row.on_seed.shown("+z.1f"),
    }
    title = "How much partners depend on each other"
    return Table.of(title, dependence_of(comparison), columns, note)


def gaming_table(comparison: Comparison) -> Table:
    """Show crash rates with and without an end at the crash, and whether crashing pays."""
    note = (
        "Crashes: a crash ends the episode, in training and now. Trained standing: one run trained "
        "with end_at_crash=False, where a crashed car stands until the time is over (whether it "
        "crashes does not depend on what would follow, so the rate is that of both settings); "
        "return, stands: its team return in that setting. worth of a step: mean reward of a step "
        "that the driver learns from, without the collision term; where it is negative, ending "
        "early pays. GAMED: crashes more often than two-stage's (intervals more than "
        f"{criteria.MORE_CRASHES:g} apart) and a step's worth is negative; crashes more: only the "
        "former; fine: neither. The two-stage driver learns from driving alone and is the "
        "reference, a mild one if it has not learned long enough."
    )
    columns: dict[str, Callable[[Gaming], str]] = {
        "protocol": lambda row: row.protocol,
        "driver": lambda row: row.driver,
        "crashes [%]": lambda row: row.crash_rate.percent(),
        "two-stage's [%]": lambda row: row.two_stage_crash_rate.percent(),
        "team return": lambda row: number(row.team_return, "z.1f"),
        "per step": lambda row: number(row.team_return_per_step, "z.2f"),
        "worth of a step": lambda row: number(row.worth_of_a_step, "+z.2f"),
        "trained standing [%]": lambda row: row.crash_rate_if_trained_standing.percent(),
        "return, stands": lambda row: number(row.team_return_standing, "z.1f"),
        "finding": lambda row: row.finding,
    }
    return Table.of("Does crashing pay?", gaming_of(comparison), columns, note)


def time_table(comparison: Comparison) -> Table:
    """Show the wall time of each protocol's runs."""
    rows = []
    for protocol in comparison.settings.protocols:
        seconds = [comparison.seconds(run) for run in comparison.runs(protocol)]
        spent = statistics.mean(seconds, lowest=0.0)
        steps = comparison.curves[comparison.runs(protocol)[0].name][-1]["steps"]
        rows.append([protocol, f"{steps}", spent.shown(), f"{steps / spent.mean:.0f}"])
    note = f"Training only, in parallel (workers: {comparison.workers}, a thread each)."
    head = ["protocol", "environment steps", "seconds of a run", "steps/s"]
    return Table("Wall time", head, rows, note)


def colour_of(protocol: str) -> str:
    """Return a protocol's colour in all figures."""
    return COLOURS[list(compared()).index(protocol) % len(COLOURS)]


def curves_figure(comparison: Comparison) -> bytes:
    """Draw learning curves: mean over seeds with the 95 % band, over environment steps.

    The band of two seeds is nine times their standard deviation to either side and would hide the
    rest; they are drawn as thin lines instead.
    """
    figure = canvas(11, 7)
    panels = dict(zip(CURVES, figure.subplots(2, 2).flat, strict=True))
    for protocol in comparison.settings.protocols:
        for name, curve in curves_of(comparison, protocol).items():
            axes, colour = panels[name], colour_of(protocol)
            million = curve.steps / 1e6
            axes.plot(million, curve.mean, color=colour, linewidth=1.4, label=protocol)
            if comparison.settings.seeds > 2:
                axes.fill_between(million, curve.low, curve.high, color=colour, alpha=0.15, lw=0)
                continue
            for run in comparison.runs(protocol):
                rows = comparison.curves[run.name]
                seen = [row["steps"] / 1e6 for row in rows], [row[name] for row in rows]
                axes.plot(*seen, color=colour, linewidth=0.6, alpha=0.6)
    shown = [comparison.curves[run.name] for run in comparison.settings.main_runs]
    for name, axes in panels.items():
        values = [row[name] for rows in shown for row in rows]
        edge = 0.05 * (max(values) - min(values)) or 0.05
        axes.set_ylim(min(values) - edge, max(values) + edge)
        axes.set_title(CURVE_TITLES[name])
        axes.set_xlabel("environment steps [million]")
        axes.spines[["top", "right"]].set_visible(False)
    lines = panels[CURVES[0]].get_legend_handles_labels()
    figure.legend(*lines, loc="outside lower center", ncols=len(compared()))
    return png(figure)


def swap_figure(comparison: Comparison) -> bytes:
    """Draw team returns of every driver (rows) with every HMI (columns), own pairs framed."""
    protocols, returns = comparison.settings.protocols, swap_matrix(comparison).mean(axis=0)
    size = 2.6 + 1.15 * len(protocols)
    figure = canvas(size + 1, size * 0.85)
    from matplotlib.patches import Rectangle

    axes = figure.subplots()
    drawn = axes.imshow(returns, cmap="viridis", aspect="auto")
    figure.colorbar(drawn, ax=axes, label="team return")
    middle = (returns.min() + returns.max()) / 2.0
    for (row, column), value in np.ndenumerate(returns):
        colour = "white" if value < middle else "black"
        weight = "bold" if row == column else "normal"
        how: dict[str, Any] = {"ha": "center", "va": "center", "color": colour, "weight": weight}
        axes.text(column, row, f"{value:.0f}", **how)
        if row == column:
            corner = (column - 0.48, row - 0.48)
            axes.add_patch(Rectangle(corner, 0.96, 0.96, fill=False, edgecolor="red", linewidth=2))
    labels = [name.replace("-", "-\n") for name in protocols]
    axes.set_xticks(range(len(protocols)), labels)
    axes.set_yticks(range(len(protocols)), labels)
    axes.set_xlabel("HMI of")
    axes.set_ylabel("driver of")
    return png(figure)


def terms_figure(comparison: Comparison) -> bytes:
    """Draw the reward terms per episode: a bar for each protocol, a dot for each seed."""
    protocols = comparison.settings.protocols
    figure = canvas(11, 5.6)
    for axes, term in zip(figure.subplots(2, 4).flat, TERMS, strict=True):
        for place, protocol in enumerate(protocols):
            pairs = comparison.own_pairs(protocol)
            mean = over_seeds(comparison.played, pairs, term).mean
            seeds = [comparison.played[p][ALL_DRIVERS].per_episode([term]) for p in pairs]
            axes.bar(place, mean, 0.8, color=colour_of(protocol), alpha=0.75, label=protocol)
            axes.plot([place] * len(seeds), seeds, "k.", markersize=5)
        axes.axhline(0, color="#333", linewidth=0.8)
        axes.set_xticks([])
        axes.set_title(term)
        axes.spines[["top", "right"]].set_visible(False)
    bars = figure.axes[0].get_legend_handles_labels()
    figure.legend(*bars, loc="outside lower center", ncols=len(compared()))
    return png(figure)
