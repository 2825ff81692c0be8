"""Figures of a table of HMIs and drivers."""

from __future__ import annotations

import math
from io import BytesIO

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hmi_marl.experiments.metrics_table.table import Cell, TableConfig
from hmi_marl.reporting.statistics import Estimate

COLOURS = ("#9aa1ab", "#e0a030", "#5aa9e0", "#32a050", "#b0508c", "#6a5acd", "#c05040")
PANELS = (
    ("speed_return", "speed return"),
    ("distraction_return", "distraction return"),
    ("crash_rate", "crash rate"),
    ("alerts", "alerts per minute"),
)


def table_figure(config: TableConfig, cells: list[Cell], narrow: bool = False) -> bytes:
    """Bars with 95 % intervals for each driver and HMI, the exact values marked. A PNG.

    Args:
        config: what is in the table.
        cells: all of it.
        narrow: for a telephone, panels one below the other and type that is still read there.
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
        image = BytesIO()
        figure.savefig(image, format="png", dpi=110)
    return image.getvalue()


def _bars(axes: Axes, config: TableConfig, cells: list[Cell], name: str) -> None:
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
