"""Results of a comparison, and the numbers of an arm: over its runs, and by driver."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hmi_marl.agents.learned.cards import is_saved
from hmi_marl.envs.config import AGENTS
from hmi_marl.experiments.episode_sums import ALL_DRIVERS, Sums, ends_of, mean_metrics
from hmi_marl.experiments.protocols.arms import SIMULTANEOUS, TWO_STAGE, Arm
from hmi_marl.experiments.protocols.pairs import Pair, own_pair
from hmi_marl.experiments.protocols.plan import ComparisonSettings
from hmi_marl.experiments.protocols.playing import Played
from hmi_marl.experiments.protocols.task_plan import Shares, TaskPlan
from hmi_marl.experiments.signalling import SITUATIONS
from hmi_marl.files import sha256_of
from hmi_marl.reporting import statistics
from hmi_marl.reporting.many_runs import (
    over_runs,
    paired_differences,
    probability_of_improvement,
    shared_error,
)
from hmi_marl.reporting.sources import pointer
from hmi_marl.reporting.statistics import UNKNOWN, Estimate
from hmi_marl.training.protocols.settings import TEAM, TrainSettings
from hmi_marl.training.runs.folder import read_curve


@dataclass(frozen=True)
class Training:
    """Costs of one run."""

    steps: int
    """Environment steps."""
    gradient_steps: int
    """Steps of an optimiser, of all that learn."""
    seconds: float
    """Wall time of training, interruptions left out."""
    weights: Mapping[str, str] = field(default_factory=dict)
    """SHA-256 of the weights that it learned, by seat."""

    @classmethod
    def of(cls, settings: TrainSettings, folder: Path) -> Training:
        """Read it from the folder of a finished run."""
        last = read_curve(folder)[-1]
        cards = {seat: folder / f"{seat}.json" for seat in AGENTS}
        weights = {
            seat: sha256_of(card.with_suffix(".safetensors"))
            for seat, card in cards.items()
            if is_saved(card)
        }
        steps, seconds = int(last["steps"]), float(last["seconds"])
        return cls(steps, gradient_steps(settings), seconds, weights)


def gradient_steps(settings: TrainSettings) -> int:
    """Count the gradient steps of a run: those of both learners where two learn at once."""
    each = settings.ppo.num_learning_epochs * settings.ppo.num_mini_batches
    return sum(
        phase.iterations(settings.num_teams)
        * each
        * (2 if phase.seat == TEAM and not phase.joint else 1)
        for phase in settings.phases()
    )


@dataclass(frozen=True)
class TaskResults:
    """Results of one task."""

    plan: TaskPlan
    played: Mapping[Pair, Played]
    training: Mapping[str, Training]
    """By the run's name."""
    curves: Mapping[str, Sequence[tuple[int, Mapping[str, float]]]] = field(default_factory=dict)
    """Environment steps and metrics of the snapshots of each run, by its name; every driver counts
    the same."""
    average_hmi: Mapping[str, Pair] = field(default_factory=dict)
    """Pairs of a two-stage run's driver, by its name, with the HMI for the average driver."""
    folder: Path | None = None
    """Folder of the comparison, with the runs' policies, for clips; None for none."""

    def place(self, *keys: str | int) -> str:
        """JSON pointer of the task's content, or of a part of it."""
        return pointer("tasks", self.plan.name, *keys)

    def own(self, arm: str) -> list[Pair]:
        """Pairs of the driver and the HMI of each run of an arm."""
        return [own_pair(run) for run in self.plan.runs_of(arm)]

    def whole_arms(self) -> list[Arm]:
        """Arms that fill both seats."""
        return [arm for arm in self.plan.arms.values() if arm.whole]

    def main_arms(self) -> list[Arm]:
        """Arms that fill both seats, with the largest budget; see the table of budgets."""
        return [arm for arm in self.whole_arms() if arm.steps == self.plan.steps]

    def over_runs(self, pairs: Sequence[Pair], metric: str, shared: bool = False) -> Estimate:
        """Average a metric over runs, with Student's t interval; see :meth:`values`."""
        return statistics.mean(self.values(pairs, metric, shared), *ends_of(metric))

    def values(
        self, pairs: Sequence[Pair], metric: str, shared: bool = False
    ) -> NDArray[np.float64]:
        """Values of a metric, averages over drivers, shape (pairs,).

        Every driver counts the same, however many episodes were drawn for it. With ``shared`` they
        are those of the episodes that all pairs play, so that any pairs can be compared.
        """
        names = self.plan.settings.driver_names
        rows = []
        for pair in pairs:
            played = self.played[pair]
            sums = played.shared if shared else played.sums
            rows.append(mean_metrics(sums[name] for name in names)[metric])
        return np.array(rows)

    def by_driver(
        self,
        pairs: Sequence[Pair],
        value: Callable[[Played, str], float],
        names: Sequence[str] | None = None,
    ) -> NDArray[np.float64]:
        """Values of pairs by driver, shape (pairs, drivers); of all drivers unless named."""
        listed = self.plan.settings.driver_names if names is None else names
        return np.array(
            [[value(self.played[pair], name) for name in listed] for pair in pairs]
        ).reshape(len(pairs), len(listed))

    @cached_property
    def scored_drivers(self) -> tuple[str, ...]:
        """Drivers that have a score: those to whom alerts can gain anything, in every pair."""
        return tuple(
            name
            for name in self.plan.settings.driver_names
            if all(math.isfinite(score(played, name)) for played in self.played.values())
        )

    def scores(self, pairs: Sequence[Pair]) -> NDArray[np.float64]:
        """Normalised scores of pairs, shape (pairs, scored drivers).

        Attention returns, 0 without alerts and 1 for the optimum that sees attention, both exact
        and over episodes of the same lengths.
        """
        return self.by_driver(pairs, score, self.scored_drivers)

    def score(self, pairs: Sequence[Pair]) -> Estimate:
        """Interquartile mean of the normalised scores, with its bootstrap interval over runs.

        The luck of the episodes, which all runs share, is added; see :meth:`luck_of_scores`.
        Unknown if no driver has a score.
        """
        if not self.scored_drivers:
            return UNKNOWN
        scores, (errors, episodes) = self.scores(pairs), self.luck_of_scores(pairs)
        return statistics.widened(over_runs(scores), shared_error(scores, errors), episodes)

    def luck_of_scores(self, pairs: Sequence[Pair]) -> tuple[NDArray[np.float64], int]:
        """Standard errors of a pair's scores over its episodes, shape (scored drivers,).

        The references are exact and the episodes are the same for all runs, so their luck does not
        average out over runs. The second is the number of episodes of the driver with the fewest.
        """
        of_driver = [
            statistics.shared_luck([self.played[pair].scores[name].score for pair in pairs])
            for name in self.scored_drivers
        ]
        errors, episodes = zip(*of_driver, strict=True)
        return np.array(errors), min(episodes)

    def mean_of(
        self,
        pairs: Sequence[Pair],
        value: Callable[[Played, str], float],
    ) -> Estimate:
        """Average a value over drivers, and over runs with Student's t interval."""
        ends = _ENDS.get(value, (-math.inf, math.inf))
        return statistics.mean(self.by_driver(pairs, value).mean(axis=1), *ends)

    def against_exact(
        self, pairs: Sequence[Pair], value: Callable[[Played, str], Estimate]
    ) -> Estimate:
        """Average a difference from an exact value over drivers and runs.

        All runs play the same episodes, whose luck does not average out over runs; see
        :func:`~hmi_marl.reporting.statistics.mean_of_same`.
        """
        names = self.plan.settings.driver_names
        return statistics.mean_of_same(
            [statistics.average([value(self.played[p], name) for name in names]) for p in pairs]
        )

    def pooled(self, pairs: Sequence[Pair], driver: str = ALL_DRIVERS) -> Sums:
        """Join the episodes of several pairs."""
        return Sums.join(self.played[pair].sums[driver] for pair in pairs)

    def crash_rate(self, pairs: Sequence[Pair], driver: str = ALL_DRIVERS) -> Estimate:
        """Share of the pairs' episodes that crash, with Wilson's interval; NaN without any."""
        return crash_rate(self.pooled(pairs, driver))

    def improvements(self) -> dict[str, Estimate]:
        """Probability that a run scores more than one of two-stage, by protocol.

        None without two-stage, or if no driver has a score.
        """
        own = self.plan.protocols
        if TWO_STAGE not in own or not self.scored_drivers:
            return {}
        theirs = self.scores(self.own(TWO_STAGE))
        return {
            name: probability_of_improvement(self.scores(self.own(name)), theirs)
            for name in own
            if name != TWO_STAGE
        }

    def revealing_by_situation(self, arm: str) -> dict[str, dict[str, float | None]]:
        """Share of the steps that reveal d, of all runs and drivers, by group and situation.

        None for a situation that never was.
        """
        measured = [each for pair in self.own(arm) for each in self.played[pair].signals.values()]
        shares: dict[str, dict[str, float | None]] = {}
        for group, labels in SITUATIONS.items():
            shares[group] = {}
            for label in labels:
                found = [each.by_situation[group][label] for each in measured]
                steps = sum(int(signals.steps.sum()) for signals in found)
                shown = sum(int(signals.revealing.sum()) for signals in found)
                shares[group][label] = shown / steps if steps else None
        return shares

    def cost(self, arm: str) -> Training:
        """Costs of the first run of an arm; those of the others differ in their seconds alone."""
        return self.training[self.plan.runs_of(arm)[0].name]

    def seconds(self, arm: str) -> Estimate:
        """Wall time of an arm's runs [s]."""
        spent = [self.training[run.name].seconds for run in self.plan.runs_of(arm)]
        return statistics.mean(spent, lowest=0.0)


@dataclass(frozen=True)
class Comparison:
    """Results of a comparison."""

    settings: ComparisonSettings
    tasks: Mapping[str, TaskResults]
    shares: Mapping[str, Shares] = field(default_factory=dict)
    """Shares of the driver's stage that were chosen, by task and protocol."""
    tried: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Team returns of the runs that tried shares out, by task and arm."""
    workers: int = 1
    """Runs that were trained side by side."""


def attention(played: Played, driver: str) -> float:
    """Attention return per episode of one driver."""
    return played.sums[driver].metrics()["attention_return"]


def driving(played: Played, driver: str) -> float:
    """Driving return per episode of one driver."""
    return played.sums[driver].metrics()["driving_return"]


def score(played: Played, driver: str) -> float:
    """Normalised attention return of one driver; see :meth:`TaskResults.scores`."""
    return played.scores[driver].score.mean


def optimum(played: Played, driver: str) -> float:
    """Exact optimum that sees attention, over episodes as long as those that were played."""
    return played.scores[driver].references.optimum


def attainable(played: Played, driver: str) -> float:
    """Exact return of the best there is for this driver, over as many steps.

    With attention hidden that is the Bayes filter that knows the traits and how often a^H reveals
    d; with attention seen, or where there is no such filter, the optimum.
    """
    known = played.scores[driver].references
    return known.optimum if known.filter is None else known.filter


def hiding(played: Played, driver: str) -> float:
    """What it costs that attention is hidden: optimum that sees it minus Bayes filter."""
    return optimum(played, driver) - attainable(played, driver)


def regret(played: Played, driver: str) -> Estimate:
    """Optimum that sees attention minus what the HMI earns, with its interval over episodes."""
    return played.scores[driver].regret


def shortfall(played: Played, driver: str) -> Estimate:
    """The HMI's own part of the regret: the best there is for this driver minus what it earns."""
    own = played.scores[driver].shortfall
    return regret(played, driver) if own is None else own


def revealing(played: Played, driver: str) -> float:
    """Share of steps in which a^H reveals d."""
    return played.signals[driver].total.share


def bits(played: Played, driver: str) -> float:
    """Information about d in each step [bits]."""
    return played.signals[driver].bits.mean


def divergence(played: Played, driver: str) -> float:
    """Divergence of the driver from the natural one [nats per step]."""
    return played.divergence.get(driver, math.nan)


_ENDS: Mapping[Callable[[Played, str], float], tuple[float, float]] = {
    hiding: (0.0, math.inf),
    revealing: (0.0, 1.0),
    bits: (0.0, 1.0),
    divergence: (0.0, math.inf),
}
"""Ends at which the intervals of these values are cut off; the others have none."""


def signalling_arms(results: TaskResults) -> list[str]:
    """Arms whose signals are shown by situation and in clips, with attention hidden."""
    shown = (TWO_STAGE, SIMULTANEOUS) if results.plan.task.hidden else ()
    return [name for name in shown if name in results.plan.protocols]


def crash_rate(sums: Sums) -> Estimate:
    """Return the share of episodes that crash, with Wilson's interval; NaN without episodes."""
    return statistics.share(sums.crashes, sums.episodes) if sums.episodes else UNKNOWN


def given_up(results: TaskResults, arm: str) -> Estimate:
    """Driving return that the driver gives up against the two-stage driver, paired by seed."""
    theirs, ours = (
        results.by_driver(results.own(name), driving).mean(axis=1) for name in (TWO_STAGE, arm)
    )
    (change,) = paired_differences([(theirs, ours)])
    return change.estimate
