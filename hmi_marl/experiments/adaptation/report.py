"""Judge adaptive HMIs, and show them in tables and a figure."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Drawing

from hmi_marl.experiments import criteria
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
from hmi_marl.experiments.adaptation.trips import Closed
from hmi_marl.reporting.blocks import Block, Figure, Table, Text, png
from hmi_marl.reporting.statistics import Estimate
from hmi_marl.reporting.verdicts import Verdict

NOTE = (
    "Attention is hidden, and the driver is not known. Every HMI meets the same drivers on the "
    "same roads. Shares are of the gap between two exact rules, AvgHMI's and that of the driver at "
    "the wheel, and may exceed 100 % by chance; where there is no clear gap, no share is given. "
    "HMIs marked Bayes use the exact evidence of the chain instead of the learned encoder. "
    "Verdicts are on the HMI of expected value with the learned encoder, by means of shares and "
    "regrets; their intervals are in the tables."
)
LEARNED_ADAPTIVE = CHOOSING, CONDITIONED, EXPECTED
SHARE_COLUMNS = [f"after {when}" for when in WHEN]
COLOURS = {
    KNOWING: "#444a55",
    AVERAGE: "#9aa1ab",
    EXPECTED: "#32a050",
    EXPECTED + BAYES: "#5aa9e0",
    CHOOSING: "#e0a030",
    CONDITIONED: "#b0508c",
}


def judge(results: Sequence[Result]) -> list[Verdict]:
    """Judge the HMI of expected value with the learned encoder."""
    by_group = {result.group: result for result in results}
    targets = [
        (driver, when, least)
        for driver in criteria.GAP_DRIVERS
        for when, least in criteria.GAP_CLOSED.items()
    ]
    verdicts = []
    for group, when, least in (*targets, (POPULATION, "3 trips", criteria.POPULATION_GAP_CLOSED)):
        share = by_group[group].shares[EXPECTED][when].share
        claim = f"{group}: {100 * least:.0f} % of the gap closed after {when}"
        verdicts.append(Verdict.of_parts(claim, [share.mean >= least], f"{_percent(share)} %"))
    for result in results:
        if result.after_change:
            regret, most = result.after_change[EXPECTED], criteria.MOST_REGRET
            claim = f"{result.group}: within {100 * most:.0f} % of knowing after 20 s"
            reason = f"regret {_percent(regret)} %"
            verdicts.append(Verdict.of_parts(claim, [regret.mean <= most], reason))
        else:
            gain = result.first_seconds[EXPECTED]
            claim = f"{result.group}: first 5 s not worse than AvgHMI by more than the interval"
            verdicts.append(Verdict.of_parts(claim, [gain.high >= 0], gain.shown(".1f")))
    return verdicts


def blocks(results: Sequence[Result]) -> list[Block]:
    """Show the figure and all tables."""
    return [Text(NOTE), figure(results), *tables(results)]


def tables(results: Sequence[Result]) -> list[Table]:
    """Show returns, closed shares of the gaps, and regret after a change of driver."""
    steady = [result for result in results if result.shares]
    changing = [result for result in results if result.after_change]
    worth = [
        [
            result.group,
            "" if result.exact_worth is None else f"{result.exact_worth:.1f}",
            result.shares[AVERAGE]["3 trips"].gap.shown(".1f"),
            *(
                result.returns[hmi][-1].shown(".1f")
                for hmi in (KNOWING, AVERAGE, LEARNED_AVERAGE, NONE)
            ),
        ]
        for result in steady
    ]
    shares = [
        [result.group, hmi, *_closed(closed), closed["3 trips"].regret.shown(".1f")]
        for result in steady
        for hmi, closed in result.shares.items()
        if hmi in ADAPTIVE
    ]
    learned = [
        [result.group, hmi, *_closed(closed), closed["3 trips"].gap.shown(".1f")]
        for result in steady
        for hmi, closed in result.learned_shares.items()
        if hmi in LEARNED_ADAPTIVE
    ]
    first = [
        [result.group, *(result.first_seconds[hmi].shown(".1f") for hmi in ADAPTIVE)]
        for result in steady
    ]
    change = [
        [result.group, *(_percent(result.after_change[hmi]) for hmi in (AVERAGE, *ADAPTIVE))]
        for result in changing
    ]
    return [
        Table(
            "What knowing the driver is worth: attention return per trip, attention hidden",
            ["driver", "exact worth", "played", KNOWING, AVERAGE, LEARNED_AVERAGE, NONE],
            worth,
        ),
        Table(
            "Share of the gap from AvgHMI to the knowing HMI that is closed [%]",
            ["driver", "HMI", *SHARE_COLUMNS, "regret per trip, last"],
            shares,
        ),
        Table(
            "The same between learned HMIs: learned AvgHMI and the one learned for the driver [%]",
            ["driver", "HMI", *SHARE_COLUMNS, "gap per trip"],
            learned,
        ),
        Table("Gain over AvgHMI in the first 5 s", ["driver", *ADAPTIVE], first),
        Table(
            "Regret from 20 to 40 s after a change of driver, of what the knowing HMI earns [%]",
            ["change", AVERAGE, *ADAPTIVE],
            change,
        ),
    ]


def figure(results: Sequence[Result]) -> Figure:
    """Draw regret, and belief in the true type, by time driven."""
    drivers = criteria.GAP_DRIVERS
    shown = [r for r in results if r.group in (*drivers, POPULATION)]
    shown += [r for r in results if r.after_change and r.group.endswith(drivers)]
    drawing = Drawing(figsize=(3.4 * len(shown), 5.6), layout="constrained")
    axes = drawing.subplots(2, len(shown), squeeze=False)
    for column, result in zip(axes.T, shown, strict=True):
        _draw_regret(column[0], result)
        _draw_belief(column[1], result)
    axes[0, 0].set_ylabel("regret per step")
    axes[1, 0].set_ylabel("probability of the true type")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    drawing.legend(handles, labels, loc="outside lower center", ncols=5)
    return Figure("adapt", "Regret and belief by time at the wheel", png(drawing, 100))


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


def _closed(shares: Mapping[str, Closed]) -> list[str]:
    return [_percent(shares[when].share) for when in WHEN]


def _percent(estimate: Estimate) -> str:
    return "no gap" if math.isnan(estimate.mean) else estimate.percent(".1f")
