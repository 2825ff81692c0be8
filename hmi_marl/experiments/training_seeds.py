"""Experiments that are repeated over training seeds, and results averaged over them.

All seeds play the same episodes. An average over seeds therefore has the interval of Student's t
over seeds, to which the luck of the episodes is added, since it is the same for all of them
(:func:`hmi_marl.reporting.statistics.mean_of_same`). It is known from many episodes, so that few
seeds that hardly differ are enough. With one seed the results are those of the
agents that were learned, with intervals over episodes.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cached_property
from typing import Any, Generic, Self, TypeVar, cast

from hmi_marl.envs.streams import part_seed
from hmi_marl.experiments.experiment import Experiment, Place
from hmi_marl.reporting import statistics
from hmi_marl.reporting.blocks import Block
from hmi_marl.reporting.report import Stopwatch
from hmi_marl.reporting.statistics import UNKNOWN, Estimate
from hmi_marl.reporting.verdicts import EPISODES, SEEDS, Part, Verdict
from hmi_marl.training.jobs import calls_with_bars

R = TypeVar("R")
T = TypeVar("T")
SEED_FOLDER = "seed-{}"
"""Folder of the second and each further seed, in that of the experiment; {} for its number."""


@dataclass(frozen=True)
class Repeated(Generic[R]):
    """Results of every training seed."""

    by_seed: tuple[R, ...]

    @cached_property
    def mean(self) -> R:
        """Results averaged over the seeds; see :func:`over_seeds`."""
        return over_seeds(self.by_seed)


class SeededExperiment(Experiment[Repeated[R]], Generic[R]):
    """An experiment of which everything is learned and played once for each training seed.

    A subclass is a frozen dataclass with the fields ``seed`` and ``seeds``. The first training is
    in the folder of the experiment, where agents for others to use are taken from.
    """

    @property
    @abstractmethod
    def seed(self) -> int:
        """Seed of the first training."""

    @property
    @abstractmethod
    def seeds(self) -> int:
        """Number of trainings."""

    @abstractmethod
    def learn(self, each: Sequence[tuple[Self, Place]], place: Place) -> None:
        """Learn what is not learned yet, for settings of one seed each and their places."""

    @abstractmethod
    def play(self, place: Place) -> R:
        """Play what one seed has learned in ``place``, and return its results."""

    @abstractmethod
    def numbers_of(self, results: R) -> Mapping[str, Any]:
        """JSON content of one seed's results, or of their average."""

    @abstractmethod
    def judge_of(self, results: R) -> Sequence[Verdict]:
        """Judge the average over the seeds."""

    @abstractmethod
    def blocks_of(self, results: R) -> Sequence[Block]:
        """Blocks of the report on the average over the seeds."""

    def by_seed(self, place: Place) -> list[tuple[Self, Place]]:
        """Settings of each seed alone, and where it learns."""
        if self.seeds == 1:
            return [(self, place)]
        found = [(replace(cast(Any, self), seeds=1), place)]
        for number in range(1, self.seeds):
            alone = replace(cast(Any, self), seed=int(part_seed(self.seed, number)), seeds=1)
            folder = place.folder / SEED_FOLDER.format(number)
            found.append((alone, replace(place, folder=folder)))
        return found

    def run(self, place: Place) -> Repeated[R]:
        """See :meth:`Experiment.run`."""
        each = self.by_seed(place)
        self.learn(each, place)
        return Repeated(tuple(self.play_each(each, place)))

    def play_each(self, each: Sequence[tuple[Self, Place]], place: Place) -> Sequence[R]:
        """Play what every seed has learned, several seeds at a time."""
        if min(place.workers, len(each)) == 1:
            return [alone.play(where) for alone, where in each]
        share = max(1, place.workers // len(each))
        tasks = [
            (alone, replace(where, workers=share, cluster=None, watch=Stopwatch()))
            for alone, where in each
        ]
        found = []
        for results, seconds in calls_with_bars(_play_alone, tasks, place.workers):
            place.watch.add(seconds)
            found.append(results)
        return found

    def numbers(self, results: Repeated[R]) -> dict[str, Any]:
        """JSON content: the average, and each seed where there are several."""
        found = dict(self.numbers_of(results.mean)) | {"training_seeds": len(results.by_seed)}
        if len(results.by_seed) > 1:
            found["by_seed"] = [self.numbers_of(each) for each in results.by_seed]
        return found

    def judge(self, results: Repeated[R]) -> Sequence[Verdict]:
        """See :meth:`Experiment.judge`."""
        return self.judge_of(results.mean)

    def blocks(self, results: Repeated[R]) -> Sequence[Block]:
        """See :meth:`Experiment.blocks`."""
        return self.blocks_of(results.mean)


def _play_alone(alone: SeededExperiment[R], place: Place) -> tuple[R, dict[str, float]]:
    """Play what one seed has learned; return the durations of its parts too."""
    return alone.play(place), place.watch.seconds


def learned_part(
    what: str,
    estimate: Estimate,
    seeds: int,
    unit: str = EPISODES,
    alone: Callable[..., Part] = Part.mean,
    **more: Any,
) -> Part:
    """State something of what was learned, with any number of seeds.

    Args:
        what: name of the quantity.
        estimate: over units, or, of several seeds, averaged by :func:`over_seeds`.
        seeds: number of training seeds; 0 if it depends on nothing learned.
        unit: what is repeated within a seed.
        alone: makes the part of one seed, such as :meth:`Part.share`; the interval of a mean of
            shares over seeds ends at 0 and 1.
        more: as :meth:`Part.mean` takes it.
    """
    if seeds > 1 and estimate.count == seeds:
        over_seeds = Part.mean_share if alone == Part.share else Part.mean
        return over_seeds(what, estimate, SEEDS, seeds=seeds, **more)
    return alone(what, estimate, unit, seeds=seeds, **more)


def over_seeds(results: Sequence[T]) -> T:
    """Average results of one shape over training seeds that play the same episodes.

    Estimates get their interval over seeds, other numbers their mean; None where one seed has None.
    An estimate that is the same in every seed stays as it is: its units are the only luck in it.
    What cannot be averaged, such as a name or a path, is that of the first seed. One seed's results
    stay as they are.

    Raises:
        ValueError: results of different shapes.
    """
    first = results[0]
    return first if len(results) == 1 else cast(T, _average(list(results)))


def _average(values: Sequence[Any]) -> Any:
    first = values[0]
    if any(value is None for value in values):
        return None
    if any(type(value) is not type(first) for value in values):
        raise ValueError(f"results of seeds differ in kind: {[type(v).__name__ for v in values]}")
    if isinstance(first, Estimate):
        return _average_estimates(values)
    if isinstance(first, Mapping):
        if any(list(value) != list(first) for value in values):
            raise ValueError("results of seeds differ in their names")
        return {name: _average([value[name] for value in values]) for name in first}
    if is_dataclass(first) and not isinstance(first, type):
        averaged = {
            field.name: _average([getattr(value, field.name) for value in values])
            for field in fields(first)
        }
        return replace(first, **averaged)
    if isinstance(first, (list, tuple)):
        if any(len(value) != len(first) for value in values):
            raise ValueError("results of seeds differ in their lengths")
        items = [_average(each) for each in zip(*values, strict=True)]
        if isinstance(first, list):
            return items
        return type(first)(*items) if hasattr(first, "_fields") else tuple(items)
    if isinstance(first, float):
        same = all(value == first for value in values)
        return first if same else math.fsum(values) / len(values)
    return first


def _average_estimates(values: Sequence[Estimate]) -> Estimate:
    if any(math.isnan(value.mean) for value in values):
        return UNKNOWN
    if all(value == values[0] for value in values) and values[0].error > 0.0:
        return values[0]
    shares = all(math.isnan(v.error) and v.count > 1 and math.isfinite(v.low) for v in values)
    return statistics.mean_share(values) if shares else statistics.mean_of_same(values)
