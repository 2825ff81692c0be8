"""The reproduced table for people: text, JSON, a figure and a page, the paper's figures beside."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from io import BytesIO
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from hmi_marl.evaluation.figures import COLOURS
from hmi_marl.evaluation.page import html_table, image, page, text_table
from hmi_marl.evaluation.paper import DISTRACTION_RETURNS, SPEED_RETURNS, mean_over_drivers
from hmi_marl.evaluation.reproduction import (
    AVERAGE,
    NONE,
    TOLERANCE,
    ReproducedTable,
    agrees_with_exact,
    shortfall,
)
from hmi_marl.evaluation.statistics import Estimate
from hmi_marl.evaluation.table import Cell

METRICS = (
    ("distraction_return", "Distraction return", DISTRACTION_RETURNS),
    ("speed_return", "Speed return", SPEED_RETURNS),
)
CLOSE = 0.1
"""A figure of the paper agrees with ours within this share of it, or within our interval."""


def paper_verdict(cell: Cell, metric: str, printed: float) -> str:
    """What our data say of a figure that the paper prints."""
    got: Estimate = getattr(cell, metric)
    if metric == "distraction_return":
        reach = cell.reachable_distraction_return
        # The paper's episodes may have been a few steps shorter than ours.
        if not reach.least * 1.001 <= printed <= reach.most * 0.94:
            return "out of reach of every alert policy"
    if got.low <= printed <= got.high or abs(got.mean - printed) <= CLOSE * abs(printed):
        return "agrees"
    return f"differs by {got.mean - printed:+.0f}"


def _entry(table: ReproducedTable, hmi: str, driver: str, metric: str, printed: Mapping) -> str:  # type: ignore[type-arg]
    cell = table.cells[hmi, driver]
    got: Estimate = getattr(cell, metric)
    lines = [f"{got.mean:.0f} [{got.low:.0f}, {got.high:.0f}]"]
    if metric == "distraction_return" and cell.exact_distraction_return_same_steps is not None:
        verdict = "" if agrees_with_exact(cell) else ", MISSED"
        lines.append(f"exact {cell.exact_distraction_return_same_steps:.0f}{verdict}")
        reach = cell.reachable_distraction_return
        lines.append(f"reachable {reach.least:.0f} to {reach.most:.0f}")
    row = table.paper_row(hmi, driver)
    if row is None:
        lines.append("paper *")
    else:
        value = printed[row][driver]
        lines.append(f"paper {value:.0f}: {paper_verdict(cell, metric, value)}")
    return "\n".join(lines)


def rows_of(table: ReproducedTable, metric: str, printed: Mapping) -> list[list[str]]:  # type: ignore[type-arg]
    """The table's rows for one metric, entries of several lines."""
    return [
        [hmi, *(_entry(table, hmi, driver, metric, printed) for driver in table.columns)]
        for hmi in table.rows
    ]


def averages(table: ReproducedTable) -> list[list[str]]:
    """The three averages over drivers that the paper's text compares, ours beside them."""
    rows = []
    for label, row in (("personalised", "own"), ("average", AVERAGE), ("none", NONE)):
        entries = [label]
        for metric, _, printed in METRICS:
            cells = [
                table.own(driver) if row == "own" else table.cells[row, driver]
                for driver in table.columns
            ]
            ours = np.mean([getattr(cell, metric).mean for cell in cells])
            halves = [(e.high - e.low) / 2 for e in (getattr(cell, metric) for cell in cells)]
            half = np.sqrt(np.sum(np.square(halves))) / len(cells)
            entries.append(f"{ours:.0f} ± {half:.0f}, paper {mean_over_drivers(printed[row]):.0f}")
        rows.append(entries)
    return rows


def optimum_rows(table: ReproducedTable) -> list[list[str]]:
    """Each driver with their own HMI: its attention return beside the exact optimum's."""
    rows = []
    for driver, cell in table.with_own_hmi().items():
        got = cell.attention_return
        missing = shortfall(cell)
        rows.append(
            [
                driver,
                f"{got.mean:.1f} [{got.low:.1f}, {got.high:.1f}]",
                f"{cell.optimal_attention_return_same_steps:.1f}",
                f"{100 * missing:+.2f} %",
                "at the optimum" if missing <= TOLERANCE else "MISSED",
            ]
        )
    return rows


OPTIMUM_HEAD = ["driver", "attention return, own HMI", "exact optimum", "missing", "verdict"]
AVERAGE_HEAD = ["HMI", "distraction return", "speed return"]
CAPTION = (
    "Each entry: mean over the episodes with its 95 % interval; the exact expectation for the "
    "alert rule that is optimal for the driver the HMI was trained for, over as many steps as the "
    "episodes had; the range that any alert policy can reach; the paper's figure. "
    f"MISSED: farther than {100 * TOLERANCE:.0f} % and the interval from the exact value."
)


def as_text(tables: list[ReproducedTable], seconds: Mapping[str, float]) -> str:
    """Everything for a terminal."""
    blocks = []
    for table in tables:
        for metric, title, printed in METRICS:
            rows = []
            for row in rows_of(table, metric, printed):
                lines = [entry.split("\n") for entry in row]
                for k in range(max(len(entry) for entry in lines)):
                    rows.append([entry[k] if k < len(entry) else "" for entry in lines])
            head = ["HMI for", *table.columns]
            blocks.append(f"{title}, {table.variant.title}\n{text_table(head, rows)}")
        blocks.append(
            f"Averages over the drivers, {table.variant.title}\n"
            + text_table(AVERAGE_HEAD, averages(table))
        )
        blocks.append(
            f"Own HMI beside the exact optimum, {table.variant.title}\n"
            + text_table(OPTIMUM_HEAD, optimum_rows(table))
        )
    blocks.append(CAPTION)
    times = [[part, f"{spent:.0f} s"] for part, spent in seconds.items()]
    blocks.append("Time of each part\n" + text_table(["part", "time"], times))
    return "\n\n".join(blocks)


def as_json(tables: list[ReproducedTable], seconds: Mapping[str, float]) -> dict[str, Any]:
    """Everything for programs."""
    return {
        "tables": {
            table.variant.name: [
                cell.as_json()
                | {
                    "hmi": hmi,
                    "driver": driver,
                    "agrees_with_exact": agrees_with_exact(cell),
                    "attention_shortfall": shortfall(cell),
                    "paper": {
                        metric: printed[row][driver] if row else None
                        for metric, _, printed in METRICS
                        for row in (table.paper_row(hmi, driver),)
                    },
                }
                for (hmi, driver), cell in table.cells.items()
            ]
            for table in tables
        },
        "attention_shortfall_of_own_hmis": {
            table.variant.name: {
                driver: shortfall(cell) for driver, cell in table.with_own_hmi().items()
            }
            for table in tables
        },
        "seconds": dict(seconds),
    }


def figure(tables: list[ReproducedTable]) -> bytes:
    """Ours, the exact values and the paper's, by driver and HMI. A PNG."""
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
    content = BytesIO()
    drawing.savefig(content, format="png", dpi=110)
    return content.getvalue()


def as_html(
    tables: list[ReproducedTable],
    seconds: Mapping[str, float],
    drawing: bytes,
    command: str,
    settings: Mapping[str, Any],
) -> str:
    """One page that needs nothing besides itself; ``drawing`` is what :func:`figure` gave."""
    parts = [f"<p>{escape(CAPTION)}</p>", image("png", drawing, "bars of both tables")]
    for table in tables:
        for metric, title, printed in METRICS:
            parts.append(f"<h2>{escape(title)}, {escape(table.variant.title)}</h2>")
            parts.append(html_table(["HMI for", *table.columns], rows_of(table, metric, printed)))
        parts.append(f"<h2>Averages over the drivers, {escape(table.variant.title)}</h2>")
        parts.append(html_table(AVERAGE_HEAD, averages(table)))
        parts.append(f"<h2>Own HMI beside the optimum, {escape(table.variant.title)}</h2>")
        parts.append(html_table(OPTIMUM_HEAD, optimum_rows(table)))
    parts.append("<h2>Time of each part</h2>")
    parts.append(html_table(["part", "time"], [[p, f"{s:.0f} s"] for p, s in seconds.items()]))
    return page("The paper's table", "\n".join(parts), command, settings)
