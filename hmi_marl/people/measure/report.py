"""Text, tables and figure of one person's traits."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Drawing
from numpy.typing import NDArray

from hmi_marl.envs.drivers import DRIVERS, PAPER_DRIVERS, TRAIT_NAMES
from hmi_marl.files import json_value
from hmi_marl.people.measure.assumptions import AssumptionTest, dwell_rows, effect_rows
from hmi_marl.people.measure.person import MeasuredPerson
from hmi_marl.reporting.blocks import Block, Figure, Table, Text
from hmi_marl.reporting.drawing import COLOURS, canvas, png
from hmi_marl.reporting.statistics import number

_SYMBOLS = {"beta": "β", "alpha": "α", "eta": "η", "inflation": "inflation"}
_MEANING = {
    "beta": "looks away, per step at the road",
    "alpha": "looks back, per step away",
    "eta": "what an alert adds to either",
    "inflation": "times too large others seem",
}
_FORMS = {"beta": ".3f", "alpha": ".3f", "eta": ".3f", "inflation": ".2f"}
_TESTS = {
    "dwell_attentive": "time at the road is memoryless (geometric)",
    "dwell_away": "time away is memoryless (geometric)",
    "constant_effect": "an alert helps alike in every step of its window",
    "one_effect": "one η moves looking away and looking back",
}
_SHOWN = (*PAPER_DRIVERS, "average")
"""Drivers that a person is shown with."""
_STATES = ("attentive", "away")
"""Names of d = 0 and d = 1."""
_HMIS = {"own": "own (optimal for these traits)", "average": "average", "none": "none"}


def blocks(person: MeasuredPerson) -> list[Block]:
    """Blocks of the report."""
    counts = person.attention.counts
    away = float(person.attention.steps.before.mean())
    openings = counts.openings + counts.helped_openings
    about = (
        f"{person.name}: {person.trips} trips of {person.minutes:.1f} minutes in all, "
        f"{openings:.0f} times looked away, {100 * away:.0f} % of the time; alerts are in effect "
        f"for {person.window} steps."
    )
    return [
        Text(about),
        _traits(person),
        _needed(person),
        _tests(person),
        _worth(person),
        Figure(
            "traits",
            f"traits of {person.name} beside the four drivers, and tests of the model",
            lambda: png(_draw(person)),
            sources=["/estimates", "/drivers", "/inflation", "/dwell", "/effect"],
        ),
    ]


def numbers(person: MeasuredPerson) -> dict[str, Any]:
    """JSON content of the report: the person's, the drivers they are shown with, and counts.

    ``dwell`` has the steps outside windows and the changes by the time in each state, ``effect``
    those within windows by the step since the alert.
    """
    steps = person.attention.steps
    return {
        **person.as_json(),
        "drivers": {name: json_value(DRIVERS[name]) for name in _SHOWN},
        "dwell": {name: _counts(dwell_rows(steps, state)) for state, name in enumerate(_STATES)},
        "effect": {name: _counts(effect_rows(steps, state)) for state, name in enumerate(_STATES)},
    }


def _counts(rows: tuple[NDArray[np.float64], ...]) -> dict[str, list[int]]:
    names = ("step", "steps", "changes")
    return {name: column.astype(int).tolist() for name, column in zip(names, rows, strict=True)}


def _traits(person: MeasuredPerson) -> Table:
    rows = []
    for trait in TRAIT_NAMES:
        found = person.estimates.get(trait)
        shown = "not measured" if found is None else found.shown(_FORMS[trait])
        named = [f"{getattr(DRIVERS[name], trait):g}" for name in _SHOWN]
        rows.append([f"{_SYMBOLS[trait]}: {_MEANING[trait]}", shown, *named])
    note = (
        "95 % intervals. The estimate of η is the least that fits best: if η exceeds both β and "
        "1 - α, a larger one is the same to the model."
    )
    if person.inflation is not None:
        note += (
            f" Inflation: of the driver policy that fits best, which explains "
            f"{100 * person.inflation.explained:.0f} % of {person.inflation.steps} actions."
        )
    head, sources = ["trait", person.name, *_SHOWN], ["/estimates", "/drivers"]
    return Table("Traits, beside the drivers of the paper", head, rows, note, sources)


def _needed(person: MeasuredPerson) -> Table:
    rows = [
        [f"{width:g}", *(number(found[trait]) for trait in TRAIT_NAMES[:3])]
        for width, found in person.needed.items()
    ]
    return Table(
        "Minutes needed until an interval is this wide",
        ["width", *(_SYMBOLS[trait] for trait in TRAIT_NAMES[:3])],
        rows,
        "For a person who goes on as recorded; - : never, or not in 200 times as many minutes.",
        ["/minutes_needed"],
    )


def _tests(person: MeasuredPerson) -> Table:
    rows = [[_TESTS[test.name], number(test.p, ".3f"), _finding(test)] for test in person.tests]
    return Table(
        "What the model assumes",
        ["assumption", "p", "finding"],
        rows,
        "p-values, corrected for their number (Holm); below 0.05 the person is not as assumed.",
        ["/tests"],
    )


def _finding(test: AssumptionTest) -> str:
    if test.p is None:
        return "too little was seen"
    if not test.rejected:
        return "not contradicted"
    if test.trend is None:
        return "NOT so: the two effects differ"
    rises = test.trend > 0
    if test.name == "constant_effect":
        return f"NOT so: the effect {'grows' if rises else 'fades'} within the window"
    return f"NOT so: a change becomes {'likelier' if rises else 'less likely'} with time"


def _worth(person: MeasuredPerson) -> Table:
    rows = [
        [
            _HMIS[name],
            number(hmi.attention_return),
            number(hmi.distraction_return),
            number(hmi.alerts),
        ]
        for name, hmi in person.hmis.items()
    ]
    return Table(
        "Exact expected returns of HMIs for these traits, per episode",
        ["HMI", "attention return", "distraction return", "alerts"],
        rows,
        "If the person is as measured.",
        ["/hmis"],
    )


def _draw(person: MeasuredPerson) -> Drawing:
    drawing = canvas(9.0, 6.5)
    axes = drawing.subplots(2, 2)
    _draw_traits(axes[0, 0], person)
    _draw_inflation(axes[0, 1], person)
    _draw_dwell(axes[1, 0], person)
    _draw_effect(axes[1, 1], person)
    return drawing


def _draw_traits(axes: Axes, person: MeasuredPerson) -> None:
    """β, α and η with intervals, and the drivers of the paper as letters."""
    for place, trait in enumerate(TRAIT_NAMES[:3]):
        found = person.estimates[trait]
        axes.plot([found.low, found.high], [place, place], color=COLOURS[2], linewidth=3)
        axes.plot(found.mean, place, "o", color=COLOURS[2])
        at: dict[float, str] = {}
        for name in PAPER_DRIVERS:
            value = getattr(DRIVERS[name], trait)
            at[value] = at.get(value, "") + name[0].upper()
        for value, letters in at.items():
            axes.text(value, place + 0.2, letters, ha="center", fontsize=8)
    axes.set_yticks(range(3), [_SYMBOLS[trait] for trait in TRAIT_NAMES[:3]])
    axes.set_xlim(-0.03, 1.03)
    axes.set_ylim(-0.5, 2.7)
    axes.set_title(f"{person.name}; L, M, B, H: the paper's drivers", fontsize=10)


def _draw_inflation(axes: Axes, person: MeasuredPerson) -> None:
    found = person.inflation
    axes.set_title("caution", fontsize=10)
    axes.set_xlabel("inflation")
    axes.set_ylabel("log likelihood, less the highest")
    if found is None:
        axes.text(0.5, 0.5, "not measured", ha="center", transform=axes.transAxes)
        return
    axes.plot(found.grid, found.log_likelihood, color=COLOURS[2])
    axes.axvspan(found.inflation.low, found.inflation.high, color=COLOURS[2], alpha=0.2)
    for name in PAPER_DRIVERS:
        axes.axvline(DRIVERS[name].inflation, color=COLOURS[0], linestyle=":", linewidth=1)


def _draw_dwell(axes: Axes, person: MeasuredPerson) -> None:
    """Share of steps that end a time at the road, or away, by how long it has lasted."""
    for state, label, trait in ((0, "looks away", "beta"), (1, "looks back", "alpha")):
        time, steps, changes = dwell_rows(person.attention.steps, state)
        colour = COLOURS[1 + state]
        middle, share, error = _binned(time, steps, changes)
        axes.errorbar(middle, share, error, fmt="o", color=colour, label=label, markersize=4)
        axes.axhline(person.estimates[trait].mean, color=colour, linewidth=1)
    axes.set_xscale("log")
    axes.set_ylim(-0.02, 1.02)
    axes.set_xlabel("steps since the last change")
    axes.set_ylabel("share of steps, outside windows")
    axes.set_title("memoryless: level", fontsize=10)
    axes.legend(fontsize=8)


def _draw_effect(axes: Axes, person: MeasuredPerson) -> None:
    """The same within windows, by the step since the alert."""
    beta, alpha, eta = (person.estimates[trait].mean for trait in TRAIT_NAMES[:3])
    levels = max(0.0, beta - eta), min(1.0, alpha + eta)
    for state, label in ((0, "looks away"), (1, "looks back")):
        step, steps, changes = effect_rows(person.attention.steps, state)
        share, error = _share(steps, changes)
        colour = COLOURS[1 + state]
        axes.errorbar(step, share, error, fmt="o", color=colour, label=label, markersize=4)
        axes.axhline(levels[state], color=colour, linewidth=1)
    axes.set_ylim(-0.02, 1.02)
    axes.set_xlabel("steps since the alert")
    axes.set_ylabel("share of steps, within windows")
    axes.set_title("constant effect: level", fontsize=10)
    axes.legend(fontsize=8)


def _binned(
    time: NDArray[np.float64], steps: NDArray[np.float64], changes: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Middle, share and standard error in bins of about equally many steps, ten at most."""
    if not len(time):
        nothing = np.zeros(0)
        return nothing, nothing, nothing
    before = np.cumsum(steps) - steps
    bins = np.minimum(9, (10 * before / steps.sum()).astype(np.int64))
    _, bins = np.unique(bins, return_inverse=True)
    bins = bins.reshape(-1)
    each = steps, changes, steps * time
    sums = np.array([np.bincount(bins, weights) for weights in each], np.float64)
    share, error = _share(sums[0], sums[1])
    return sums[2] / sums[0], share, error


def _share(
    steps: NDArray[np.float64], changes: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Shares, and how far Wilson's interval of one standard error reaches below and above."""
    share = changes / steps
    middle = (changes + 0.5) / (steps + 1)
    half = np.sqrt(share * (1 - share) / steps + 0.25 / steps**2) / (1 + 1 / steps)
    ends = np.stack([share - (middle - half), middle + half - share])
    return share, np.maximum(ends, 0.0)
