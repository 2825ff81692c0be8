"""Figure of adaptive HMIs: regret, and belief in the true type, by time at the wheel."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from hmi_marl.experiments import criteria
from hmi_marl.experiments.adaptation.evaluation import (
    CHANGE_STEP,
    CHANGE_TRIP,
    POPULATION,
    TEAM,
    Result,
)
from hmi_marl.experiments.adaptation.hmis import (
    AVERAGE,
    BAYES,
    CHOOSING,
    CONDITIONED,
    EXPECTED,
)
from hmi_marl.reporting.blocks import Figure
from hmi_marl.reporting.drawing import canvas, ink, png

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLOURS = {
    AVERAGE: "#9aa1ab",
    EXPECTED: "#32a050",
    EXPECTED + BAYES: "#5aa9e0",
    CHOOSING: "#e0a030",
    CONDITIONED: "#b0508c",
}


def figure(results: Sequence[Result]) -> Figure:
    """Show regret, and belief in the true type, by time driven."""
    return Figure(
        "adapt",
        "Regret and belief by time at the wheel",
        partial(_draw, results),
        sources=["/results"],
    )


def _draw(results: Sequence[Result]) -> bytes:
    drivers = criteria.GAP_DRIVERS
    shown = [r for r in results if r.group in (*drivers, POPULATION)]
    shown += [r for r in results if r.after_change and r.group.endswith(drivers)]
    drawing = canvas(3.4 * len(shown), 5.6)
    axes = drawing.subplots(2, len(shown), squeeze=False)
    for column, result in zip(axes.T, shown, strict=True):
        _draw_regret(column[0], result)
        _draw_belief(column[1], result)
    axes[0, 0].set_ylabel("regret per step")
    axes[1, 0].set_ylabel("probability of the true type")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    drawing.legend(handles, labels, loc="outside lower center", ncols=5)
    return png(drawing, 100)


def _draw_regret(axes: Axes, result: Result) -> None:
    for hmi in (AVERAGE, EXPECTED, EXPECTED + BAYES, CHOOSING, CONDITIONED):
        values = np.array(result.regret[hmi])
        smooth = np.convolve(values, np.full(3, 1 / 3), mode="valid")
        axes.plot(np.arange(len(smooth)) + 1.5, smooth, label=hmi, color=COLOURS[hmi], lw=1.4)
    axes.axhline(0.0, color=ink(), lw=0.8)
    axes.set_title(result.group, fontsize=10)
    _mark_change(axes, result)


def _draw_belief(axes: Axes, result: Result) -> None:
    if not result.belief:
        axes.axis("off")
        return
    for hmi in (EXPECTED, EXPECTED + BAYES):
        values = result.belief[hmi]
        axes.plot(np.arange(len(values)) + 0.5, values, color=COLOURS[hmi], lw=1.4)
    axes.set_ylim(0, 1.02)
    axes.set_xlabel("time at the wheel [s]")
    _mark_change(axes, result)


def _mark_change(axes: Axes, result: Result) -> None:
    if result.after_change:
        seconds = (CHANGE_TRIP * TEAM.horizon + CHANGE_STEP) / TEAM.scene.policy_frequency
        axes.axvline(seconds, color="#888", lw=0.8, ls=":")
