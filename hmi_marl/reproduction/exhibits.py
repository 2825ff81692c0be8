"""The three main results of a reproduction, each with one number, a sentence and a small figure."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from hmi_marl.envs.drivers import PAPER_DRIVERS
from hmi_marl.experiments.latent_traits.figures import TITLES
from hmi_marl.experiments.metrics_table.differences import ALL, AVERAGE, NONE, OWN
from hmi_marl.files import json_value
from hmi_marl.paper.printed import DISTRACTION_RETURNS, mean_over_drivers
from hmi_marl.reporting.blocks import Figure
from hmi_marl.reporting.cards import Card
from hmi_marl.reporting.drawing import COLOURS, canvas, faint, ink, png
from hmi_marl.reporting.sources import Citation, pointer
from hmi_marl.reporting.statistics import Estimate, number

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Results = Mapping[str, Mapping[str, Any]]
"""Numbers of each experiment, by its name."""
_SIZE, _DPI = (3.5, 1.8), 180
_METRIC = "distraction_return"
_BY_DRIVER = "id"
"""Setting of latent traits that is shown."""


@dataclass(frozen=True)
class Exhibit:
    """One main result."""

    stage: str
    """Experiment that has it."""
    title: str
    value: Estimate
    shown: str
    """The value as it is written."""
    sentence: str
    numbers: Mapping[str, Any]
    """Further numbers of the sentence."""
    sources: tuple[str, ...]
    """JSON pointers to its numbers in the report's JSON file."""
    description: str
    """Text for readers who do not see the figure."""
    draw: Callable[[], bytes]

    def as_json(self) -> dict[str, Any]:
        """JSON content."""
        about = {"stage": self.stage, "title": self.title, "value": self.value.as_json()}
        return about | json_value(self.numbers) | {"sources": list(self.sources)}


def exhibits(results: Results) -> list[Exhibit]:
    """Make those whose experiments were run."""
    makers = {"table": personalisation, "hidden": hidden_attention, "traits": latent_traits}
    return [make(results[name]) for name, make in makers.items() if name in results]


def card(exhibit: Exhibit, place: int, cited: Citation) -> Card:
    """Show one of them on a card; ``place`` is that in the report's list of exhibits."""
    return Card(
        exhibit.title,
        exhibit.shown,
        exhibit.sentence,
        Figure(f"exhibit-{exhibit.stage}", exhibit.description, exhibit.draw),
        f"{exhibit.stage}.html",
        cited,
        (pointer("exhibits", place), *exhibit.sources),
    )


def personalisation(table: Mapping[str, Any]) -> Exhibit:
    """Show what HMIs made for the driver gain over AvgHMI, from the numbers of the table."""
    rows = f"{OWN} - {AVERAGE}"
    place = ("differences", "printed", "between_rows", rows, _METRIC, ALL)
    value = Estimate.from_json(table["differences"]["printed"]["between_rows"][rows][_METRIC][ALL])
    cells = {(cell["hmi"], cell["driver"]): cell for cell in table["tables"]["printed"]}
    exact = [_of(cells, OWN, d)[_EXACT] - _of(cells, AVERAGE, d)[_EXACT] for d in PAPER_DRIVERS]
    own, average = (mean_over_drivers(DISTRACTION_RETURNS[row]) for row in ("own", AVERAGE))
    gain, paper = float(np.mean(exact)), own - average
    never_differs = value.error == 0.0
    return Exhibit(
        "table",
        "HMIs and drivers: what personalisation is worth",
        value,
        f"{value.mean:+z.1f}" if never_differs else value.shown("+z.1f"),
        "Distraction return per trip that HMIs made for the driver gain over AvgHMI, attention "
        f"seen, mean of four drivers{', in every trip' if never_differs else ''}; by the exact "
        f"values of the best rules {gain:+z.1f}, in the paper {paper:+z.1f}.",
        {"exact": gain, "paper": paper},
        (pointer("stages", "table", *place),),
        "bars of the distraction return by driver, with the own HMI, AvgHMI and no HMI",
        lambda: _draw_table(cells),
    )


_EXACT = "exact_distraction_return_same_steps"
"""Exact value over as many steps as the episodes had, as the returns next to it are."""


def _of(cells: Mapping[tuple[str, str], Any], row: str, driver: str) -> Mapping[str, Any]:
    found: Mapping[str, Any] = cells[driver if row == OWN else row, driver]
    return found


def _draw_table(cells: Mapping[tuple[str, str], Any]) -> bytes:
    with _small("distraction return") as (axes, done):
        for k, (row, name) in enumerate({OWN: "own HMI", AVERAGE: AVERAGE, NONE: "no HMI"}.items()):
            at = np.arange(len(PAPER_DRIVERS)) + 0.27 * (k - 1)
            means = [_of(cells, row, driver)[_METRIC]["mean"] for driver in PAPER_DRIVERS]
            exact = [_of(cells, row, driver)[_EXACT] for driver in PAPER_DRIVERS]
            axes.bar(at, means, 0.25, color=COLOURS[(3, 2, 0)[k]], label=name)
            label = "exact" if row == NONE else None
            axes.plot(at, exact, "_", color=ink(), ms=7, label=label)
        axes.set_xticks(range(len(PAPER_DRIVERS)), PAPER_DRIVERS)
        return done()


_WORTH = "exact_worth_same_steps"
"""Exact worth of knowing the driver over as many steps as the episodes had."""


def hidden_attention(hidden: Mapping[str, Any]) -> Exhibit:
    """Show what knowing the driver is worth for whom it is worth most, attention hidden."""
    rows = {row["driver"]: row for row in hidden["rows"]}
    listed = [rows[driver] for driver in PAPER_DRIVERS]
    most = max(listed, key=lambda row: float(row[_WORTH]))
    least = min(listed, key=lambda row: float(row[_WORTH]))
    value = Estimate.from_json(most["bayes_own_minus_average"])
    names = [row["driver"].title() for row in (most, least)]
    place = list(rows).index(most["driver"])
    return Exhibit(
        "hidden",
        "Attention hidden: where knowing the driver counts",
        value,
        value.shown("+z.1f"),
        f"Attention return per trip that a Bayes filter gains by knowing that {names[0]} drives, "
        "over assuming the average driver. By exact rules over as many steps: "
        f"{most[_WORTH]:+z.1f}, and least for {names[1]}, {least[_WORTH]:+z.1f}.",
        {"exact": most[_WORTH], "least": least[_WORTH]},
        (pointer("stages", "hidden", "rows", place, "bayes_own_minus_average"),),
        "worth of knowing the driver, by driver: Bayes filters, learned, and exact over as many "
        "steps",
        lambda: _draw_hidden(listed),
    )


def _draw_hidden(rows: list[Mapping[str, Any]]) -> bytes:
    with _small("worth of knowing") as (axes, done):
        at = np.arange(len(rows))
        for k, (name, label) in enumerate(
            {
                "bayes_own_minus_average": "Bayes filters",
                "own_minus_bayes_average": "learned HMI",
            }.items()
        ):
            found = [Estimate.from_json(row[name]) for row in rows]
            bars = np.array([[each.mean - each.low, each.high - each.mean] for each in found]).T
            where, how = at + 0.36 * (k - 0.5), {"ecolor": ink(), "elinewidth": 0.8}
            axes.bar(
                where,
                [each.mean for each in found],
                0.34,
                yerr=np.nan_to_num(bars),
                color=COLOURS[(2, 1)[k]],
                label=label,
                error_kw=how,
            )
        exact = [row[_WORTH] for row in rows]
        axes.plot(at, exact, "_", color=ink(), ms=20, label="exact")
        axes.axhline(0.0, color=ink(), lw=0.6)
        axes.set_xticks(at, [row["driver"] for row in rows])
        return done()


def latent_traits(traits: Mapping[str, Any]) -> Exhibit:
    """Show how many drivers are named right from z, and by the exact classifier."""
    settings, size = traits["supervisions"], traits["pool"]
    value = Estimate.from_json(settings[_BY_DRIVER]["accuracy"])
    identified = settings[_BY_DRIVER]["seeds"][0]["identified"]
    row = next(each for each in identified if each["windows"] == size)
    ceiling, chance = row["ceilings"], row["types"]["chance"]
    exact = None if ceiling is None else 100 * ceiling["identity"]["mean"]
    return Exhibit(
        "traits",
        "Latent traits: who is at the wheel",
        value,
        f"{value.percent()} %",
        f"Drivers named right from z of {size} windows, learned with labels of drivers; the exact "
        f"classifier names {number(exact)} %, a guess {100 * chance:.0f} %.",
        {"windows": size, "exact": exact, "chance": 100 * chance},
        (pointer("stages", "traits", "supervisions", _BY_DRIVER, "accuracy"),),
        "share of drivers named right by windows seen, by way of learning, and exactly",
        lambda: _draw_traits(settings),
    )


def _draw_traits(settings: Mapping[str, Mapping[str, Any]]) -> bytes:
    with _small("named right [%]", 3) as (axes, done):
        for k, (name, setting) in enumerate(settings.items()):
            found = [(row["windows"], row["accuracy"]["mean"]) for row in setting["by_windows"]]
            windows, shares = np.array(found).T
            colour = COLOURS[(0, 5, 6, 1)[k % 4]]
            axes.plot(windows, 100 * shares, "o-", ms=3, lw=1.2, color=colour, label=TITLES[name])
        rows = next(iter(settings.values()))["seeds"][0]["identified"]
        known = [(r["windows"], r["ceilings"]["identity"]["mean"]) for r in rows if r["ceilings"]]
        if known:
            windows, shares = np.array(known).T
            axes.plot(windows, 100 * shares, "--", color=ink(), lw=1.2, label="exact")
        axes.set_xscale("log", base=2)
        every = [row["windows"] for row in rows]
        axes.set_xticks(every, [str(windows) for windows in every])
        axes.minorticks_off()
        axes.set_xlabel("windows seen")
        axes.set_ylim(0, 103)
        return done()


@contextmanager
def _small(title: str, columns: int = 4) -> Iterator[tuple[Axes, Callable[[], bytes]]]:
    """Draw within on the axes of a small figure; the function then gives its PNG."""
    from matplotlib import rc_context

    with rc_context({"font.size": 7.5}):
        drawing = canvas(*_SIZE)
        axes = drawing.subplots()
        axes.grid(axis="y", color=faint(), linewidth=0.6)
        axes.set_axisbelow(True)
        axes.spines[["top", "right"]].set_visible(False)
        axes.set_ylabel(title)

        def done() -> bytes:
            handles = axes.get_legend_handles_labels()
            drawing.legend(*handles, loc="outside lower center", ncols=columns, frameon=False)
            return png(drawing, _DPI)

        yield axes, done
