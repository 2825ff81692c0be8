"""What a comparison shows: differences between protocols, the sweep over λ, and the verdicts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from hmi_marl.experiments import criteria
from hmi_marl.experiments.protocols.arms import (
    ANCHORED,
    JOINT,
    MAIN,
    SIMULTANEOUS,
    TWO_STAGE,
)
from hmi_marl.experiments.protocols.gaming import Finding, gaming_of, worst_finding
from hmi_marl.experiments.protocols.pairs import pairs_of
from hmi_marl.experiments.protocols.results import (
    Comparison,
    TaskResults,
    attention,
    divergence,
    optimum,
)
from hmi_marl.reporting import statistics
from hmi_marl.reporting.many_runs import Difference, over_runs, paired_differences
from hmi_marl.reporting.statistics import Estimate
from hmi_marl.reporting.verdicts import Outcome, Verdict

COMPARED_METRICS = ("team_return", "attention_return")
"""Metrics in which protocols are compared with two-stage."""
_OUTCOMES: dict[Finding, Outcome] = {
    "fine": Outcome.SUPPORTED,
    "crashes more": Outcome.PARTLY,
    "GAMED": Outcome.NOT_SUPPORTED,
    "unknown": Outcome.UNTESTABLE,
}


@dataclass(frozen=True)
class Compared:
    """A protocol minus two-stage in one metric, paired by seed."""

    task: str
    protocol: str
    metric: str
    difference: Difference


def differences(comparison: Comparison) -> list[Compared]:
    """Compare every protocol with two-stage, corrected for all comparisons of the report."""
    kinds, pairs = [], []
    for name, results in comparison.tasks.items():
        if TWO_STAGE not in results.plan.protocols:
            continue
        for protocol in results.plan.protocols:
            for metric in COMPARED_METRICS if protocol != TWO_STAGE else ():
                kinds.append((name, protocol, metric))
                pairs.append(
                    (
                        results.values(results.own(protocol), metric),
                        results.values(results.own(TWO_STAGE), metric),
                    )
                )
    return [
        Compared(*kind, difference)
        for kind, difference in zip(kinds, paired_differences(pairs), strict=True)
    ]


@dataclass(frozen=True)
class SweepPoint:
    """Learning together with one weight λ on the divergence from the natural driver."""

    arm: str
    weight: float
    """λ; 0 for the free driver, infinite for the natural one."""
    divergence: Estimate
    """Divergence of the driver from the natural one [nats per step]."""
    attention_return: Estimate
    team_return: Estimate
    score: Estimate


def sweep(results: TaskResults) -> list[SweepPoint]:
    """Points of the sweep by rising λ, from the free driver to the two-stage one; or none."""
    arms = results.plan.arms
    anchored = [arm for arm in arms.values() if arm.anchor_kl is not None]
    if not anchored or not {TWO_STAGE, SIMULTANEOUS} <= arms.keys():
        return []
    weights = [(SIMULTANEOUS, 0.0)]
    weights += sorted(((a.name, float(a.anchor_kl or 0.0)) for a in anchored), key=lambda p: p[1])
    weights.append((TWO_STAGE, math.inf))
    return [
        SweepPoint(
            name,
            weight,
            results.mean_of(results.own(name), divergence, lowest=0.0),
            results.over_runs(results.own(name), "attention_return"),
            results.over_runs(results.own(name), "team_return"),
            results.score(results.own(name)),
        )
        for name, weight in weights
    ]


def is_monotone(points: Sequence[SweepPoint]) -> bool:
    """Whether divergence and attention return fall with rising λ, as far as intervals tell.

    A rise counts where the intervals of two neighbours do not overlap.
    """
    return all(
        not _surely_less(getattr(before, name), getattr(after, name))
        for before, after in pairwise(points)
        for name in ("divergence", "attention_return")
    )


def _surely_less(one: Estimate, other: Estimate) -> bool:
    return math.isfinite(one.high) and math.isfinite(other.low) and one.high < other.low


def judge(comparison: Comparison) -> list[Verdict]:
    """Judge the comparison's statements, and whether each protocol is gamed."""
    verdicts: list[Verdict] = []
    changes = differences(comparison)
    for name, results in comparison.tasks.items():
        if not results.plan.task.hidden and results.plan.name == "seen":
            verdicts += [*_near_optimum(results), *_no_difference(name, changes)]
        if results.plan.task.hidden and results.plan.task.sequential:
            verdicts += [*_signalling_pays(results), *_no_convention(results), *_sweep(results)]
        if results.plan.standing_runs:
            verdicts += _not_gamed(results)
    return verdicts


def _near_optimum(results: TaskResults) -> list[Verdict]:
    """Attention seen: the exact optimum of attention is reached."""
    verdicts = []
    for protocol in results.plan.protocols:
        pairs = results.own(protocol)
        ours = results.mean_of(pairs, attention)
        best = results.mean_of(pairs, optimum)
        near = ours.agrees(best.mean, criteria.EXACT_TOLERANCE)
        claim = (
            f"{results.plan.name}, {protocol}: attention return within "
            f"{100 * criteria.EXACT_TOLERANCE:g} % of the exact optimum"
        )
        reason = f"{ours.shown()}, optimum {best.mean:.1f}, {len(pairs)} runs"
        verdicts.append(Verdict.of_parts(claim, [near], reason))
    return verdicts


def _no_difference(task: str, changes: Sequence[Compared]) -> list[Verdict]:
    """Attention seen: protocols do not differ in attention return."""
    found = [c for c in changes if c.task == task and c.metric == "attention_return"]
    if not found:
        return []
    apart = [c for c in found if c.difference.differs]
    known = [c for c in found if c.difference.differs is not None]
    claim = f"{task}: no protocol differs from two-stage in attention return"
    reason = "; ".join(
        f"{c.protocol} {c.difference.estimate.shown('+z.1f')}" for c in apart or found
    )
    if not known:
        return [Verdict(claim, Outcome.UNTESTABLE, reason)]
    return [Verdict(claim, Outcome.NOT_SUPPORTED if apart else Outcome.SUPPORTED, reason)]


def way_to_optimum(results: TaskResults, protocol: str) -> Estimate:
    """Share of the way from two-stage's HMI to the optimum that sees attention, over runs."""
    theirs = results.own(TWO_STAGE)
    ours = results.own(protocol)
    count = min(len(ours), len(theirs))
    gained = results.scores(ours[:count]).mean(axis=1) - results.scores(theirs[:count]).mean(axis=1)
    left = 1.0 - results.scores(theirs[:count]).mean(axis=1)
    return over_runs(np.stack([gained, left], axis=1), _ratio_of_means)


def _ratio_of_means(parts: np.ndarray) -> np.ndarray:
    means = parts.mean(axis=-2)
    return np.asarray(means[..., 0] / means[..., 1])


def _signalling_pays(results: TaskResults) -> list[Verdict]:
    """Attention hidden: learning together closes most of the gap."""
    if not {TWO_STAGE, SIMULTANEOUS} <= set(results.plan.protocols):
        return []
    way = way_to_optimum(results, SIMULTANEOUS)
    claim = (
        f"{results.plan.name}, {SIMULTANEOUS}: at least {criteria.SIGNALLING_GAIN:g} of the way "
        "from the two-stage HMI to the optimum that sees attention"
    )
    known = math.isfinite(way.low)
    outcome = Outcome.SUPPORTED if way.mean >= criteria.SIGNALLING_GAIN else Outcome.NOT_SUPPORTED
    reason = f"{way.shown('.2f')} over {len(results.own(SIMULTANEOUS))} runs"
    return [Verdict(claim, outcome if known else Outcome.UNTESTABLE, reason)]


def _no_convention(results: TaskResults) -> list[Verdict]:
    """Attention hidden: a jointly trained HMI does not help a driver that learned alone."""
    verdicts = []
    for protocol in (JOINT, SIMULTANEOUS):
        if not {protocol, TWO_STAGE} <= set(results.plan.protocols) or not results.average_hmi:
            continue
        pairs = pairs_of(results.plan, TWO_STAGE, protocol, 0)
        rivals = [results.average_hmi[pair.driver] for pair in pairs]
        (change,) = paired_differences(
            [
                (
                    results.values(pairs, "attention_return"),
                    results.values(rivals, "attention_return"),
                )
            ],
            comparisons=2,
        )
        below = change.estimate.mean < 0.0 and bool(change.differs)
        claim = (
            f"{results.plan.name}, {protocol}: its HMI does worse with the stage-1 driver than the "
            "HMI for the average driver"
        )
        reason = f"{change.estimate.shown('+z.1f')} per episode, paired over {change.pairs} runs"
        outcome = Outcome.SUPPORTED if below else Outcome.NOT_SUPPORTED
        verdicts.append(
            Verdict(claim, Outcome.UNTESTABLE if change.differs is None else outcome, reason)
        )
    return verdicts


def _sweep(results: TaskResults) -> list[Verdict]:
    """Human-regularised learning: between the natural driver and the free one."""
    points = sweep(results)
    if not points:
        return []
    free, natural, inner = points[0], points[-1], points[1:-1]
    ends = [
        _overlap(inner[0].attention_return, free.attention_return),
        _overlap(inner[-1].attention_return, natural.attention_return),
    ]
    claim = (
        f"{results.plan.name}: divergence and attention return fall with λ, from those of the free "
        "driver to those of the two-stage one"
    )
    reason = ", ".join(
        f"λ = {p.weight:g}: {p.divergence.mean:.3f} nats, {p.attention_return.mean:.0f}"
        for p in points
    )
    if not all(math.isfinite(p.attention_return.low) for p in points):
        return [Verdict(claim, Outcome.UNTESTABLE, reason)]
    return [Verdict.of_parts(claim, [is_monotone(points), *ends], reason)]


def _overlap(one: Estimate, other: Estimate) -> bool:
    return not (_surely_less(one, other) or _surely_less(other, one))


def _not_gamed(results: TaskResults) -> list[Verdict]:
    """Crashing early does not pay."""
    gaming, verdicts = gaming_of(results), []
    for protocol in results.plan.protocols:
        if protocol == TWO_STAGE:
            continue
        worst = worst_finding(gaming, protocol)
        rows = [row for row in gaming if row.protocol == protocol and row.finding == worst]
        reason: str = worst
        if worst != "fine":
            reason += f" with {', '.join(row.driver for row in rows)}"
        claim = f"{protocol}: crashes no more than {TWO_STAGE}, and crashing does not pay"
        verdicts.append(Verdict(claim, _OUTCOMES[worst], reason))
    return verdicts


def main_protocols(results: TaskResults) -> list[str]:
    """Protocols with all seeds that this task has."""
    return [name for name in MAIN if name in results.plan.protocols]


def anchored_name(weight: float) -> str:
    """Name of the arm with this λ."""
    return ANCHORED.format(weight)


def gap(results: TaskResults, protocol: str) -> Estimate:
    """Attention return of a protocol minus two-stage's, paired by seed, one comparison."""
    ours = results.values(results.own(protocol), "attention_return")
    theirs = results.values(results.own(TWO_STAGE), "attention_return")
    count = min(len(ours), len(theirs))
    return statistics.mean(np.array(ours[:count]) - np.array(theirs[:count]))
