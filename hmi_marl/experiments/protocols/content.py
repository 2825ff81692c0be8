"""JSON content of a comparison, from which all of its tables can be made again."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from hmi_marl.experiments.episode_sums import ALL_DRIVERS, Sums
from hmi_marl.experiments.protocols.arms import TWO_STAGE
from hmi_marl.experiments.protocols.costs import costs_of
from hmi_marl.experiments.protocols.cross_play import cross_play, dependence_of
from hmi_marl.experiments.protocols.driving_costs import driving_costs
from hmi_marl.experiments.protocols.equal_gradients import at_equal_gradients
from hmi_marl.experiments.protocols.findings import differences, sweep
from hmi_marl.experiments.protocols.gaming import gaming_of, worst_finding
from hmi_marl.experiments.protocols.pairs import Pair, baselines
from hmi_marl.experiments.protocols.playing import Played
from hmi_marl.experiments.protocols.results import (
    Comparison,
    TaskResults,
    attention,
    bits,
    divergence,
    given_up,
    hiding,
    optimum,
    revealing,
    shortfall,
    signalling_arms,
)
from hmi_marl.experiments.protocols.same_reward import with_same_reward
from hmi_marl.experiments.protocols.signal_clip import clips_of
from hmi_marl.files import json_value


def content_of(comparison: Comparison) -> dict[str, Any]:
    """All results by task, and the comparisons between protocols."""
    return {
        "workers": comparison.workers,
        "differences": json_value(differences(comparison)),
        "differences_with_the_same_reward": json_value(with_same_reward(comparison)),
        "differences_at_equal_gradient_steps": json_value(at_equal_gradients(comparison)),
        "driver_shares": json_value(comparison.shares),
        "driver_shares_tried": json_value(comparison.tried),
        "tasks": {name: _task(results) for name, results in comparison.tasks.items()},
    }


def _task(results: TaskResults) -> dict[str, Any]:
    gaming = gaming_of(results) if results.plan.standing_runs else []
    protocols = results.plan.protocols
    return {
        "scored_drivers": list(results.scored_drivers),
        "arms": {arm.name: _arm(results, arm.name) for arm in results.whole_arms()},
        "baselines": {
            label: _earned(results, pairs) for label, pairs in baselines(results.plan).items()
        },
        "probability_of_improvement": json_value(results.improvements()),
        "revealing_by_situation": {
            arm: results.revealing_by_situation(arm) for arm in signalling_arms(results)
        },
        "driving_costs": json_value({cost.arm: cost for cost in driving_costs(results)}),
        "clips": clips_of(results),
        "costs": json_value({cost.arm: cost for cost in costs_of(results)}),
        "sweep": json_value(sweep(results)),
        "cross_play": json_value(cross_play(results)),
        "dependence": json_value(dependence_of(results)),
        "gaming": json_value(gaming),
        "findings": {name: worst_finding(gaming, name) for name in protocols if gaming},
        "average_hmi": json_value(
            results.over_runs(list(results.average_hmi.values()), "attention_return")
        ),
        "training": {
            name: {
                "steps": training.steps,
                "gradient_steps": training.gradient_steps,
                "seconds": training.seconds,
                "weights": dict(training.weights),
            }
            for name, training in results.training.items()
        },
        "curves": {
            name: [{"steps": steps} | json_value(metrics) for steps, metrics in points]
            for name, points in results.curves.items()
        },
        "pairs": [_pair(pair, played) for pair, played in results.played.items()],
    }


def _arm(results: TaskResults, arm: str) -> dict[str, Any]:
    pairs = results.own(arm)
    values = {"attention_return": attention, "optimum": optimum}
    if results.plan.task.hidden:
        values["cost_of_hiding"] = hiding
    values |= {"revealing": revealing, "bits": bits, "divergence": divergence}
    content = {
        **_earned(results, pairs),
        "scores_by_run_and_driver": results.scores(pairs).tolist(),
        "mean_over_drivers": {
            name: results.mean_of(pairs, value).as_json() for name, value in values.items()
        },
        "hmi_shortfall": results.against_exact(pairs, shortfall).as_json(),
    }
    if results.plan.task.hidden:
        by_driver = results.by_driver(pairs, revealing).mean(axis=0).tolist()
        names = results.plan.settings.driver_names
        content["revealing_by_driver"] = dict(zip(names, by_driver, strict=True))
    if TWO_STAGE in results.plan.protocols:
        content["given_up_in_driving"] = given_up(results, arm).as_json()
    return content


def _earned(results: TaskResults, pairs: Sequence[Pair]) -> dict[str, Any]:
    metrics = results.played[pairs[0]].sums[ALL_DRIVERS].metrics()
    return {
        "runs": len(pairs),
        "score": results.score(pairs).as_json(),
        "over_runs": {name: results.over_runs(pairs, name).as_json() for name in metrics},
        "crash_rate_pooled": json_value(results.crash_rate(pairs)),
    }


def _pair(pair: Pair, played: Played) -> dict[str, Any]:
    content: dict[str, Any] = {
        "driver": pair.driver,
        "hmi": pair.hmi,
        "end_at_crash": pair.end_at_crash,
        "by_driver": {name: _sums(sums) for name, sums in played.sums.items()},
        "scores": {
            name: {"score": json_value(each.score.mean), **json_value(each.references)}
            for name, each in played.scores.items()
        },
    }
    if played.signals:
        content["signals"] = {
            name: {"revealing": signal.total.share, "bits": signal.bits.mean}
            for name, signal in played.signals.items()
        }
    if played.divergence:
        content["divergence"] = json_value(played.divergence)
    return content


def _sums(sums: Sums) -> dict[str, Any]:
    """Sums over the episodes, from which every metric follows."""
    return dict(json_value(sums))
