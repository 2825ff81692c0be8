r"""The paper's metrics table with learned drivers and HMIs, and how it compares to the paper's.

Six HMIs (trained for Lisa, Marge, Bart, Homer, for the average driver, and none) with each of the
four drivers, the cells that the paper leaves as ``*`` included. Twice: with the printed η, and
with η = 1 for all four, since the printed η = 0.01 puts the paper's own-HMI cells of Lisa and
Bart out of reach of every alert policy, while η = 1 gives about what it prints. AvgHMI is the same
in both, trained for the average driver with η = 0.505.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hmi_marl.envs.drivers import DRIVERS, PAPER_DRIVERS, Driver
from hmi_marl.experiments import criteria
from hmi_marl.experiments.metrics_table.differences import AVERAGE, NONE, OWN, Differences
from hmi_marl.experiments.metrics_table.table import Cell
from hmi_marl.experiments.training_seeds import learned_part
from hmi_marl.files import json_value
from hmi_marl.paper.audit import reachable_in_the_paper
from hmi_marl.paper.printed import DISTRACTION_RETURNS, SPEED_RETURNS, mean_over_drivers
from hmi_marl.reporting.drawing import COLOURS, canvas, ink, png
from hmi_marl.reporting.statistics import Estimate
from hmi_marl.reporting.verdicts import Part

METRICS = (
    ("distraction_return", "Distraction return", DISTRACTION_RETURNS),
    ("speed_return", "Speed return", SPEED_RETURNS),
)


@dataclass(frozen=True)
class Variant:
    """One of the two tables."""

    name: str
    title: str
    drivers: tuple[Driver, ...]
    """Columns, named as in the paper."""

    def hmi_run(self, driver: Driver) -> str:
        """Name the folder of the HMI trained for one of its drivers. Equal drivers share it."""
        return f"hmi-{driver.name}" + ("" if driver == DRIVERS[driver.name] else f"-{self.name}")


PRINTED = Variant("printed", "η as printed", tuple(DRIVERS[name] for name in PAPER_DRIVERS))
ETA_1 = Variant("eta-1", "η = 1", tuple(replace(driver, eta=1.0) for driver in PRINTED.drivers))
VARIANTS = (PRINTED, ETA_1)


@dataclass(frozen=True)
class PaperTable:
    """Cells of one variant, by label of the HMI and name of the driver."""

    variant: Variant
    cells: dict[tuple[str, str], Cell]
    average: Cell | None = None
    """AvgHMI with the average driver, for whom it was trained; not in the paper's table."""
    differences: Differences | None = None
    """Differences between HMIs, paired by episode; None for a table without episodes."""

    @property
    def rows(self) -> tuple[str, ...]:
        """Labels of the HMIs."""
        return tuple(dict.fromkeys(hmi for hmi, _ in self.cells))

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the drivers."""
        return tuple(driver.name for driver in self.variant.drivers)

    def own(self, driver: str) -> Cell:
        """Cell of a driver with the HMI that was trained for them."""
        return self.cells[driver, driver]

    def with_own_hmi(self) -> dict[str, Cell]:
        """Cells of all drivers with their own HMI, the average driver included."""
        own = {driver: self.own(driver) for driver in self.columns}
        return own if self.average is None else own | {"average": self.average}

    def paper_row(self, hmi: str, driver: str) -> str | None:
        """Row of :mod:`hmi_marl.paper.printed` that a cell is in; None if it is not printed."""
        if hmi in (AVERAGE, NONE):
            return hmi
        return "own" if hmi == driver else None


def exact_part(hmi: str, driver: str, cell: Cell, seeds: int = 1) -> Part:
    """State that a cell's distraction return is the exact one over as many steps, within 2 %."""
    most = criteria.EXACT_TOLERANCE * abs(cell.exact_distraction_return_same_steps or 0.0)
    # Without an HMI the driver policy alone was learned, which does not touch the chain.
    return learned_part(
        f"{driver} with the HMI for {hmi}, less exact",
        cell.distraction_minus_exact,
        seeds if seeds > 1 else int(cell.learned),
        paired=True,
        above=-most,
        below=most,
    )


def optimum_part(driver: str, cell: Cell, seeds: int = 1) -> Part:
    """State that an own HMI misses less than 2 % of the exact optimum of attention."""
    most = criteria.EXACT_TOLERANCE * abs(cell.optimal_attention_return_same_steps)
    return learned_part(
        f"{driver}, less the optimum",
        cell.attention_minus_optimum,
        seeds,
        paired=True,
        above=-most,
    )


def shortfall(cell: Cell) -> float:
    """Difference of the attention return to the exact optimum's, as a share of its size."""
    best = cell.optimal_attention_return_same_steps
    return (best - cell.attention_return.mean) / abs(best)


def paper_compared(cell: Cell, driver: Driver, metric: str, printed: float) -> str:
    """Compare a figure that the paper prints with ours."""
    got: Estimate = getattr(cell, metric)
    if metric == "distraction_return":
        least, most = reachable_in_the_paper(driver)
        if not least <= printed <= most:
            return "out of reach of every alert policy"
    if got.agrees(printed, criteria.PAPER_TOLERANCE[metric]):
        return "agrees"
    return f"differs by {got.mean - printed:+.0f}"


@dataclass(frozen=True)
class Average:
    """Mean of one metric over the four drivers, as the paper's text compares them."""

    hmi: str
    """personalised, average or none."""
    metric: str
    ours: Estimate
    """Mean of the drivers in the same episodes."""
    exact: float | None
    """Exact value over the same steps; None where it is not known."""
    paper: float

    @property
    def compared(self) -> str:
        """Comparison of the paper's figure with ours."""
        if self.ours.agrees(self.paper, criteria.PAPER_TOLERANCE[self.metric]):
            return "paper agrees"
        return f"paper differs by {self.paper - self.ours.mean:+.0f}"


def averages(table: PaperTable) -> list[Average]:
    """Averages of both metrics for personalised, average and no HMIs; none without episodes."""
    if table.differences is None:
        return []
    found = []
    for label, row in (("personalised", OWN), ("average", AVERAGE), ("none", NONE)):
        cells = [
            table.own(driver) if row == OWN else table.cells[row, driver]
            for driver in table.columns
        ]
        for metric, _, printed in METRICS:
            ours = table.differences.rows[row][metric]
            exact = [cell.exact_distraction_return_same_steps for cell in cells]
            known = metric == "distraction_return" and None not in exact
            mean_exact = float(np.mean([e for e in exact if e is not None])) if known else None
            paper = mean_over_drivers(printed[row])
            found.append(Average(label, metric, ours, mean_exact, paper))
    return found


def numbers(tables: Sequence[PaperTable]) -> dict[str, Any]:
    """JSON content of both tables."""
    by_name = {table.variant.name: table for table in tables}
    return {
        "tables": {name: _cells(table) for name, table in by_name.items()},
        "averages": {
            name: [
                json_value(average) | {"compared": average.compared} for average in averages(table)
            ]
            for name, table in by_name.items()
        },
        "differences": {name: json_value(table.differences) for name, table in by_name.items()},
        "average_driver_with_own_hmi": {
            name: table.average.as_json() | {"hmi": AVERAGE}  # instead of its path
            for name, table in by_name.items()
            if table.average
        },
        "attention_shortfall_of_own_hmis": {
            name: {driver: shortfall(cell) for driver, cell in table.with_own_hmi().items()}
            for name, table in by_name.items()
        },
    }


def _cells(table: PaperTable) -> list[dict[str, Any]]:
    drivers, found = {driver.name: driver for driver in table.variant.drivers}, []
    for (hmi, driver), cell in table.cells.items():
        row = table.paper_row(hmi, driver)
        paper = {metric: printed[row][driver] if row else None for metric, _, printed in METRICS}
        compared = {
            metric: None if value is None else paper_compared(cell, drivers[driver], metric, value)
            for metric, value in paper.items()
        }
        about = {"hmi": hmi, "driver": driver, "attention_shortfall": shortfall(cell)}
        found.append(cell.as_json() | about | {"paper": paper, "paper_compared": compared})
    return found


def paper_figure(tables: Sequence[PaperTable]) -> bytes:
    """Draw our returns, the exact values and the paper's, by driver and HMI. A PNG."""
    drawing = canvas(11, 3.4 * len(tables))
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
                    label = "exact" if k == 0 else None
                    axes.plot(at, exact, "_", color=ink(), markersize=8, label=label)
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
