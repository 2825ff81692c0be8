"""Figures of tables of HMIs and drivers."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hmi_marl.experiments.metrics_table.paper_table import AVERAGE, METRICS, NONE, PaperTable
from hmi_marl.experiments.metrics_table.table import Cell, TableConfig
from hmi_marl.reporting.blocks import COLOURS, png
from hmi_marl.reporting.statistics import Estimate

PANELS = (
    ("speed_return", "speed return"),
    ("distraction_return", "distraction return"),
    ("crash_rate", "crash rate"),
    ("alerts", "alerts per minute"),
)


def table_figure(config: TableConfig, cells: Sequence[Cell], narrow: bool = False) -> bytes:
    """Draw bars with 95 % intervals for each driver and HMI, the exact values marked. A PNG.

    Args:
        config: settings of the table.
        cells: all of them.
        narrow: for a telephone: panels one below the other, and larger type.
    """
    size, shape, columns = ((5.4, 12), (4, 1), 2) if narrow else ((11, 6.4), (2, 2), 6)
    with rc_context({"font.size": 14} if narrow else {}):
        figure = Figure(figsize=size, layout="constrained")
        for axes, (name, title) in zip(figure.subplots(*shape).flat, PANELS, strict=True):
            _bars(axes, config, cells, name)
            axes.set_title(title)
        axes = figure.axes[1]  # the one that also has the exact marks
        handles = axes.get_legend_handles_labels()
        figure.legend(*handles, loc="outside lower center", ncols=columns)
        return png(figure)


def paper_figure(tables: Sequence[PaperTable]) -> bytes:
    """Draw our returns, the exact values and the paper's, by driver and HMI. A PNG."""
    drawing = Figure(figsize=(11, 3.4 * len(tables)), layout="constrained")
    panels = drawing.subplots(len(tables), 2, squeeze=False)
    for table, pair in zip(tables, panels, strict=True):
        for axes, (metric, title, printed) in zip(pair, METRICS, strict=True):
            width = 0.8 / len(table.rows)
            for k, hmi in enumerate(table.rows):
                at = np.arange(len(table.columns)) + (k + 0.5) * width - 0.4
                cells = [table.cells[hmi, driver] for driver in table.columns]
                means = np.array([getattr(cell, metric).mean for cell in cells])
                name = hmi if hmi in (AVERAGE, NONE) else f"HMI for {hmi}"
                axes.bar(at, means, width * 0.92, color=COLOURS[k % len(COLOURS)], label=name)
                if metric == "distraction_return":
                    exact = [cell.exact_distraction_return_same_steps for cell in cells]
                    axes.plot(at, exact, "k_", markersize=8, label="exact" if k == 0 else None)
                rows = [table.paper_row(hmi, driver) for driver in table.columns]
                shown = [
                    (x, printed[row][driver])
                    for x, row, driver in zip(at, rows, table.columns, strict=True)
                    if row
                ]
                label = "paper" if hmi == NONE else None
                axes.plot(*zip(*shown, strict=True), "r.", markersize=7, label=label)
            axes.set_xticks(np.arange(len(table.columns)), table.columns)
            axes.set_title(f"{title}, {table.variant.title}")
            axes.spines[["top", "right"]].set_visible(False)
    drawing.legend(*panels[0][0].get_legend_handles_labels(), loc="outside lower center", ncols=8)
    return png(drawing)


def _bars(axes: Axes, config: TableConfig, cells: Sequence[Cell], name: str) -> None:
    places = np.arange(len(config.drivers))
    width = 0.8 / len(config.hmis)
    for row, hmi in enumerate(config.hmis):
        own = {cell.driver: cell for cell in cells if cell.hmi == hmi}
        estimates: list[Estimate] = [getattr(own[driver], name) for driver in config.drivers]
        means = np.array([estimate.mean for estimate in estimates])
        ends = np.array([[estimate.low, estimate.high] for estimate in estimates]).T
        errors = np.nan_to_num(np.abs(ends - means))
        at = places + (row + 0.5) * width - 0.4
        colour = COLOURS[row % len(COLOURS)]
        axes.bar(
            at,
            means,
            width * 0.92,
            yerr=errors,
            color=colour,
            label=hmi,
            error_kw={"elinewidth": 1, "ecolor": "#333"},
        )
        if name == "distraction_return":
            exact = [own[driver].exact_distraction_return_same_steps for driver in config.drivers]
            marks = [math.nan if value is None else value for value in exact]
            label = "exact, same number of steps" if row == len(config.hmis) - 1 else None
            axes.plot(at, marks, "k_", markersize=9, markeredgewidth=2, label=label)
    axes.set_xticks(places, config.drivers)
    axes.spines[["top", "right"]].set_visible(False)
    axes.axhline(0, color="#333", linewidth=0.8)
