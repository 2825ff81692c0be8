"""The reproduced table for people: text, JSON, a figure and a page, the paper's figures beside."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from io import BytesIO
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from hmi_marl.experiments.metrics_table.figures import COLOURS
from hmi_marl.experiments.metrics_table.reproduction import (
    AVERAGE,
    NONE,
    TOLERANCE,
    ReproducedTable,
    agrees_with_exact,
    shortfall,
)
from hmi_marl.experiments.metrics_table.table import Cell
from hmi_marl.paper.printed import DISTRACTION_RETURNS, SPEED_RETURNS, mean_over_drivers
from hmi_marl.reporting.blocks import Exhibit, Picture, Table, Told
from hmi_marl.reporting.page import text_table
from hmi_marl.reporting.statistics import Estimate

METRICS = (
    ("distraction_return", "Distraction return", DISTRACTION_RETURNS),
    ("speed_return", "Speed return", SPEED_RETURNS),
)
CLOSE = {"distraction_return": 0.1, "speed_return": 0.03}
"""A figure of the paper agrees with ours within this share of it, or within our interval. Speeds
lie close together whatever anybody does, so they are judged more narrowly."""


def paper_verdict(cell: Cell, metric: str, printed: float) -> str:
    """What our data say of a figure that the paper prints."""
    got: Estimate = getattr(cell, metric)
    if metric == "distraction_return":
        reach = cell.reachable_distraction_return
        # The paper's episodes may have been a few steps shorter than ours.
        if not reach.least * 1.001 <= printed <= reach.most * 0.94:
            return "out of reach of every alert policy"
    if got.agrees(printed, CLOSE[metric]):
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


@dataclass(frozen=True)
class Average:
    """One metric's mean over the four drivers, as the paper's text compares them."""

    hmi: str
    """personalised, average or none."""
    metric: str
    ours: Estimate
    """All cells play the same seeds, so their errors go together: the interval is the mean of the
    cells' intervals, which is right if they do so wholly and too wide otherwise."""
    exact: float | None
    """Of the same steps; None where nothing is known exactly."""
    paper: float

    @property
    def verdict(self) -> str:
        """Whether the paper's figure is ours, and ours the exact one."""
        share = CLOSE[self.metric]
        paper = self.ours.agrees(self.paper, share)
        told = "paper agrees" if paper else f"paper differs by {self.paper - self.ours.mean:+.0f}"
        if self.exact is None:
            return told
        exact = self.ours.agrees(self.exact, TOLERANCE)
        return f"{told}, {'exact' if exact else 'MISSED the exact value'}"


def averages(table: ReproducedTable) -> list[Average]:
    """The averages of both metrics for personalised, average and no HMIs."""
    found = []
    for label, row in (("personalised", "own"), ("average", AVERAGE), ("none", NONE)):
        cells = [
            table.own(driver) if row == "own" else table.cells[row, driver]
            for driver in table.columns
        ]
        for metric, _, printed in METRICS:
            of_cells = [getattr(cell, metric) for cell in cells]
            ours = Estimate(
                *(
                    float(np.mean([getattr(e, end) for e in of_cells]))
                    for end in ("mean", "low", "high")
                )
            )
            exact = [cell.exact_distraction_return_same_steps for cell in cells]
            known = metric == "distraction_return" and None not in exact
            mean_exact = float(np.mean([e for e in exact if e is not None])) if known else None
            paper = mean_over_drivers(printed[row])
            found.append(Average(label, metric, ours, mean_exact, paper))
    return found


def order_verdicts(table: ReproducedTable) -> dict[str, str]:
    """For each metric the paper's order of its three averages, and whether ours is the same.

    Two of ours count as equal where their intervals overlap.
    """
    told = {}
    for metric, title, _ in METRICS:
        three = [average for average in averages(table) if average.metric == metric]
        by_paper = sorted(three, key=lambda average: -average.paper)
        order = " > ".join(average.hmi for average in by_paper)
        pairs = list(pairwise(by_paper))
        if all(a.ours.low > b.ours.high for a, b in pairs):
            verdict = "ours too"
        elif any(b.ours.low > a.ours.high for a, b in pairs):
            verdict = "ours is another"
        else:
            equal = [f"{a.hmi} and {b.hmi}" for a, b in pairs if a.ours.low <= b.ours.high]
            verdict = f"ours too, but that {', '.join(equal)} are equal"
        told[title] = f"paper: {order}; {verdict}"
    return told


def average_rows(table: ReproducedTable) -> list[list[str]]:
    """The averages for people."""
    rows = []
    for average in averages(table):
        ours, exact = average.ours, average.exact
        title = next(title for metric, title, _ in METRICS if metric == average.metric)
        rows.append(
            [
                f"{title}, {average.hmi}",
                f"{ours.mean:.0f} [{ours.low:.0f}, {ours.high:.0f}]",
                "-" if exact is None else f"{exact:.0f}",
                f"{average.paper:.0f}",
                average.verdict,
            ]
        )
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
AVERAGE_HEAD = ["mean over the drivers", "ours", "exact", "paper", "verdict"]
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
            + text_table(AVERAGE_HEAD, average_rows(table))
            + "\n"
            + "\n".join(f"  {title}: {told}" for title, told in order_verdicts(table).items())
        )
        blocks.append(
            f"Own HMI beside the exact optimum, {table.variant.title}\n"
            + text_table(OPTIMUM_HEAD, optimum_rows(table))
        )
    blocks.append(CAPTION)
    times = [[part, f"{spent:.0f} s"] for part, spent in seconds.items()]
    blocks.append("Time of each part\n" + text_table(["part", "time"], times))
    return "\n\n".join(blocks)


def as_json(tables: list[ReproducedTable]) -> dict[str, Any]:
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
        "averages": {
            table.variant.name: [
                vars(average) | {"ours": average.ours.as_json(), "verdict": average.verdict}
                for average in averages(table)
            ]
            for table in tables
        },
        "orders": {table.variant.name: order_verdicts(table) for table in tables},
        "average_driver_with_own_hmi": {
            table.variant.name: table.average.as_json() | {"hmi": AVERAGE}  # not where it lies
            for table in tables
            if table.average
        },
        "attention_shortfall_of_own_hmis": {
            table.variant.name: {
                driver: shortfall(cell) for driver, cell in table.with_own_hmi().items()
            }
            for table in tables
        },
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


def exhibits(tables: list[ReproducedTable]) -> tuple[Exhibit, ...]:
    """What a page shows, without the time that it took."""
    shown: list[Exhibit] = [Told(CAPTION), Picture("bars of both tables", figure(tables))]
    for table in tables:
        variant = table.variant.title
        for metric, title, printed in METRICS:
            head = ["HMI for", *table.columns]
            shown.append(Table(f"{title}, {variant}", head, rows_of(table, metric, printed)))
        rows = average_rows(table)
        shown.append(Table(f"Averages over the drivers, {variant}", AVERAGE_HEAD, rows))
        shown += [Told(f"{title}: {told}") for title, told in order_verdicts(table).items()]
        rows = optimum_rows(table)
        shown.append(Table(f"Own HMI beside the optimum, {variant}", OPTIMUM_HEAD, rows))
    return tuple(shown)
