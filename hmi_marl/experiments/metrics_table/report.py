"""A table as text, CSV, JSON and a self-contained HTML page with its figure and a clip."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable
from dataclasses import asdict
from html import escape
from io import StringIO
from pathlib import Path
from typing import Any

import hmi_marl
from hmi_marl.experiments.metrics_table.figures import table_figure
from hmi_marl.experiments.metrics_table.in_short import in_short
from hmi_marl.experiments.metrics_table.table import Cell, TableConfig
from hmi_marl.files import write_bytes, write_json, write_text
from hmi_marl.reporting.page import html_table, image, page, text_table, with_commands
from hmi_marl.reporting.statistics import Estimate

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
NOTE = (
    "Means over seeded episodes with 95 % intervals (Student's t, cut off at 0 for alerts and "
    "headways; Wilson's for the crash rate). "
    "All cells play the same seeds, so their luck is shared. "
    "The exact distraction return is the expectation of the attention chain under that HMI, over "
    "as many steps as the episodes had; a crash may end an episode before its time. "
    "A shortest headway is of the episodes in which another vehicle was ahead."
)


def _number(value: float | None, form: str) -> str:
    return "-" if value is None or not math.isfinite(value) else format(value, form)


def _entry(cell: Cell, metric: str, form: str) -> str:
    estimate: Estimate = getattr(cell, metric)
    text = _number(estimate.mean, form)
    if math.isfinite(estimate.low):
        text += f" [{_number(estimate.low, form)}, {_number(estimate.high, form)}]"
    if metric == "distraction_return" and cell.exact_distraction_return_same_steps is not None:
        text += f" ({_number(cell.exact_distraction_return_same_steps, form)})"
    return text


def _rows(config: TableConfig, cells: list[Cell], metric: str, form: str) -> list[list[str]]:
    found = {(cell.hmi, cell.driver): cell for cell in cells}
    return [
        [hmi, *(_entry(found[hmi, driver], metric, form) for driver in config.drivers)]
        for hmi in config.hmis
    ]


def as_text(config: TableConfig, cells: list[Cell]) -> str:
    """A block for each metric, HMIs in rows and drivers in columns."""
    blocks = []
    for metric, title, form in METRICS:
        rows = text_table(["", *config.drivers], _rows(config, cells, metric, form))
        blocks.append(f"{title}\n{rows}")
    return "\n\n".join(blocks)


def as_json(config: TableConfig, cells: list[Cell], caption: str = "") -> dict[str, Any]:
    """Everything that the table knows, with what it takes to make it again."""
    return {
        "hmi_marl_version": hmi_marl.__version__,
        "config": asdict(config),
        "in_short": [asdict(remark) for remark in in_short(config, cells)],
        "clip": caption,
        "cells": [cell.as_json() for cell in cells],
    }


def as_csv(cells: list[Cell]) -> str:
    """A line for each cell; estimates take three columns."""
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


def as_html(
    config: TableConfig,
    cells: list[Cell],
    figure: bytes,
    clip: bytes | None,
    command: str,
    caption: str = "",
    narrow_figure: bytes | None = None,
) -> str:
    """One page that needs nothing besides itself.

    Args:
        config: what is in the table.
        cells: all of it.
        figure: a PNG.
        clip: a GIF, if there is one.
        command: that makes the page again.
        caption: what is to be seen in the clip, and when.
        narrow_figure: the PNG that a narrow screen shows instead.
    """
    remarks = "".join(
        f"<dt>{escape(remark.title)}</dt><dd>{with_commands(remark.text)}</dd>"
        for remark in in_short(config, cells)
    )
    tables = "".join(
        f"<h2>{escape(title)}</h2>"
        + html_table(["", *config.drivers], _rows(config, cells, metric, form))
        for metric, title, form in METRICS
    )
    moving = ""
    if clip:
        shown = image("gif", clip, caption or "clip of one episode", style="clip")
        moving = f"<h2>One episode</h2>{shown}<p>{escape(caption)}</p>"
    bars = image("png", figure, "bars of each metric by driver and HMI", narrow_figure)
    body = f"""<dl>{remarks}</dl>
{moving}
<h2>Drivers and HMIs</h2>
{bars}
<p class="small">{len(cells)} cells of {config.episodes} episodes each. {escape(NOTE)}</p>
{tables}"""
    return page("HMIs and drivers", body, command, asdict(config))


def write_report(
    out: Path,
    config: TableConfig,
    cells: list[Cell],
    record_clip: Callable[[Path], str | None] | None,
    command: str,
) -> Path:
    """Write table.txt, table.csv, table.json, table.png, clip.gif and index.html into ``out``.

    Args:
        out: the folder.
        config: what is in the table.
        cells: all of it.
        record_clip: writes a GIF to the path it is given, and returns what is to be seen in it;
            None for a page without a clip, which also removes a clip that an earlier table left
            in the folder.
        command: that makes the page again.

    Returns:
        The page's path.
    """
    figure, narrow = (table_figure(config, cells, narrow) for narrow in (False, True))
    write_text(out / "table.txt", as_text(config, cells) + "\n")
    write_text(out / "table.csv", as_csv(cells))
    write_bytes(out / "table.png", figure)
    clip_path, clip, caption = out / "clip.gif", None, ""
    if record_clip is None:
        clip_path.unlink(missing_ok=True)
    else:
        caption = record_clip(clip_path) or ""
        clip = clip_path.read_bytes()
    write_json(out / "table.json", as_json(config, cells, caption))
    page = out / "index.html"
    write_text(page, as_html(config, cells, figure, clip, command, caption, narrow))
    return page
