"""Text, tables and figures of a study's analysis and of its power."""

from __future__ import annotations

from matplotlib.figure import Figure as Drawing

from hmi_marl.people.study.analyse import Analysis
from hmi_marl.people.study.power import Power
from hmi_marl.people.study.settings import POINTS, RATINGS
from hmi_marl.reporting.blocks import Block, Figure, Table, Text, Verdicts
from hmi_marl.reporting.drawing import COLOURS, canvas, png
from hmi_marl.text import in_figure

_TITLES = {
    "safe": "safe",
    "distracted": "distracted",
    "risky": "risky",
    "own": "similar to own driving",
}
_POWER = ("/contrasts", "/all")
"""Places of the numbers of the power in the JSON file."""
SIMULATED = (
    "SIMULATED raters: these numbers say what a study can find, and nothing about what people see."
)


def marked(title: str, simulated: bool) -> str:
    """Return a title that says whether raters were simulated."""
    return f"{title} (SIMULATED raters)" if simulated else title


def analysis_blocks(analysis: Analysis) -> list[Block]:
    """Blocks of the report of a study."""
    left = analysis.left_out
    about = (
        f"{analysis.raters} raters, who rated {analysis.ratings} clips. Left out: "
        f"{left.failed} who failed the attention check, {left.unfinished} who left before it."
    )
    marks: list[Block] = [Text(SIMULATED, "Simulated")] if analysis.simulated else []
    return [
        *marks,
        Text(about),
        Verdicts(
            [each.verdict for each in analysis.differences],
            marked("Intended differences", analysis.simulated),
            "Linear mixed models with random effects of raters, of raters with a driver, and of "
            "clips; intervals allow for all contrasts together.",
        ),
        Figure(
            "ratings-simulated" if analysis.simulated else "ratings",
            "mean ratings of each driver and control, with 95 % intervals",
            lambda: png(_draw_means(analysis)),
            sources=["/means"],
        ),
        _means(analysis),
        _contrasts(analysis),
        _deviations(analysis),
    ]


def _means(analysis: Analysis) -> Table:
    rows = [
        [name, *(analysis.mean(row, place).shown("z.2f") for row in range(len(RATINGS)))]
        for place, name in enumerate(analysis.conditions)
    ]
    return Table(
        marked("Mean ratings, 1 to 7", analysis.simulated),
        ["driver", *(_TITLES[rating] for rating in RATINGS)],
        rows,
        "95 % intervals, for further raters and further clips.",
        ["/means"],
    )


def _contrasts(analysis: Analysis) -> Table:
    rows = []
    for each in analysis.differences:
        odds = "no solution" if each.log_odds is None else each.log_odds.shown("z.2f")
        rows.append(
            [
                each.contrast.name,
                each.points.shown("z.2f"),
                str(each.verdict.outcome),
                odds,
                "-" if each.check is None else str(each.check.outcome),
            ]
        )
    return Table(
        marked("Differences by two models", analysis.simulated),
        ["contrast", "points", "verdict", "log odds", "ordinal check"],
        rows,
        "Each with its own 95 % interval; verdicts allow for all contrasts together (Holm). The "
        "ordinal check is a cumulative-link model with errors clustered by raters and by clips.",
        ["/contrasts", "/verdicts"],
    )


def _deviations(analysis: Analysis) -> Table:
    rows = [
        [_TITLES[rating], *(f"{value:.2f}" for value in _spread(analysis, place))]
        for place, rating in enumerate(RATINGS)
    ]
    return Table(
        marked("Standard deviations [points]", analysis.simulated),
        ["rating", "raters", "raters with a driver", "clips", "rest"],
        rows,
        "Where those of clips dominate, more clips help and more raters do not.",
        ["/deviations"],
    )


def _spread(analysis: Analysis, rating: int) -> tuple[float, float, float, float]:
    fit = analysis.fits[rating]
    return fit.rater, fit.rater_condition, fit.clip, fit.residual


def _draw_means(analysis: Analysis) -> Drawing:
    drawing = canvas(9.0, 1.6 + 0.32 * len(analysis.conditions) * 2)
    axes = drawing.subplots(2, 2, sharex=True, sharey=True)
    places = range(len(analysis.conditions))
    for row, rating in enumerate(RATINGS):
        panel = axes[row // 2, row % 2]
        for place in places:
            found = analysis.mean(row, place)
            low, high = max(found.low, 1.0), min(found.high, float(POINTS))
            colour = COLOURS[place % len(COLOURS)]
            panel.plot([low, high], [place, place], color=colour, linewidth=3)
            panel.plot(found.mean, place, "o", color=colour)
        panel.set_title(_TITLES[rating], fontsize=10)
        panel.set_xlim(0.8, POINTS + 0.2)
        panel.grid(axis="x", alpha=0.3)
    axes[0, 0].set_yticks(places, [in_figure(name) for name in analysis.conditions])
    axes[0, 0].invert_yaxis()
    drawing.suptitle(marked("Mean ratings and 95 % intervals", analysis.simulated), fontsize=11)
    return drawing


def power_blocks(power: Power) -> list[Block]:
    """Blocks of the report of a study's power."""
    settings, plan = power.settings, power.settings.plan
    about = (
        f"{settings.studies} simulated studies for each number of raters, in which every intended "
        f"difference is {plan.effect:g} points or more before rounding. Standard deviations: "
        f"raters {plan.rater:g}, raters with a driver {plan.rater_driver:g}, clips {plan.clip:g}, "
        f"rest {plan.residual:g}; {100 * plan.careless:g} % of raters fail the attention check."
    )
    return [
        Text(SIMULATED, "Simulated"),
        Text(about),
        _needed(power),
        _shares(power),
        Figure(
            "power-simulated",
            "power of each contrast by the number of raters",
            lambda: png(_draw_power(power)),
            sources=_POWER,
        ),
    ]


def _needed(power: Power) -> Table:
    most = power.settings.raters[-1]
    rows = [
        [name, f"{power.truth[place]:.2f}", power.needed(place).shown(most)]
        for place, name in enumerate(power.contrasts)
    ]
    rows.append(["all of them in one study", "", power.needed(None).shown(most)])
    return Table(
        marked(f"Raters needed for a power of {power.settings.power:g}", True),
        ["contrast", "planted [points]", "raters"],
        rows,
        "With the 95 % interval of this many simulated studies. Where no number of raters is "
        "enough, make the study with more clips.",
        [*_POWER, "/raters"],
    )


def _shares(power: Power) -> Table:
    rows = [
        [name, *(each[place].percent("z.0f") for each in power.shares)]
        for place, name in enumerate(power.contrasts)
    ]
    rows.append(["all of them", *(each.percent("z.0f") for each in power.every)])
    return Table(
        marked("Studies in which a contrast is supported [%]", True),
        ["contrast", *(f"{number} raters" for number in power.settings.raters)],
        rows,
        sources=_POWER,
    )


def _draw_power(power: Power) -> Drawing:
    drawing = canvas(8.0, 4.5)
    axes = drawing.subplots()
    for place, name in enumerate(power.contrasts):
        values = [each[place].mean for each in power.shares]
        colour = COLOURS[place % len(COLOURS)]
        style = "-" if place < len(COLOURS) else "--"
        axes.plot(power.settings.raters, values, style, color=colour, label=in_figure(name))
    axes.plot(power.settings.raters, [each.mean for each in power.every], "k:", label="all of them")
    axes.axhline(power.settings.power, color=COLOURS[0], linewidth=1)
    axes.set_ylim(-0.02, 1.02)
    axes.set_xlabel("raters")
    axes.set_ylabel("power")
    axes.set_title(marked("Power", True), fontsize=11)
    axes.legend(fontsize=7, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return drawing
