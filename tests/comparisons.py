"""Comparisons of protocols with results that are made up, for tests of what is said of them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from hmi_marl.envs.rewards import TERMS
from hmi_marl.experiments.episode_sums import ALL_DRIVERS, Sums
from hmi_marl.experiments.protocols.arms import TWO_STAGE
from hmi_marl.experiments.protocols.experiment import ProtocolComparison
from hmi_marl.experiments.protocols.pairs import Pair, all_pairs
from hmi_marl.experiments.protocols.playing import Played
from hmi_marl.experiments.protocols.results import Comparison, TaskResults, Training
from hmi_marl.experiments.references import PairScore, References
from hmi_marl.experiments.signalling import SITUATIONS, Signalling, Signals
from hmi_marl.reporting.statistics import Estimate

SMALL = ProtocolComparison(
    tasks=("hidden",),
    protocols=("two-stage", "joint", "simultaneous"),
    seeds=3,
    few_seeds=2,
    budgets=(),
    driver_shares=(0.5,),
    anchor_kls=(0.1, 1.0),
    partners=False,
    snapshots=2,
    drivers=("bart", "homer"),
    num_teams=16,
)
NONE, FILTER, OPTIMUM = -400.0, 600.0, 800.0
"""Exact returns that every driver has."""
SEEN = replace(SMALL, tasks=("seen",), protocols=("two-stage", "simultaneous"))
OWN = {"two-stage": 600.0, "joint": 700.0, "simultaneous": 780.0}


def sums(
    attention: float = 0.0, driving: float = 400.0, episodes: int = 100, crashes: int = 0
) -> Sums:
    """Returns per episode of 100 steps."""
    terms = dict.fromkeys(TERMS, 0.0)
    terms |= {"distraction": attention * episodes, "speed_reward": driving * episodes}
    return Sums(episodes, crashes, 100 * episodes, episodes / 3, 20 * episodes, math.nan, terms)


def signals(name: str, share: float) -> Signalling:
    """Signals of a driver that reveals d in this share of 100 steps, a bit each time."""
    steps, shown = np.array([100]), np.array([round(100 * share)])
    some = Signals(steps, shown, np.array([100.0]), shown.astype(float), 100.0 - shown)
    every = {group: dict.fromkeys(labels, some) for group, labels in SITUATIONS.items()}
    return Signalling(name, some, every)


def scored(name: str, of: Sums, share: float) -> PairScore:
    """Score of a driver's episodes between the references that all drivers have."""
    earned = of.metrics()["attention_return"]
    gain = (earned - NONE) / (OPTIMUM - NONE)
    references = References(NONE, FILTER, OPTIMUM)
    regret, short = exactly(OPTIMUM - earned), exactly(FILTER - earned)
    found = exactly(earned), references, exactly(gain), regret
    return PairScore(name, share, *found, OPTIMUM - FILTER, short, None)


def exactly(value: float) -> Estimate:
    return Estimate(value, value, value, 0.0, 100)


def played(of: Sums, names: tuple[str, ...], share: float = 0.5, apart: float = 0.1) -> Played:
    """The same for every driver."""
    return Played(
        dict.fromkeys((ALL_DRIVERS, *names), of),
        dict.fromkeys(names, of),
        {name: scored(name, of, share) for name in names},
        {name: signals(name, share) for name in names},
        dict.fromkeys(names, apart),
    )


def comparison(
    settings: ProtocolComparison = SMALL,
    attention: Callable[[Pair], float] = lambda pair: 500.0,
    **more: Callable[[Pair], Any],
) -> Comparison:
    """Every pair played as functions of it say: attention, driving, crashes, share, apart."""
    return Comparison(
        settings,
        {plan.name: task(settings, plan.name, attention, more) for plan in settings.plans()},
    )


def task(
    settings: ProtocolComparison,
    name: str,
    attention: Callable[[Pair], float],
    more: Mapping[str, Callable[[Pair], Any]],
) -> TaskResults:
    (plan,) = (plan for plan in settings.plans() if plan.name == name)
    rivals = {}
    if plan.task.hidden and TWO_STAGE in plan.protocols:
        rivals = {r.name: Pair(name, r.name, "belief:average:0.5") for r in plan.runs_of(TWO_STAGE)}
    of_sums, of_played = ("driving", "crashes"), ("share", "apart")
    results = {
        pair: played(
            sums(attention(pair), **{k: more[k](pair) for k in of_sums if k in more}),
            settings.driver_names,
            **{k: more[k](pair) for k in of_played if k in more},
        )
        for pair in (*all_pairs(plan), *rivals.values())
    }
    training = {run.name: Training(8000, 120, 60.0 + run.number) for run in plan.runs}
    curves = {
        run.name: [
            (steps, sums(earned + run.number).metrics())
            for steps, earned in ((4000, 100.0), (8000, 500.0))
        ]
        for arm in plan.protocols
        for run in plan.runs_of(arm)
    }
    return TaskResults(plan, results, training, curves, rivals)


def arm_of(name: str) -> str:
    """Arm of a run's name."""
    return name.partition("/")[2].rpartition("-run")[0]


def number_of(name: str) -> int:
    """Number of a run's name; 0 of other policies."""
    number = name.rpartition("-run")[2].removesuffix("-standing")
    return int(number) if number.isdigit() else 0


def without(comparison: Comparison, driver: str) -> Comparison:
    """The same, where one driver never came."""
    tasks = {}
    for name, results in comparison.tasks.items():
        emptied = {
            pair: replace(each, sums={**each.sums, driver: sums(episodes=0)})
            for pair, each in results.played.items()
        }
        tasks[name] = replace(results, played=emptied)
    return replace(comparison, tasks=tasks)


def signalling(pair: Pair) -> float:
    """Attention return as the trial had it: pairs that learned together understand each other."""
    driver, hmi = arm_of(pair.driver), arm_of(pair.hmi)
    together = {"joint", "simultaneous"}
    if pair.hmi.startswith("belief:average"):
        return 536.0 + number_of(pair.driver)
    if driver in together and hmi in together:
        return 780.0 + number_of(pair.driver)
    if driver == "two-stage" and hmi in together:
        return 430.0 + number_of(pair.driver)
    if "anchored" in driver or "anchored" in hmi:
        return {"anchored-0.1": 760.0, "anchored-1": 602.0}[driver if "anch" in driver else hmi]
    return 600.0 + number_of(pair.driver)


def hidden(**more):
    return comparison(SMALL, signalling, **more)
