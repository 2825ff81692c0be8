"""Figure of a sweep: measures over a swept number, or by combination, with intervals over seeds."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from hmi_marl.experiments.sweep.options import written
from hmi_marl.experiments.sweep.plan import Combination, varying
from hmi_marl.reporting.drawing import COLOURS, canvas, png
from hmi_marl.reporting.statistics import Estimate
from hmi_marl.text import in_figure

PANELS = {
    "team_return": "team return",
    "attention_return": "attention return",
    "speed_reward": "speed return",
    "crash_rate": "crash rate",
}
Point = tuple[Combination, Callable[[str], Estimate]]
"""A combination, and the estimate of each measure over its seeds."""


def sweep_figure(points: Sequence[Point]) -> bytes:
    """Draw four measures. The horizontal axis is the number that takes the most values.

    What differs otherwise has a line of its own. Without such a number every combination has a
    place of its own.
    """
    combinations = [combination for combination, _ in points]
    along = axis_of(combinations)
    others = [name for name in varying(combinations) if name != along]
    lines: dict[str, list[Point]] = {}
    for combination, estimate in points:
        lines.setdefault(_line(combination, others), []).append((combination, estimate))
    figure = canvas(11, 7.5)
    panels = dict(zip(PANELS, figure.subplots(2, 2).flat, strict=True))
    for name, axes in panels.items():
        for number, (label, those) in enumerate(lines.items()):
            places = _places(those, along) if along else [number]
            _draw(axes, places, [estimate(name) for _, estimate in those], label, number)
        axes.set_title(PANELS[name])
        axes.spines[["top", "right"]].set_visible(False)
        if along is None:
            axes.set_xticks([])
            continue
        axes.set_xlabel(in_figure(along))
        values = _places(points, along)
        if min(values) > 0 and max(values) / min(values) >= 8:
            axes.set_xscale("log")
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
    return png(figure)


def axis_of(combinations: Sequence[Combination]) -> str | None:
    """Return the option with the most values, if they are numbers; None if there is none."""
    names = dict.fromkeys(name for each in combinations for name in each.options)
    values = {
        name: {each.options[name] for each in combinations if name in each.options}
        for name in names
        if all(name in each.options for each in combinations)
    }
    numeric = {
        name: len(found)
        for name, found in values.items()
        if len(found) > 1
        and all(isinstance(v, (int, float)) and not isinstance(v, bool) for v in found)
    }
    return max(numeric, key=lambda name: numeric[name]) if numeric else None


def _line(combination: Combination, names: Sequence[str]) -> str:
    given = combination.options
    values = ", ".join(f"{name}={written(given[name])}" for name in names if name in given)
    return f"{combination.protocol}, {values}" if values else combination.protocol


def _places(points: Sequence[Point], along: str) -> list[float]:
    return [float(combination.options[along]) for combination, _ in points]


def _draw(
    axes: Any, places: Sequence[float], estimates: Sequence[Estimate], label: str, number: int
) -> None:
    colour = COLOURS[number % len(COLOURS)]
    means = [estimate.mean for estimate in estimates]
    axes.plot(places, means, "o-", color=colour, markersize=4, label=in_figure(label, 70))
    for place, estimate in zip(places, estimates, strict=True):  # one seed has no interval
        axes.plot([place, place], [estimate.low, estimate.high], color=colour, linewidth=1.2)
