"""What a comparison shows: differences between protocols, the sweep over λ, and the verdicts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hmi_marl.experiments import criteria
from hmi_marl.experiments.episode_sums import Sums
from hmi_marl.experiments.protocols.arms import (
    JOINT,
    MAIN,
    SIMULTANEOUS,
    TWO_STAGE,
)
from hmi_marl.experiments.protocols.gaming import Gaming, gaming_of, worst_finding
from hmi_marl.experiments.protocols.pairs import pairs_of
from hmi_marl.experiments.protocols.results import (
    Comparison,
    TaskResults,
    divergence,
    optimum,
    regret,
)
from hmi_marl.reporting import statistics
from hmi_marl.reporting.many_runs import Difference, over_runs, paired_differences
from hmi_marl.reporting.statistics import UNKNOWN, Estimate
from hmi_marl.reporting.verdicts import SEEDS, Part, Verdict

COMPARED_METRICS = ("team_return", "attention_return")
"""Metrics in which protocols are compared with two-stage."""
SWEPT = ("divergence", "attention_return")
"""Quantities that should fall with λ."""


@dataclass(frozen=True)
class Compared:
    """A protocol minus its reference, two-stage, in one metric, paired by seed."""

    task: str
    protocol: str
    metric: str
    difference: Difference


def differences(comparison: Comparison) -> list[Compared]:
    """Compare every protocol with two-stage, corrected for the number of comparisons.

    Protocols with all seeds are one family, of which the report speaks; those with a few seeds are
    another, which can only show large differences.
    """
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
    families = [
        [k for k, kind in enumerate(kinds) if (kind[1] in MAIN) == main] for main in (True, False)
    ]
    found = {
        place: difference
        for family in families
        for place, difference in zip(
            family, paired_differences([pairs[place] for place in family]), strict=True
        )
    }
    return [Compared(*kind, found[place]) for place, kind in enumerate(kinds)]


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
            results.mean_of(results.own(name), divergence),
            results.over_runs(results.own(name), "attention_return"),
            results.over_runs(results.own(name), "team_return"),
            results.score(results.own(name)),
        )
        for name, weight in weights
    ]


def _falling(results: TaskResults, points: Sequence[SweepPoint]) -> list[Part]:
    """State that neither quantity rises from one λ to the next, paired by seed.

    A rise of less than ``criteria.SWEEP_END`` of the way between the ends counts as none.
    """
    found = []
    for name in SWEPT:
        values = [_swept(results, point.arm, name) for point in points]
        most = criteria.SWEEP_END * abs(float(values[0].mean() - values[-1].mean()))
        changes = paired_differences([(after, before) for before, after in pairwise(values)])
        for (one, other), change in zip(pairwise(points), changes, strict=True):
            what = f"{name.replace('_', ' ')}, λ = {other.weight:g} less {one.weight:g}"
            found.append(_over_runs(what, change.estimate, paired=True, below=most))
    return found


def _swept(results: TaskResults, arm: str, name: str) -> NDArray[np.float64]:
    """Values of a quantity of the sweep, one for each run."""
    own = results.own(arm)
    if name == "divergence":
        return results.by_driver(own, divergence).mean(axis=1)
    return results.values(own, name)


def judge(comparison: Comparison) -> list[Verdict]:
    """Judge the comparison's statements, and whether each protocol is gamed."""
    verdicts: list[Verdict] = []
    changes = differences(comparison)
    for results in comparison.tasks.values():
        if results.plan.name == "seen":
            verdicts += [*_near_optimum(results), *_no_difference(results, changes)]
        if results.plan.task.hidden and results.plan.task.sequential:
            verdicts += [*_signalling_pays(results), *_no_convention(results), *_sweep(results)]
        if results.plan.standing_runs:
            verdicts += _not_gamed(results)
    return verdicts


def _near_optimum(results: TaskResults) -> list[Verdict]:
    """Attention seen: the exact optimum of attention is reached.

    The whole interval must lie within the tolerance, so that a wide one supports nothing.
    """
    verdicts = []
    for protocol in results.plan.protocols:
        pairs = results.own(protocol)
        missing = results.against_exact(pairs, regret)
        best = results.mean_of(pairs, optimum).mean
        most = criteria.EXACT_TOLERANCE * abs(best)
        claim = (
            f"{results.plan.name}, {protocol}: attention return within "
            f"{100 * criteria.EXACT_TOLERANCE:g} % of the exact optimum"
        )
        part = _within(f"optimum {best:.1f}, less the return", missing, most)
        verdicts.append(Verdict(claim, (part,)))
    return verdicts


def _over_runs(what: str, estimate: Estimate, **more: Any) -> Part:
    """State something of an estimate over training runs, each of a seed of its own."""
    return Part.mean(what, estimate, SEEDS, seeds=estimate.count, form="+z.1f", **more)


def _within(what: str, difference: Estimate, most: float) -> Part:
    """State that a difference is small, by its whole interval."""
    return _over_runs(what, difference, paired=True, above=-most, below=most)


def _no_difference(results: TaskResults, changes: Sequence[Compared]) -> list[Verdict]:
    """Attention seen: protocols do not differ in attention return.

    Every interval must lie within the tolerance, since few runs find no difference anywhere.
    """
    task = results.plan.name
    found = [c for c in changes if c.task == task and c.metric == "attention_return"]
    if not found:
        return []
    best = results.mean_of(results.own(TWO_STAGE), optimum).mean
    most = criteria.EXACT_TOLERANCE * abs(best)
    claim = (
        f"{task}: no protocol differs from two-stage in attention return, by intervals within "
        f"{100 * criteria.EXACT_TOLERANCE:g} % of the optimum"
    )
    parts = (_within(c.protocol, c.difference.estimate, most) for c in found)
    reasons = [why(results, c) for c in found if not c.difference.estimate.agrees(0.0, 0.0)]
    return [Verdict(claim, tuple(parts), "; ".join(reasons))]


def why(results: TaskResults, change: Compared) -> str:
    """Split a difference in attention return into the lengths of episodes and the HMI's part.

    The exact optimum of a pair depends on how long its episodes are, that is on its driver's
    crashes; what the HMI earns less than that optimum is its own.
    """
    best = [
        results.by_driver(results.own(arm), optimum).mean(axis=1)
        for arm in (change.protocol, TWO_STAGE)
    ]
    count = min(map(len, best))
    lengths = float((best[0][:count] - best[1][:count]).mean())
    whole = change.difference.estimate.mean
    return (
        f"{change.protocol}: of {whole:+.1f}, {lengths:+.1f} is the exact optimum over the lengths "
        f"of its own episodes, {whole - lengths:+.1f} the HMI"
    )


def way_to_optimum(results: TaskResults, protocol: str) -> Estimate:
    """Share of the way from two-stage's HMI to the optimum that sees attention, over runs.

    The luck of the episodes that all runs share is added, to first order, as in the scores.
    Unknown where two-stage is at the optimum, or no driver has a score.
    """
    own = [results.own(protocol), results.own(TWO_STAGE)]
    count = min(map(len, own))
    if not results.scored_drivers:
        return UNKNOWN
    ours, theirs = (results.scores(pairs[:count]).mean(axis=1) for pairs in own)
    if theirs.mean() >= 1.0:
        return UNKNOWN
    found = over_runs(np.stack([ours - theirs, 1.0 - theirs], axis=1), _ratio_of_means)
    (our_luck, units), (their_luck, _) = (results.luck_of_scores(pairs[:count]) for pairs in own)
    missing = 1.0 - theirs.mean()  # of which the way w = 1 - (1 - ours) / missing is left
    parts = np.concatenate([our_luck, (1.0 - found.mean) * their_luck]) / len(our_luck)
    return statistics.widened(found, math.hypot(*parts) / float(missing), units)


def _ratio_of_means(parts: NDArray[np.float64]) -> NDArray[np.float64]:
    means = parts.mean(axis=-2)
    return np.asarray(means[..., 0] / means[..., 1])


def _signalling_pays(results: TaskResults) -> list[Verdict]:
    """Attention hidden: learning together closes most of the gap, by its whole interval."""
    if not {TWO_STAGE, SIMULTANEOUS} <= set(results.plan.protocols):
        return []
    way = way_to_optimum(results, SIMULTANEOUS)
    claim = (
        f"{results.plan.name}, {SIMULTANEOUS}: at least {criteria.SIGNALLING_GAIN:g} of the way "
        "from the two-stage HMI to the optimum that sees attention"
    )
    gain, form = criteria.SIGNALLING_GAIN, "z.2f"
    part = Part.mean("share of the way", way, SEEDS, above=gain, seeds=way.count, form=form)
    return [Verdict(claim, (part,), "standard error by bootstrap over runs, and of their episodes")]


def against_average_hmi(results: TaskResults) -> dict[str, Difference]:
    """Compare jointly trained HMIs with the HMI for the average driver, with the stage-1 driver.

    Attention return by protocol, paired by seed over the same episodes, corrected for their number.
    """
    own = results.plan.protocols
    if TWO_STAGE not in own or not results.average_hmi:
        return {}
    pairs = {
        name: pairs_of(results.plan, TWO_STAGE, name, 0)
        for name in (JOINT, SIMULTANEOUS)
        if name in own
    }
    rivals = {
        name: [results.average_hmi[pair.driver] for pair in each] for name, each in pairs.items()
    }
    metric = "attention_return"
    changes = paired_differences(
        [
            (results.values(pairs[name], metric, True), results.values(rivals[name], metric, True))
            for name in pairs
        ]
    )
    return dict(zip(pairs, changes, strict=True))


def _no_convention(results: TaskResults) -> list[Verdict]:
    """Attention hidden: a jointly trained HMI does not help a driver that learned alone."""
    verdicts = []
    for protocol, change in against_average_hmi(results).items():
        claim = (
            f"{results.plan.name}, {protocol}: its HMI does worse with the stage-1 driver than the "
            "HMI for the average driver"
        )
        part = _over_runs("difference per episode", change.estimate, paired=True, below=0.0)
        verdicts.append(Verdict(claim, (part,)))
    return verdicts


def _sweep(results: TaskResults) -> list[Verdict]:
    """Human-regularised learning: from the free driver to the natural one.

    The ends are judged by paired differences in attention return: each must lie within a share of
    the way between the free driver and the natural one. Without such a way nothing is supported.
    """
    points = sweep(results)
    if not points:
        return []
    values = [_swept(results, point.arm, "attention_return") for point in points]
    whole, first, last = (
        difference.estimate
        for difference in paired_differences(
            [(values[0], values[-1]), (values[0], values[1]), (values[-2], values[-1])]
        )
    )
    name, most = results.plan.name, criteria.SWEEP_END * abs(whole.mean)
    shown = ", ".join(
        f"λ = {p.weight:g}: {p.divergence.mean:.3f} nats, {p.attention_return.mean:.0f}"
        for p in points
    )
    claims = {
        "falls": f"{name}: divergence and attention return fall with λ",
        "free": f"{name}: with the smallest λ as with the free driver",
        "natural": f"{name}: with the largest λ as with the two-stage driver",
    }
    way = _over_runs("free minus two-stage", whole, paired=True, above=0.0)
    return [
        Verdict(claims["falls"], (way, *_falling(results, points)), shown),
        Verdict(claims["free"], (_within("free minus smallest λ", first, most),)),
        Verdict(claims["natural"], (_within("largest λ minus two-stage", last, most),)),
    ]


def _not_gamed(results: TaskResults) -> list[Verdict]:
    """Crashing early does not pay: no driver crashes more than the two-stage one.

    Crash rates are paired by seed. Whether crashing would pay is added as the reason.
    """
    gaming, verdicts = gaming_of(results), []
    for protocol in results.plan.protocols:
        if protocol == TWO_STAGE:
            continue
        worst = worst_finding(gaming, protocol)
        own = [row for row in gaming if row.protocol == protocol]
        reason: str = worst
        if worst != "fine":
            reason += f" with {', '.join(row.driver for row in own if row.finding == worst)}"
        claim = f"{protocol}: crashes no more than {TWO_STAGE}, and crashing does not pay"
        parts = tuple(_crashes_no_more(results, row) for row in own)
        verdicts.append(Verdict(claim, parts, reason))
    return verdicts


def _crashes_no_more(results: TaskResults, row: Gaming) -> Part:
    """State that a driver crashes no more than the two-stage one, paired by seed."""
    rates = [
        np.array([_crash_rate(results.played[pair].sums[row.driver]) for pair in results.own(arm)])
        for arm in (row.protocol, TWO_STAGE)
        if arm in results.plan.protocols
    ]
    count = min(map(len, rates))
    more = UNKNOWN if len(rates) < 2 else statistics.mean(rates[0][:count] - rates[1][:count])
    what, most = f"{row.driver}: more crashes", criteria.MORE_CRASHES
    seeds = more.count
    return Part.mean(what, more, SEEDS, paired=True, below=most, seeds=seeds, form="+z.1%")


def _crash_rate(sums: Sums) -> float:
    return sums.crashes / sums.episodes if sums.episodes else math.nan
