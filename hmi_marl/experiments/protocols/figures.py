"""Figures of a comparison."""

from __future__ import annotations

from typing import Any

import numpy as np

from hmi_marl.experiments.episode_sums import ends_of
from hmi_marl.experiments.protocols.arms import SIMULTANEOUS, TWO_STAGE
from hmi_marl.experiments.protocols.cross_play import cell_of, drivers_of, hmis_of
from hmi_marl.experiments.protocols.findings import sweep
from hmi_marl.experiments.protocols.results import TaskResults
from hmi_marl.reporting import statistics
from hmi_marl.reporting.drawing import canvas, png
from hmi_marl.reporting.many_runs import performance_profile
from hmi_marl.training.protocols.registry import compared

COLOURS = ("#6b7280", "#e0a030", "#32a050", "#5aa9e0", "#b0508c", "#6a5acd")
"""Colours of the protocols, in the order in which they are registered."""
CURVES = {
    "attention_return": "attention return",
    "team_return": "team return",
    "driving_return": "driving return",
    "crash_rate": "crash rate",
}
"""Quantities that are drawn over environment steps, and their titles."""


def colour_of(protocol: str) -> str:
    """Return a protocol's colour in all figures."""
    names = list(compared())
    return COLOURS[names.index(protocol) % len(COLOURS)]


def curves_figure(results: TaskResults) -> bytes:
    """Draw returns of the snapshots over environment steps: mean over runs and its interval."""
    figure = canvas(11, 7)
    panels = dict(zip(CURVES, figure.subplots(2, 2).flat, strict=True))
    for protocol in results.plan.protocols:
        runs = [results.curves[run.name] for run in results.plan.runs_of(protocol)]
        million = np.array([steps for steps, _ in runs[0]]) / 1e6
        for name, axes in panels.items():
            points = [
                statistics.mean([run[k][1][name] for run in runs], *ends_of(name))
                for k in range(len(million))
            ]
            colour = colour_of(protocol)
            axes.plot(million, [p.mean for p in points], "o-", ms=3, color=colour, label=protocol)
            if len(runs) > 2:  # the interval of two runs would hide the rest
                low, high = [p.low for p in points], [p.high for p in points]
                axes.fill_between(million, low, high, color=colour, alpha=0.15, lw=0)
    for name, axes in panels.items():
        axes.set_title(CURVES[name])
        axes.set_xlabel("environment steps [million]")
        axes.spines[["top", "right"]].set_visible(False)
    lines = next(iter(panels.values())).get_legend_handles_labels()
    figure.legend(*lines, loc="outside lower center", ncols=len(results.plan.protocols))
    return png(figure)


def cross_figure(results: TaskResults) -> bytes:
    """Draw attention returns of every arm's drivers (rows) with every arm's HMIs (columns)."""
    from matplotlib.patches import Rectangle

    drivers, hmis = drivers_of(results), hmis_of(results)
    cells = [[cell_of(results, one, other) for other in hmis] for one in drivers]
    returns = np.array([[cell.same_seed.mean for cell in row] for row in cells])
    figure = canvas(2.6 + 1.15 * len(hmis), 1.6 + 0.85 * len(drivers))
    axes = figure.subplots()
    drawn = axes.imshow(returns, cmap="viridis", aspect="auto")
    figure.colorbar(drawn, ax=axes, label="attention return")
    middle = (np.nanmin(returns) + np.nanmax(returns)) / 2.0
    for (row, column), value in np.ndenumerate(returns):
        own = drivers[row] == hmis[column]
        colour = "white" if value < middle else "black"
        weight = "bold" if own else "normal"
        how: dict[str, Any] = {"ha": "center", "va": "center", "color": colour, "weight": weight}
        axes.text(column, row, f"{value:.0f}", **how)
        if own:
            corner = (column - 0.48, row - 0.48)
            axes.add_patch(Rectangle(corner, 0.96, 0.96, fill=False, edgecolor="red", linewidth=2))
    axes.set_xticks(range(len(hmis)), [name.replace("-", "-\n") for name in hmis])
    axes.set_yticks(range(len(drivers)), drivers)
    axes.set_xlabel("HMI of")
    axes.set_ylabel("driver of")
    return png(figure)


def sweep_figure(results: TaskResults) -> bytes:
    """Draw returns against the divergence from the natural driver, a point for each λ."""
    figure = canvas(9, 4)
    points = sweep(results)
    panels = {"attention_return": "attention return", "team_return": "team return"}
    for axes, (name, title) in zip(figure.subplots(1, 2), panels.items(), strict=True):
        across = [p.divergence.mean for p in points]
        values = [getattr(p, name) for p in points]
        axes.plot(across, [v.mean for v in values], "-", color="#9aa1ab", lw=1)
        for point, value, x in zip(points, values, across, strict=True):
            ends = {SIMULTANEOUS: colour_of(SIMULTANEOUS), TWO_STAGE: colour_of(TWO_STAGE)}
            colour = ends.get(point.arm, "#b0508c")
            bar = [[value.mean - value.low], [value.high - value.mean]]
            axes.errorbar([x], [value.mean], yerr=np.nan_to_num(bar), fmt="o", color=colour, ms=5)
            label = {SIMULTANEOUS: "free", TWO_STAGE: "two-stage"}.get(
                point.arm, f"λ {point.weight:g}"
            )
            axes.annotate(label, (x, value.mean), (4, 5), textcoords="offset points", fontsize=8)
        axes.set_title(title)
        axes.set_xlabel("divergence from the natural driver [nats per step]")
        axes.spines[["top", "right"]].set_visible(False)
    return png(figure)


def profile_figure(results: TaskResults) -> bytes:
    """Draw the share of runs and drivers that score more than each threshold."""
    figure = canvas(7, 4)
    axes = figure.subplots()
    scores = {name: results.scores(results.own(name)) for name in results.plan.protocols}
    lowest = min(float(each.min()) for each in scores.values())
    thresholds = np.linspace(max(-0.5, lowest - 0.02), 1.02, 101)
    for name, each in scores.items():
        profile, colour = performance_profile(each, thresholds), colour_of(name)
        axes.plot(thresholds, profile.share, color=colour, label=name)
        if len(each) > 1:
            axes.fill_between(thresholds, profile.low, profile.high, color=colour, alpha=0.15, lw=0)
    axes.set_xlabel("score (0: no alerts, 1: optimum that sees attention)")
    axes.set_ylabel("share of runs and drivers above")
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(fontsize=8)
    return png(figure)
