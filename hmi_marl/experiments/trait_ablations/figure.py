"""Figure of the ablation: one panel for each axis, R² of the four traits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from hmi_marl.envs.drivers import TRAIT_NAMES
from hmi_marl.experiments.trait_ablations.rows import Row
from hmi_marl.experiments.trait_ablations.variants import AXES, NUMERIC, POOL
from hmi_marl.reporting.drawing import COLOURS, canvas, faint, ink, png
from hmi_marl.reporting.statistics import Estimate

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Drawing

_SYMBOLS = {"beta": "β", "alpha": "α", "eta": "η", "inflation": "inflation"}
_OF_TRAIT = dict(zip(TRAIT_NAMES, (COLOURS[2], COLOURS[1], COLOURS[3], COLOURS[4]), strict=True))
_MARKS = dict(zip(TRAIT_NAMES, "osD^", strict=True))
_APART = 0.13
"""Distance of the four traits at a place without a number."""


def ablation_figure(
    rows: Sequence[Row], exact: Mapping[str, Estimate] | None, columns: int = 4
) -> bytes:
    """Draw R² by the small network, with intervals.

    The default is marked by a broad line, the exact posterior by dotted ones.
    """
    return png(draw(rows, exact, columns))


def draw(rows: Sequence[Row], exact: Mapping[str, Estimate] | None, columns: int) -> Drawing:
    """Draw a panel for every axis that has rows."""
    by_axis = {name: [row for row in rows if row.axis == name] for name in AXES}
    shown = {name: own for name, own in by_axis.items() if own}
    lines = -(-len(shown) // columns)
    figure = canvas(3.3 * columns, 3.1 * lines + 0.4)
    panels = list(figure.subplots(lines, columns, sharey=True, squeeze=False).flat)
    for axes in panels[len(shown) :]:
        axes.remove()
    for number, (axes, (name, own)) in enumerate(zip(panels, shown.items(), strict=False)):
        _panel(axes, name, own)
        if exact is not None and name != POOL:  # where all read as many windows
            for trait in TRAIT_NAMES:
                axes.axhline(exact[trait].mean, color=_OF_TRAIT[trait], linewidth=1.0, ls=":")
        axes.set_ylabel("R²" if number % columns == 0 else "")
    figure.legend(
        *panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=len(TRAIT_NAMES)
    )
    return figure


def _panel(axes: Axes, name: str, rows: Sequence[Row]) -> None:
    numeric = name in NUMERIC
    places = [row.number for row in rows] if numeric else [float(k) for k in range(len(rows))]
    for place, row in zip(places, rows, strict=True):
        if row.default:
            axes.axvline(place, color=faint(), linewidth=6.0, zorder=0)
    for k, trait in enumerate(TRAIT_NAMES):
        found = [row.network[trait] for row in rows]
        at = places if numeric else [place + (k - 1.5) * _APART for place in places]
        axes.errorbar(
            at,
            [each.mean for each in found],
            [
                [max(each.mean - each.low, 0.0) for each in found],
                [max(each.high - each.mean, 0.0) for each in found],
            ],
            label=_SYMBOLS[trait],
            color=_OF_TRAIT[trait],
            fmt=f"{_MARKS[trait]}-" if numeric else _MARKS[trait],
            markersize=4,
            linewidth=1.2,
        )
    axes.set_title(AXES[name], fontsize=10)
    axes.axhline(0.0, color=ink(), linewidth=0.6)
    axes.set_ylim(-0.08, 1.03)
    axes.tick_params(labelsize=8)
    axes.spines[["top", "right"]].set_visible(False)
    if numeric:
        axes.set_xscale("log")
        axes.minorticks_off()
    labels = [f"{int(row.number):,}" if numeric else row.what for row in rows]
    axes.set_xticks(places, labels)
    if not numeric:
        for label in axes.get_xticklabels():
            label.set(rotation=35.0, ha="right", rotation_mode="anchor")
