"""The answer of a comparison in one paragraph, written from its numbers."""

from __future__ import annotations

import math

from hmi_marl.experiments.protocols.arms import SIMULTANEOUS, TWO_STAGE
from hmi_marl.experiments.protocols.cross_play import cell_of
from hmi_marl.experiments.protocols.findings import differences, gap, way_to_optimum
from hmi_marl.experiments.protocols.results import Comparison, TaskResults, revealing
from hmi_marl.experiments.protocols.tables import given_up
from hmi_marl.reporting.blocks import Text
from hmi_marl.reporting.statistics import Estimate


def answer(comparison: Comparison) -> Text:
    """When joint training helps, by how much, through what, and what is left of it alone."""
    sentences = [
        *(_seen(comparison, results) for results in comparison.tasks.values() if _is_seen(results)),
        *(
            _hidden(results)
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
    most = f"at most {_per_trip(best.difference.estimate)} more than two-stage ({best.protocol})"
    if not known:
        return f"Task {name}: protocols earn {most}; one run each says no more."
    if apart:
        return f"Task {name}: {', '.join(apart)} differ from two-stage in attention return; {most}."
    return f"Task {name}: it does not help; no protocol differs in attention return; {most}."


def _hidden(results: TaskResults) -> str:
    name, own = results.plan.name, results.own
    gained = gap(results, SIMULTANEOUS)
    way = way_to_optimum(results, SIMULTANEOUS)
    shares = [results.mean_of(own(arm), revealing, 0.0) for arm in (SIMULTANEOUS, TWO_STAGE)]
    theirs, alone = (
        cell_of(results, driver, hmi).same_seed
        for driver, hmi in ((TWO_STAGE, SIMULTANEOUS), (TWO_STAGE, TWO_STAGE))
    )
    cost = given_up(results, SIMULTANEOUS)
    verb = "helps" if gained.mean > 0 and not gained.low <= 0 else "does not surely help"
    return (
        f"Task {name}: it {verb}: simultaneous learning earns {_per_trip(gained)} more attention "
        f"return than two-stage, {_share(way)} of the way to the optimum that sees attention. The "
        f"driver signals: its action reveals whether it is distracted in {_percent(shares[0])} of "
        f"the steps ({_percent(shares[1])} with the two-stage driver), for which it gives up "
        f"{_per_trip(cost)} in driving. Beside a driver that learned alone nothing is left of it: "
        f"the same HMI earns {theirs.shown('z.0f')} there, two-stage's own {alone.shown('z.0f')}."
        if theirs.mean < alone.mean
        else f"Task {name}: it {verb}: simultaneous learning earns {_per_trip(gained)} more "
        f"attention return than two-stage, {_share(way)} of the way to the optimum that sees "
        f"attention; its driver reveals distraction in {_percent(shares[0])} of the steps "
        f"({_percent(shares[1])} with the two-stage driver) and gives up {_per_trip(cost)} in "
        f"driving. Beside a driver that learned alone its HMI earns {theirs.shown('z.0f')}, "
        f"two-stage's own {alone.shown('z.0f')}."
    )


def _per_trip(estimate: Estimate) -> str:
    return estimate.shown("z.1f")


def _share(estimate: Estimate) -> str:
    return estimate.shown("z.2f")


def _percent(estimate: Estimate) -> str:
    return f"{100 * estimate.mean:.0f} %" if math.isfinite(estimate.mean) else "-"
