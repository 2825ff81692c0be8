"""Figures of a comparison of protocols. PNGs."""

from __future__ import annotations

from io import BytesIO
from itertools import cycle

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from hmi_marl.envs.rewards import TERMS
from hmi_marl.experiments.protocols.analysis import (
    CURVES,
    Comparison,
    curves_of,
    over_seeds,
    swap_matrix,
)
from hmi_marl.experiments.protocols.settings import EVERYBODY, PROTOCOLS

COLOURS = dict(zip(PROTOCOLS, cycle(("#3b3b3b", "#e0a030", "#32a050", "#5aa9e0", "#b0508c"))))
"""Of each protocol."""
TITLES = {
    "team_return": "team return",
    "speed_reward": "speed return",
    "attention_return": "attention return",
    "crash_rate": "crash rate",
}


def curves_figure(comparison: Comparison) -> bytes:
    """Learning curves: mean over seeds with the 95 % band, over environment steps.

    The band of two seeds is nine times their standard deviation to either side and hides all
    else; they are drawn as thin lines instead.
    """
    figure = Figure(figsize=(11, 7), layout="constrained")
    panels = dict(zip(CURVES, figure.subplots(2, 2).flat, strict=True))
    for protocol in comparison.settings.protocols:
        for name, curve in curves_of(comparison, protocol).items():
            axes, colour = panels[name], COLOURS[protocol]
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
        axes.set_title(TITLES[name])
        axes.set_xlabel("environment steps [million]")
        axes.spines[["top", "right"]].set_visible(False)
    lines = panels[CURVES[0]].get_legend_handles_labels()
    figure.legend(*lines, loc="outside lower center", ncols=len(PROTOCOLS))
    return _png(figure)


def swap_figure(comparison: Comparison) -> bytes:
    """Team returns of every driver (rows) with every HMI (columns), own pairs framed."""
    protocols, returns = comparison.settings.protocols, swap_matrix(comparison).mean(axis=0)
    size = 2.6 + 1.15 * len(protocols)
    figure = Figure(figsize=(size + 1, size * 0.85), layout="constrained")
    axes = figure.subplots()
    drawn = axes.imshow(returns, cmap="viridis", aspect="auto")
    figure.colorbar(drawn, ax=axes, label="team return")
    middle = (returns.min() + returns.max()) / 2.0
    for (row, column), value in np.ndenumerate(returns):
        colour = "white" if value < middle else "black"
        weight = "bold" if row == column else "normal"
        axes.text(
            column, row, f"{value:.0f}", ha="center", va="center", color=colour, weight=weight
        )
        if row == column:
            corner = (column - 0.48, row - 0.48)
            axes.add_patch(Rectangle(corner, 0.96, 0.96, fill=False, edgecolor="red", linewidth=2))
    labels = [name.replace("-", "-\n") for name in protocols]
    axes.set_xticks(range(len(protocols)), labels)
    axes.set_yticks(range(len(protocols)), labels)
    axes.set_xlabel("HMI of")
    axes.set_ylabel("driver of")
    return _png(figure)


def terms_figure(comparison: Comparison) -> bytes:
    """The eight reward terms per episode: a bar for each protocol, a dot for each seed."""
    protocols = comparison.settings.protocols
    figure = Figure(figsize=(11, 5.6), layout="constrained")
    for axes, term in zip(figure.subplots(2, 4).flat, TERMS, strict=True):
        for place, protocol in enumerate(protocols):
            pairs = comparison.own_pairs(protocol)
            mean = over_seeds(comparison.played, pairs, term).mean
            seeds = [comparison.played[p][EVERYBODY].per_episode([term]) for p in pairs]
            axes.bar(place, mean, 0.8, color=COLOURS[protocol], alpha=0.75, label=protocol)
            axes.plot([place] * len(seeds), seeds, "k.", markersize=5)
        axes.axhline(0, color="#333", linewidth=0.8)
        axes.set_xticks([])
        axes.set_title(term)
        axes.spines[["top", "right"]].set_visible(False)
    bars = figure.axes[0].get_legend_handles_labels()
    figure.legend(*bars, loc="outside lower center", ncols=len(PROTOCOLS))
    return _png(figure)


def _png(figure: Figure) -> bytes:
    content = BytesIO()
    figure.savefig(content, format="png", dpi=110)
    return content.getvalue()
