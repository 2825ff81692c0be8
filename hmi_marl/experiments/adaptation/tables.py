"""Tables of adaptive HMIs: what they earn, and how soon."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

from hmi_marl.experiments.adaptation.evaluation import REGRET_AT, WHEN, Result
from hmi_marl.experiments.adaptation.hmis import (
    ADAPTIVE,
    AVERAGE,
    CHOOSING,
    CONDITIONED,
    EXPECTED,
    KNOWING,
    LEARNED_AVERAGE,
    NONE,
)
from hmi_marl.experiments.adaptation.trips import Closed
from hmi_marl.reporting.blocks import Table
from hmi_marl.reporting.statistics import Estimate

LEARNED_ADAPTIVE = CHOOSING, CONDITIONED, EXPECTED
SHARE_COLUMNS = [f"after {when}" for when in WHEN]


def tables(results: Sequence[Result]) -> list[Table]:
    """Show returns, closed shares of the gaps, and regret after a change of driver."""
    steady = [result for result in results if result.shares]
    changing = [result for result in results if result.after_change]

    def last(hmi: str) -> Callable[[Result], str]:
        return lambda result: result.returns[hmi][-1].shown(".1f")

    worth: dict[str, Callable[[Result], str]] = {
        "driver": lambda result: result.group,
        "exact worth": lambda r: "" if r.exact_worth is None else f"{r.exact_worth:.1f}",
        "played": lambda result: result.shares[AVERAGE]["3 trips"].gap.shown(".1f"),
        **{hmi: last(hmi) for hmi in (KNOWING, AVERAGE, LEARNED_AVERAGE, NONE)},
    }
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
    regret = [
        [result.group, hmi, *(total.shown(".1f") for total in result.total_regret[hmi].values())]
        for result in steady
        for hmi in (AVERAGE, *ADAPTIVE)
    ]
    change = [
        [result.group, *(_percent(result.after_change[hmi]) for hmi in (AVERAGE, *ADAPTIVE))]
        for result in changing
    ]
    worth_title = "What knowing the driver is worth: attention return per trip, attention hidden"
    shares_title = "Share of the gap from AvgHMI to the knowing HMI that is closed [%]"
    learned_title = (
        "The same between learned HMIs: learned AvgHMI and the one learned for the driver [%]"
    )
    regret_title = "Regret against the exact rule for the driver, by time at the wheel: return lost"
    change_title = (
        "Regret from 20 to 40 s after a change of driver, of what the knowing HMI earns [%]"
    )
    head, sources = ["driver", "HMI", *SHARE_COLUMNS], ["/results"]
    return [
        Table.of(worth_title, steady, worth, sources=sources),
        Table(shares_title, [*head, "regret per trip, last"], shares, sources=sources),
        Table(learned_title, [*head, "gap per trip"], learned, sources=sources),
        Table(regret_title, ["driver", "HMI", *REGRET_AT], regret, sources=sources),
        Table("Gain over AvgHMI in the first 5 s", ["driver", *ADAPTIVE], first, sources=sources),
        Table(change_title, ["change", AVERAGE, *ADAPTIVE], change, sources=sources),
    ]


def _closed(shares: Mapping[str, Closed]) -> list[str]:
    return [_percent(shares[when].share) for when in WHEN]


def _percent(estimate: Estimate, unit: str = "") -> str:
    return "no gap" if math.isnan(estimate.mean) else f"{estimate.percent('.1f')}{unit}"
