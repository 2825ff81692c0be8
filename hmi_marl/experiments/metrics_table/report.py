"""Report of a table: text, CSV, JSON, and a page with a figure and a clip."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from dataclasses import asdict
from functools import partial
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hmi_marl.experiments.metrics_table.in_short import in_short
from hmi_marl.experiments.metrics_table.table import Cell, TableConfig
from hmi_marl.files import write_text
from hmi_marl.reporting.blocks import Block, Clip, Figure, Heading, Table, Text
from hmi_marl.reporting.drawing import COLOURS, canvas, ink, png
from hmi_marl.reporting.report import Report
from hmi_marl.reporting.statistics import Estimate, number
from hmi_marl.text import in_figure, printable

if TYPE_CHECKING:
    from matplotlib.axes import Axes

CLIP = "clip"
"""Name of the clip's file."""
METRICS: tuple[tuple[str, str, str], ...] = (
    ("speed_return", "Speed return", ".0f"),
    ("distraction_return", "Distraction return (in brackets: exact, same number of steps)", ".0f"),
    (
        "attention_return",
        "Attention return (what alerts can change: distraction, alert and accept-alert terms)",
        ".0f",
    ),
    ("alerts", "Alerts per minute", ".0f"),
    ("crash_rate", "Crash rate", ".2f"),
    ("min_time_headway", "Shortest time headway [s]", ".2f"),
)
PANELS = (
    ("speed_return", "speed return"),
    ("distraction_return", "distraction return"),
    ("crash_rate", "crash rate"),
    ("alerts", "alerts per minute"),
)
NOTE = (
    "Means over seeded episodes with 95 % intervals (Student's t, cut off at 0 for alerts and "
    "headways; Wilson's for the crash rate). "
    "All cells play the same seeds, so their luck is shared. "
    "The exact distraction return is the expectation of the attention chain under that HMI, over "
    "as many steps as the episodes had; a crash may end an episode before its time. "
    "A shortest headway is of the episodes in which another vehicle was ahead."
)


def make_report(
    config: TableConfig, cells: Sequence[Cell], command_line: str, clip: Clip | None = None
) -> Report:
    """Make the report of a table: remarks, clip (if any), figure and a table for each metric."""
    remarks = in_short(config, cells)
    wide, narrow = (partial(table_figure, config, cells, narrow) for narrow in (False, True))
    described = f"{len(cells)} cells of {config.episodes} episodes each. {NOTE}"
    blocks: list[Block] = [
        *remarks,
        *((Heading("One episode"), clip) if clip else ()),
        Heading("Drivers and HMIs"),
        Figure("table", "bars of each metric by driver and HMI", wide, narrow, sources=["/cells"]),
        Text(described),
        *metric_tables(config, cells),
    ]
    numbers = {
        "in_short": [{"title": remark.lead, "text": remark.text} for remark in remarks],
        "clip": clip.caption if clip else "",
        "cells": [cell.as_json() for cell in cells],
    }
    return Report("table", "HMIs and drivers", blocks, numbers, command_line, asdict(config))


def write_results(
    folder: Path, config: TableConfig, cells: Sequence[Cell], command_line: str
) -> None:
    """Write text, CSV and JSON, for which nothing is drawn."""
    write_text(folder / "table.csv", as_csv(cells))
    make_report(config, cells, command_line).write_results(folder)


def write_report(
    folder: Path,
    config: TableConfig,
    cells: Sequence[Cell],
    command_line: str,
    clip: Clip | None = None,
) -> Path:
    """Write the report and table.csv, remove an earlier clip if there is none; return the page."""
    write_text(folder / "table.csv", as_csv(cells))
    if clip is None:
        (folder / f"{CLIP}.gif").unlink(missing_ok=True)
    return make_report(config, cells, command_line, clip).write(folder)


def metric_tables(config: TableConfig, cells: Sequence[Cell]) -> list[Table]:
    """Make a table for each metric, HMIs in rows and drivers in columns."""
    found = {(cell.hmi, cell.driver): cell for cell in cells}
    return [
        Table(
            title,
            ["", *map(printable, config.drivers)],
            [
                [
                    printable(hmi),
                    *(_entry(found[hmi, driver], metric, form) for driver in config.drivers),
                ]
                for hmi in config.hmis
            ],
            sources=["/cells"],
        )
        for metric, title, form in METRICS
    ]


def _entry(cell: Cell, metric: str, form: str) -> str:
    estimate: Estimate = getattr(cell, metric)
    exact = cell.exact_distraction_return_same_steps
    if metric == "distraction_return" and exact is not None:
        return f"{estimate.shown(form)} ({number(exact, form)})"
    return estimate.shown(form)


def as_csv(cells: Sequence[Cell]) -> str:
    """Write a line for each cell; estimates take three columns."""
    lines = []
    for cell in cells:
        line: dict[str, Any] = {}
        for name, value in vars(cell).items():
            if isinstance(value, Estimate):
                known = value.as_json()
                line |= {
                    name: known["mean"],
                    f"{name}_low": known["low"],
                    f"{name}_high": known["high"],
                }
            elif isinstance(value, tuple):
                line |= {f"{name}_least": value[0], f"{name}_most": value[1]}
            else:
                line[name] = value
        lines.append(line)
    text = StringIO()
    writer = csv.DictWriter(text, list(lines[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(lines)
    return text.getvalue()


def table_figure(config: TableConfig, cells: Sequence[Cell], narrow: bool = False) -> bytes:
    """Draw bars with 95 % intervals and exact values, as PNG; narrow: for a telephone."""
    from matplotlib import rc_context

    size, shape, columns = ((5.4, 12), (4, 1), 2) if narrow else ((11, 6.4), (2, 2), 6)
    with rc_context({"font.size": 14} if narrow else {}):
        figure = canvas(*size)
        for axes, (name, title) in zip(figure.subplots(*shape).flat, PANELS, strict=True):
            _bars(axes, config, cells, name)
            axes.set_title(title)
        axes = figure.axes[1]  # the one that also has the exact marks
        handles = axes.get_legend_handles_labels()
        figure.legend(*handles, loc="outside lower center", ncols=columns)
        return png(figure)


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
        line, label = {"elinewidth": 1, "ecolor": ink()}, in_figure(hmi)
        axes.bar(at, means, width * 0.92, yerr=errors, color=colour, label=label, error_kw=line)
        if name == "distraction_return":
            exact = [own[driver].exact_distraction_return_same_steps for driver in config.drivers]
            marks = [math.nan if value is None else value for value in exact]
            last = "exact, same number of steps" if row == len(config.hmis) - 1 else None
            axes.plot(at, marks, "_", color=ink(), markersize=9, markeredgewidth=2, label=last)
    axes.set_xticks(places, [in_figure(driver) for driver in config.drivers])
    axes.spines[["top", "right"]].set_visible(False)
    axes.axhline(0, color=ink(), linewidth=0.8)
