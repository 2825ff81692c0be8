"""The answer of a comparison in one paragraph, written from its numbers."""

from __future__ import annotations

import math

from hmi_marl.experiments.protocols.arms import SIMULTANEOUS, TWO_STAGE
from hmi_marl.experiments.protocols.findings import (
    against_average_hmi,
    differences,
    way_to_optimum,
    why,
)
from hmi_marl.experiments.protocols.pairs import pairs_of
from hmi_marl.experiments.protocols.results import (
    Comparison,
    TaskResults,
    given_up,
    regret,
    revealing,
)
from hmi_marl.reporting.blocks import Text
from hmi_marl.reporting.statistics import Estimate


def answer(comparison: Comparison) -> Text:
    """Say when joint training helps, by how much, through what, and what a lone driver keeps."""
    sentences = [
        *(_seen(comparison, results) for results in comparison.tasks.values() if _is_seen(results)),
        *(
            _hidden(comparison, results)
            for results in comparison.tasks.values()
            if results.plan.task.hidden and _has_both(results)
        ),
    ]
    text = " ".join(sentences) or "No task here has both two-stage and simultaneous learning."
    return Text(text, "When does joint training help?")


def _is_seen(results: TaskResults) -> bool:
    return not results.plan.task.hidden and TWO_STAGE in results.plan.protocols


def _has_both(results: TaskResults) -> bool:
    return {TWO_STAGE, SIMULTANEOUS} <= set(results.plan.protocols)


def _seen(comparison: Comparison, results: TaskResults) -> str:
    name = results.plan.name
    changes = [
        change
        for change in differences(comparison)
        if change.task == name and change.metric == "attention_return"
    ]
    if not changes:
        return ""
    best = max(changes, key=lambda change: change.difference.estimate.mean)
    known = [change for change in changes if change.difference.differs is not None]
    apart = [change.protocol for change in known if change.difference.differs]
    most = f"at best {_more(best.difference.estimate)} than two-stage ({best.protocol})"
    missing = results.against_exact(results.own(TWO_STAGE), regret)
    left = f"Two-stage earns {_more(-missing)} than the exact optimum over its own episodes."
    if not known:
        return f"Task {name}: protocols earn {most}, by one run each. {left}"
    if apart:
        reasons = "; ".join(why(results, change) for change in known if change.difference.differs)
        verb = "differs" if len(apart) == 1 else "differ"
        return (
            f"Task {name}: {', '.join(apart)} {verb} from two-stage in attention return; {most}. "
            f"By cause: {reasons}. {left}"
        )
    return f"Task {name}: no protocol is found to differ in attention return; {most}. {left}"


def _hidden(comparison: Comparison, results: TaskResults) -> str:
    name, own = results.plan.name, results.own
    (gained,) = (
        change.difference
        for change in differences(comparison)
        if (change.task, change.protocol, change.metric) == (name, SIMULTANEOUS, "attention_return")
    )
    verb = "does not surely help"
    if gained.differs:
        verb = "helps" if gained.estimate.mean > 0.0 else "harms"
    way = way_to_optimum(results, SIMULTANEOUS)
    shares = [results.mean_of(own(arm), revealing) for arm in (SIMULTANEOUS, TWO_STAGE)]
    cost = given_up(results, SIMULTANEOUS)
    return (
        f"Task {name}: it {verb}: simultaneous learning earns {_more(gained.estimate)} attention "
        f"return than two-stage, {way.shown('z.2f')} of the way to the optimum that sees "
        f"attention. Its driver's action reveals whether it is distracted in {_percent(shares[0])} "
        f"of the steps ({_percent(shares[1])} with the two-stage driver), and it "
        f"{_given_up(cost)} in driving. {_left(results)}"
    )


def _left(results: TaskResults) -> str:
    """Return of the simultaneous HMI with a driver that learned alone."""
    other, alone = (
        results.over_runs(pairs_of(results.plan, TWO_STAGE, hmi, 0), "attention_return", True)
        for hmi in (SIMULTANEOUS, TWO_STAGE)
    )
    change = against_average_hmi(results).get(SIMULTANEOUS)
    text = (
        f"With a driver that learned alone its HMI earns {other.shown('z.0f')}, two-stage's own "
        f"{alone.shown('z.0f')}"
    )
    if change is None:
        return f"{text}."
    less = "surely less" if change.estimate.high < 0.0 else "not surely less"
    amount = change.estimate.shown("+z.0f")
    return f"{text}; that is {less} than the HMI for the average driver earns ({amount})."


def _more(difference: Estimate) -> str:
    """Write a difference as so much more or less."""
    if difference.mean < 0.0:
        return f"{_amount(-difference)} less"
    return f"{_amount(difference)} more"


def _given_up(cost: Estimate) -> str:
    return f"gains {_amount(-cost)}" if cost.mean < 0.0 else f"gives up {_amount(cost)}"


def _amount(estimate: Estimate) -> str:
    return estimate.shown("z.1f")


def _percent(estimate: Estimate) -> str:
    return f"{100 * estimate.mean:.0f} %" if math.isfinite(estimate.mean) else "-"
