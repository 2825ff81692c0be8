"""Figures of the map: slices through the drivers as heat maps, and curves."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from hmi_marl.envs.drivers import DRIVERS, PAPER_DRIVERS
from hmi_marl.experiments.criteria import LEAST_WORTH, SAME_RULE
from hmi_marl.experiments.driver_map.cases import (
    AVERAGE,
    PAPER,
    WEIGHTS,
    WHEN_DISTRACTED,
    CaseResult,
)
from hmi_marl.experiments.experiment import MODELS
from hmi_marl.reporting.drawing import COLOURS, canvas, ink, png

_ROWS = 5
"""Rows of heat maps in a figure, at most."""
_BELOW = "#e9ecf0"
"""Colour where knowing the driver is worth less than ``LEAST_WORTH``."""
_NAMED_COLOURS = dict(zip(PAPER_DRIVERS, ("#5aa9e0", "#32a050", "#c05040", "#e0a030"), strict=True))
_COLOURS = dict(zip(WEIGHTS, COLOURS[2:6], strict=True))


class MapFigures:
    """Figures of some results; each method draws one as a PNG.

    Args:
        results: of all cases.
        window, revealing: where something else varies.
    """

    def __init__(self, results: Sequence[CaseResult], window: int, revealing: float) -> None:
        self._results, self._window, self._revealing = results, window, revealing

    def _seen(self, weights: str) -> list[CaseResult]:
        found = [r for r in self._results if r.case.revealing is None]
        return [r for r in found if r.case.weights == weights]

    def _hidden(self) -> list[CaseResult]:
        return [r for r in self._results if r.case.revealing is not None]

    def seen(self) -> bytes:
        """Draw the loss of an alert exactly when distracted: rows of weights, columns of η."""
        rows = {}
        for name in WEIGHTS:
            found = self._seen(name)
            nearest = min(found, key=lambda r: abs(r.case.window - self._window))
            rows[f"{name}\nN = {nearest.case.window}"] = nearest
        return _heat_maps(rows, WHEN_DISTRACTED, "loss of an alert exactly when distracted", True)

    def hidden(self) -> bytes:
        """Draw what knowing the driver is worth: rows of shares of revealing steps."""
        found = self._by_share()
        which = np.unique(np.linspace(0, len(found) - 1, _ROWS).round().astype(int))
        rows = {f"{100 * (found[k].case.revealing or 0.0):g} % revealing": found[k] for k in which}
        return _heat_maps(rows, AVERAGE, "worth of knowing the driver")

    def _by_share(self) -> list[CaseResult]:
        found = [
            r for r in self._hidden() if (r.case.window, r.case.weights) == (self._window, PAPER)
        ]
        return sorted(found, key=lambda r: r.case.revealing or 0.0)

    def curves(self) -> bytes:
        """Draw shares and means over drivers, by window, share of revealing steps and weights."""
        figure = canvas(11, 3.9)
        seen, shares, others = figure.subplots(1, 3)
        for name in WEIGHTS:
            found = self._seen(name)
            across = [r.case.window for r in found]
            share = [100 * r.losses[WHEN_DISTRACTED].other_rule.value for r in found]
            seen.plot(across, share, "o-", ms=4, color=_COLOURS[name], label=name)
        seen.set_title("attention seen", fontsize=10)
        seen.set_xlabel("window N [steps]")
        seen.set_ylabel("drivers with another best rule [%]")
        seen.set_xticks(sorted({r.case.window for r in self._results if r.case.revealing is None}))
        seen.set_ylim(0, 100)
        seen.legend(fontsize=8, frameon=False)
        found = self._by_share()
        percent = [100 * (r.case.revealing or 0.0) for r in found]
        for name in PAPER_DRIVERS:
            worth = [r.losses[AVERAGE].named[name] for r in found]
            shares.plot(percent, worth, "o-", ms=4, color=_NAMED_COLOURS[name], label=name)
        mean = [r.losses[AVERAGE].mean.value for r in found]
        shares.plot(percent, mean, "--", color=ink(), lw=1.5, label="mean over all drivers")
        shares.set_title(f"attention hidden, N = {self._window}", fontsize=10)
        shares.set_xlabel("revealing steps [%]")
        shares.set_ylabel("worth of knowing the driver")
        shares.set_yscale("symlog", linthresh=1.0)
        shares.set_ylim(0.0, 20.0 * max(*mean, 100.0))
        shares.legend(fontsize=8, frameon=False, ncols=2, loc="upper center")
        self._draw_others(others)
        for axes in (seen, shares, others):
            axes.spines[["top", "right"]].set_visible(False)
        return png(figure, 130)

    def _draw_others(self, axes: Any) -> None:
        """Draw the mean worth by window and by weights, at one share of revealing steps."""
        found = [r for r in self._hidden() if r.case.revealing == self._revealing]
        paper = [r for r in found if r.case.weights == PAPER]
        rows = {f"N = {r.case.window}": r for r in sorted(paper, key=lambda r: r.case.window)}
        rows |= {r.case.weights: r for r in found if r.case.weights != PAPER}
        means = [r.losses[AVERAGE].mean for r in rows.values()]
        places = np.arange(len(rows))[::-1]
        colours = [_COLOURS[r.case.weights] for r in rows.values()]
        values, errors = [m.value for m in means], [m.error for m in means]
        axes.barh(places, values, xerr=errors, color=colours, height=0.65, ecolor=ink())
        axes.set_yticks(places, list(rows))
        axes.set_xlabel("mean worth over all drivers")
        axes.set_title(f"attention hidden, {100 * self._revealing:g} % revealing", fontsize=10)


def _heat_maps(rows: dict[str, CaseResult], rule: str, label: str, outlined: bool = False) -> bytes:
    """Draw slices of a rule's loss, with one scale of colours: a row for each result.

    ``outlined`` draws a line around where the rule is not optimal.
    """
    from matplotlib import colormaps
    from matplotlib.colors import LogNorm

    etas = next(iter(rows.values())).grid.etas
    cubes = [np.array(result.losses[rule].slices) for result in rows.values()]
    most = max(2.0 * LEAST_WORTH, max(float(cube.max()) for cube in cubes))
    colours = colormaps["viridis"].with_extremes(under=_BELOW)
    norm = LogNorm(LEAST_WORTH, most)
    figure = canvas(1.75 * len(etas) + 1.3, 1.7 * len(rows) + 0.75)
    panels = figure.subplots(len(rows), len(etas), sharex=True, sharey=True, squeeze=False)
    even = np.linspace(0.0, 1.0, cubes[0].shape[1])
    drawn: Any = None
    for line, (name, cube) in zip(panels, zip(rows, cubes, strict=True), strict=True):
        for axes, eta, layer in zip(line, etas, cube, strict=True):
            values = layer.T  # [α, β]
            drawn = axes.pcolormesh(
                even, even, np.maximum(values, LEAST_WORTH / 10), norm=norm, cmap=colours,
                shading="nearest", rasterized=True,
            )  # fmt: skip
            if outlined and values.min() <= SAME_RULE < values.max():
                axes.contour(
                    even, even, values > SAME_RULE, [0.5], colors="#3b3b3b", linewidths=0.6
                )
            _mark_named(axes, eta)
            axes.set(xlim=(0, 1), ylim=(0, 1), xticks=(0, 0.5, 1), yticks=(0, 0.5, 1))
            axes.set_xticklabels(("0", "½", "1"))
            axes.set_yticklabels(("0", "½", "1"))
            axes.set_aspect("equal")
        line[0].set_ylabel(f"{name}\nα", fontsize=9)
    for axes, eta in zip(panels[0], etas, strict=True):
        axes.set_title(f"η = {eta:g}", fontsize=10)
    for axes in panels[-1]:
        axes.set_xlabel("β")
    bar = figure.colorbar(drawn, ax=panels, extend="min", aspect=40, pad=0.01)
    bar.set_label(f"{label} [return per trip]")
    return png(figure, 130)


def _mark_named(axes: Any, eta: float) -> None:
    """Mark the known drivers in the slice that they lie in."""
    for name in MODELS:
        driver = DRIVERS[name]
        if driver.eta == eta:
            how = {"ms": 6, "mfc": "white", "mec": "black", "mew": 1.0}
            axes.plot(driver.beta, driver.alpha, "D" if name == "average" else "o", **how)
            axes.annotate(
                name, (driver.beta, driver.alpha), (0, 6), textcoords="offset points",
                ha="center", fontsize=8, color="black",
                bbox={"boxstyle": "round,pad=0.12", "fc": "white", "ec": "none", "alpha": 0.75},
            )  # fmt: skip
