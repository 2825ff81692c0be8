"""Sums over the episodes of a pair of driver and HMI, and the metrics that follow from them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hmi_marl.envs.rewards import ATTENTION_TERMS, DRIVING_TERMS, TERMS
from hmi_marl.experiments.episodes import Episodes

_NEVER_NEGATIVE = ("crash_rate", "alerts_per_minute", "length", "time_headway")
_SHARES = ("crash_rate",)
ALL_DRIVERS = "all"
"""In place of a driver's name: all drivers of the population together."""


@dataclass(frozen=True)
class Sums:
    """Sums over some episodes."""

    episodes: int
    crashes: int
    steps: int
    minutes: float
    """Minutes of driving."""
    alerts: int
    time_headway: float
    """Mean over episodes of the median while a vehicle is ahead [s]; NaN if there was none."""
    terms: dict[str, float]
    """Sum of each reward term."""

    @classmethod
    def of(cls, episodes: Episodes, which: NDArray[np.bool_], frequency: float) -> Sums:
        """Sum up the marked episodes."""
        headways = episodes.median_time_headway[which]
        headways = headways[np.isfinite(headways)]
        steps = int(episodes.length[which].sum())
        return cls(
            episodes=int(which.sum()),
            crashes=int(episodes.crashed[which].sum()),
            steps=steps,
            minutes=steps / frequency / 60.0,
            alerts=int(episodes.alerts[which].sum()),
            time_headway=float(headways.mean()) if len(headways) else math.nan,
            terms={name: float(values[which].sum()) for name, values in episodes.returns.items()},
        )

    @classmethod
    def join(cls, several: Iterable[Sums]) -> Sums:
        """Join one or more sums into one."""
        parts = list(several)
        known = [p for p in parts if math.isfinite(p.time_headway)]
        headways, weights = [p.time_headway for p in known], [p.episodes for p in known]
        counts = ("episodes", "crashes", "steps", "minutes", "alerts")
        return cls(
            **{name: sum(getattr(part, name) for part in parts) for name in counts},
            time_headway=float(np.average(headways, weights=weights)) if known else math.nan,
            terms={name: sum(part.terms[name] for part in parts) for name in parts[0].terms},
        )

    def per_episode(self, names: Sequence[str] = TERMS) -> float:
        """Return the mean return of an episode, of these terms together."""
        return ratio(sum(self.terms[name] for name in names), self.episodes)

    def per_step(self, names: Sequence[str] = TERMS) -> float:
        """Return the mean reward of a step."""
        return ratio(sum(self.terms[name] for name in names), self.steps)

    def metrics(self) -> dict[str, float]:
        """Return every metric by name; NaN where there were no episodes."""
        return {
            "team_return": self.per_episode(),
            **{name: self.per_episode([name]) for name in TERMS},
            "attention_return": self.per_episode(ATTENTION_TERMS),
            "driving_return": self.per_episode(DRIVING_TERMS),
            "team_return_per_step": self.per_step(),
            "crash_rate": ratio(self.crashes, self.episodes),
            "alerts_per_minute": ratio(self.alerts, self.minutes),
            "length": ratio(self.steps, self.episodes),
            "time_headway": self.time_headway,
        }


def mean_metrics(by_driver: Iterable[Sums]) -> dict[str, float]:
    """Average every metric over drivers, each of which counts the same however often it was drawn.

    A driver that does not have a metric (no vehicle ahead, no headway) is left out of it; NaN where
    none has it.
    """
    each = [sums.metrics() for sums in by_driver]
    found = {name: np.array([metrics[name] for metrics in each]) for name in each[0]}
    known = {name: values[np.isfinite(values)] for name, values in found.items()}
    return {name: float(v.mean()) if len(v) else math.nan for name, v in known.items()}


def ends_of(metric: str) -> tuple[float, float]:
    """Return the ends at which the interval of a metric is cut off."""
    lowest = 0.0 if metric in _NEVER_NEGATIVE else -math.inf
    return lowest, 1.0 if metric in _SHARES else math.inf


def ratio(amount: float, count: float) -> float:
    """Divide a sum by a count; NaN without any."""
    return amount / count if count else math.nan
