"""What an evaluation of adaptive HMIs found: text, figure, page and verdicts."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hmi_marl.experiments.adaptation.evaluation import (
    CHANGE_STEP,
    CHANGE_TRIP,
    POPULATION,
    TEAM,
    WHEN,
    Result,
)
from hmi_marl.experiments.adaptation.hmis import (
    ADAPTIVE,
    AVERAGE,
    BAYES,
    CHOOSING,
    CONDITIONED,
    EXPECTED,
    KNOWING,
    LEARNED_AVERAGE,
    NONE,
)
from hmi_marl.files import write_bytes, write_json, write_text
from hmi_marl.reporting.blocks import Exhibit, Picture, Table, Told, held, page_of, pictures
from hmi_marl.reporting.page import text_table
from hmi_marl.reporting.statistics import Estimate

TITLE = "The right help for the driver at the wheel"
CAPTION = (
    "Attention is hidden, and the driver is not known. Every HMI meets the same drivers on the "
    "same roads. Shares are of the gap between two exact rules, AvgHMI's and that of whoever is at "
    "the wheel, and may exceed 100 % by chance; none is told where there is no clear gap. "
    "HMIs marked Bayes go by the exact evidence of the chain instead of the learned encoder. In "
    "verdicts shares and regrets are means; their intervals stand in the tables."
)
GAP_DRIVERS = "lisa", "bart"
"""For whom knowing the driver is worth much."""
TARGETS = {"1 trip": 0.90, "3 trips": 0.97}
"""Least share of their gap that is to be closed."""
POPULATION_TARGET = 0.80
"""The same for the continuous population after three trips."""
LEARNED_ADAPTIVE = CHOOSING, CONDITIONED, EXPECTED
MOST_REGRET = 0.10
"""Of what the knowing HMI earns, 20 s after a change of driver."""
COLOURS = {
    KNOWING: "#444a55",
    AVERAGE: "#9aa1ab",
    EXPECTED: "#32a050",
    EXPECTED + BAYES: "#5aa9e0",
    CHOOSING: "#e0a030",
    CONDITIONED: "#b0508c",
    NONE: "#c05040",
    LEARNED_AVERAGE: "#c8ccd2",
}


def verdicts(results: Sequence[Result]) -> dict[str, bool]:
    """What is asked of the HMI of expected value with the learned encoder, and whether it holds."""
    by_group = {result.group: result for result in results}
    found = {}
    for driver in GAP_DRIVERS:
        for when, least in TARGETS.items():
            share = by_group[driver].shares[EXPECTED][when].share.mean
            found[f"{driver}: {100 * least:.0f} % of the gap closed after {when}"] = share >= least
    share = by_group[POPULATION].shares[EXPECTED]["3 trips"].share.mean
    found[f"population: {100 * POPULATION_TARGET:.0f} % of the gap closed after 3 trips"] = (
        share >= POPULATION_TARGET
    )
    for result in results:
        if result.after_change:
            regret = result.after_change[EXPECTED].mean
            claim = f"{result.group}: within {100 * MOST_REGRET:.0f} % of knowing after 20 s"
            found[claim] = regret <= MOST_REGRET
        else:
            first = result.first_seconds[EXPECTED]
            claim = f"{result.group}: first 5 s not worse than AvgHMI by more than the interval"
            found[claim] = first.high >= 0
    return found


def as_text(results: Sequence[Result]) -> str:
    """For a terminal."""
    parts = []
    for title, head, rows in tables(results):
        parts += [title, text_table(head, rows), ""]
    told = [
        f"{'holds ' if holds else 'MISSED'}  {claim}" for claim, holds in verdicts(results).items()
    ]
    return "\n".join([*parts, *told])


def tables(
    results: Sequence[Result],
) -> list[tuple[str, list[str], list[list[str]]]]:
    """Title, head and rows of every table."""
    steady = [result for result in results if result.shares]
    changing = [result for result in results if result.after_change]
    worth = [
        [
            result.group,
            "" if result.exact_worth is None else f"{result.exact_worth:.1f}",
            _plain(result.shares[AVERAGE]["3 trips"].gap),
            _plain(result.returns[KNOWING][-1]),
            _plain(result.returns[AVERAGE][-1]),
            _plain(result.returns[LEARNED_AVERAGE][-1]),
            _plain(result.returns[NONE][-1]),
        ]
        for result in steady
    ]
    shares = [
        [result.group, hmi]
        + [_percent(result.shares[hmi][when].share) for when in WHEN]
        + [_plain(result.shares[hmi]["3 trips"].regret)]
        for result in steady
        for hmi in ADAPTIVE
    ]
    learned = [
        [result.group, hmi]
        + [_percent(result.learned_shares[hmi][when].share) for when in WHEN]
        + [_plain(result.learned_shares[hmi]["3 trips"].gap)]
        for result in steady
        for hmi in LEARNED_ADAPTIVE
        if result.learned_shares
    ]
    first = [
        [result.group, *(_plain(result.first_seconds[hmi]) for hmi in ADAPTIVE)]
        for result in steady
    ]
    change = [
        [result.group, *(_percent(result.after_change[hmi]) for hmi in (AVERAGE, *ADAPTIVE))]
        for result in changing
    ]
    return [
        (
            "What knowing the driver is worth: attention return per trip, attention hidden",
            ["driver", "exact worth", "played", KNOWING, AVERAGE, LEARNED_AVERAGE, NONE],
            worth,
        ),
        (
            "Share of the gap from AvgHMI to the knowing HMI that is closed [%]",
            ["driver", "HMI", *(f"after {when}" for when in WHEN), "regret per trip, last"],
            shares,
        ),
        (
            "The same between learned HMIs: learned AvgHMI and the one learned for the driver [%]",
            ["driver", "HMI", *(f"after {when}" for when in WHEN), "gap per trip"],
            learned,
        ),
        (
            "Earned more than by AvgHMI in the first 5 s",
            ["driver", *ADAPTIVE],
            first,
        ),
        (
            "Regret from 20 to 40 s after a change of driver, of what the knowing HMI earns [%]",
            ["change", AVERAGE, *ADAPTIVE],
            change,
        ),
    ]


def figure(results: Sequence[Result]) -> bytes:
    """Regret, and belief in the true type, by time at the wheel. A PNG."""
    shown = [r for r in results if r.group in (*GAP_DRIVERS, POPULATION)]
    shown += [r for r in results if r.after_change and r.group.endswith(GAP_DRIVERS)]
    drawing = Figure(figsize=(3.4 * len(shown), 5.6), layout="constrained")
    axes = drawing.subplots(2, len(shown), squeeze=False)
    for column, result in zip(axes.T, shown, strict=True):
        _draw_regret(column[0], result)
        _draw_belief(column[1], result)
    axes[0, 0].set_ylabel("regret per step")
    axes[1, 0].set_ylabel("probability of the true type")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    drawing.legend(handles, labels, loc="outside lower center", ncols=5)
    content = BytesIO()
    drawing.savefig(content, format="png", dpi=100)
    return content.getvalue()


def _draw_regret(axes: Axes, result: Result) -> None:
    for hmi in (AVERAGE, EXPECTED, EXPECTED + BAYES, CHOOSING, CONDITIONED):
        values = np.array(result.regret[hmi])
        smooth = np.convolve(values, np.full(3, 1 / 3), mode="valid")
        axes.plot(np.arange(len(smooth)) + 1.5, smooth, label=hmi, color=COLOURS[hmi], lw=1.4)
    axes.axhline(0.0, color=COLOURS[KNOWING], lw=0.8)
    axes.set_title(result.group, fontsize=10)
    _mark_change(axes, result)


def _draw_belief(axes: Axes, result: Result) -> None:
    if not result.belief:
        axes.axis("off")
        return
    for hmi in (EXPECTED, EXPECTED + BAYES):
        values = result.belief[hmi]
        axes.plot(np.arange(len(values)) + 0.5, values, color=COLOURS[hmi], lw=1.4)
    axes.set_ylim(0, 1.02)
    axes.set_xlabel("time at the wheel [s]")
    _mark_change(axes, result)


def _mark_change(axes: Axes, result: Result) -> None:
    if result.after_change:
        seconds = (CHANGE_TRIP * TEAM.horizon + CHANGE_STEP) / TEAM.scene.policy_frequency
        axes.axvline(seconds, color="#888", lw=0.8, ls=":")


def as_json(results: Sequence[Result]) -> dict[str, Any]:
    """Everything, and the verdicts."""
    return {
        "results": [result.as_json() for result in results],
        "verdicts": verdicts(results),
    }


def exhibits(results: Sequence[Result]) -> tuple[Exhibit, ...]:
    """What a report shows."""
    return (
        Told(CAPTION),
        *held(verdicts(results)),
        Picture("Regret and belief by time at the wheel", figure(results)),
        *(Table(title, head, rows) for title, head, rows in tables(results)),
    )


def write_report(
    folder: Path,
    results: Sequence[Result],
    seconds: Mapping[str, float],
    command_line: str,
    settings: Mapping[str, Any],
) -> tuple[str, tuple[Exhibit, ...]]:
    """Write ``adapt.txt``, ``.json``, ``.png`` and ``index.html``; returns text and exhibits."""
    text, shown = as_text(results), exhibits(results)
    about = {"seconds": dict(seconds), "command": command_line, "settings": dict(settings)}
    write_text(folder / "adapt.txt", text + "\n")
    write_json(folder / "adapt.json", as_json(results) | about)
    write_bytes(folder / "adapt.png", *pictures(shown))
    write_text(folder / "index.html", page_of(TITLE, shown, seconds, command_line, settings))
    return text, shown


def _plain(e: Estimate) -> str:
    return f"{e.mean:.1f} [{e.low:.1f}, {e.high:.1f}]"


def _percent(e: Estimate) -> str:
    if math.isnan(e.mean):
        return "no gap"
    return f"{100 * e.mean:.1f} [{100 * e.low:.1f}, {100 * e.high:.1f}]"
