"""Number of raters that a study needs, by simulated raters; always marked as simulated.

For each number of raters, whole studies are simulated with the planted differences and judged as
the real one is: all contrasts together, by the same rule. The power of a contrast is the share of
studies in which it is supported.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hmi_marl.people.study.analyse import fit_all, judge
from hmi_marl.people.study.settings import RATINGS, Plan, PowerSettings, StudySettings
from hmi_marl.people.study.simulated import (
    planted_means,
    shown_to,
    simulate,
    true_difference,
)
from hmi_marl.reporting.statistics import Estimate, share
from hmi_marl.reporting.verdicts import Outcome


@dataclass(frozen=True)
class SimulatedStudies:
    """Outcomes of S simulated studies, with D contrasts."""

    raters: int
    """Careful raters, who pass the attention check."""
    found: NDArray[np.float64]
    """Estimated differences [points], shape (S, D)."""
    covered: NDArray[np.bool_]
    """Whether the 95 % interval holds the true difference, shape (S, D)."""
    outcomes: NDArray[np.str_]
    """Outcome of each contrast, as words, shape (S, D)."""
    truth: NDArray[np.float64]
    """True differences [points], shape (D,)."""

    def supported(self, contrast: int) -> Estimate:
        """Share of studies in which a contrast is supported."""
        return share(int((self.outcomes[:, contrast] == Outcome.SUPPORTED).sum()), len(self.found))


def simulate_studies(
    settings: StudySettings,
    plan: Plan,
    raters: int,
    studies: int,
    seed: int = 0,
    margin: float = 0.0,
    progress: Callable[[range], Any] = iter,
) -> SimulatedStudies:
    """Simulate studies and analyse each.

    Args:
        settings: of the study.
        plan: what is planted; its share of careless raters is left out of the analysis.
        raters: who take part, the careless ones included.
        studies: S.
        seed: of all draws; each study has its own.
        margin: differences up to this size count as none [points].
        progress: receives the studies' numbers and passes them on.

    Raises:
        ValueError: too few raters or clips, or contrasts that contradict each other.
    """
    careful = round(raters * (1.0 - plan.careless))
    names = [each.name for each in settings.conditions]
    contrasts = settings.intended
    means, shown = planted_means(settings, plan), shown_to(careful, settings)
    used = [rating for rating in RATINGS if any(each.rating == rating for each in contrasts)]
    condition = np.repeat(np.arange(len(names)), settings.clips)
    rater = np.repeat(np.arange(careful), shown.clip.shape[1])
    truth = np.array([true_difference(each, settings, plan, means) for each in contrasts])
    found = np.zeros((studies, len(contrasts)))
    covered = np.zeros(found.shape, np.bool_)
    outcomes = np.empty(found.shape, "U16")
    for study in progress(range(studies)):
        rng = np.random.default_rng([seed, raters, study])
        values = simulate(shown, means, plan, settings.clips, rng).reshape(-1, len(RATINGS))
        fits = fit_all(rater, shown.clip.reshape(-1), values, condition, used)
        for place, verdict in enumerate(judge(contrasts, names, fits, margin)):
            part = verdict.parts[0]
            low, high = part.interval()
            found[study, place] = part.value
            covered[study, place] = low <= truth[place] <= high
            outcomes[study, place] = verdict.outcome
    return SimulatedStudies(careful, found, covered, outcomes, truth)


@dataclass(frozen=True)
class Power:
    """Power by number of raters, and how many raters the wanted one needs."""

    settings: PowerSettings
    contrasts: tuple[str, ...]
    truth: NDArray[np.float64]
    """Planted differences after rounding [points], shape (D,)."""
    shares: tuple[tuple[Estimate, ...], ...]
    """Power of each contrast for each number of raters, as [raters][contrast]."""
    every: tuple[Estimate, ...]
    """Share of studies in which all contrasts are supported, for each number of raters."""

    def needed(self, contrast: int | None) -> Needed:
        """Return how many raters a contrast needs, or with None all of them at once."""
        series = self.every if contrast is None else [each[contrast] for each in self.shares]
        return needed_raters(self.settings.raters, series, self.settings.power)

    def as_json(self) -> dict[str, Any]:
        """JSON content."""
        return {
            "simulated": True,
            "raters": list(self.settings.raters),
            "contrasts": [
                {
                    "name": name,
                    "difference": float(self.truth[place]),
                    "power": [each[place].as_json() for each in self.shares],
                    "needed": self.needed(place).as_json(),
                }
                for place, name in enumerate(self.contrasts)
            ],
            "all": {
                "power": [each.as_json() for each in self.every],
                "needed": self.needed(None).as_json(),
            },
        }


@dataclass(frozen=True)
class Needed:
    """Number of raters for a wanted power; None where no number tried is enough."""

    raters: float | None
    low: float | None
    """Where the upper end of the power's interval reaches the wanted one."""
    high: float | None
    """Where the lower end does."""

    def shown(self, most: int) -> str:
        """Write it, given the largest number that was tried."""
        middle, low, high = (
            f"> {most}" if value is None else str(value) for value in self.as_json().values()
        )
        return f"{middle} [{low}, {high}]"

    def as_json(self) -> dict[str, int | None]:
        """JSON content, whole raters."""
        return {
            name: None if value is None else math.ceil(value) for name, value in vars(self).items()
        }


def needed_raters(raters: Sequence[int], series: Sequence[Estimate], power: float) -> Needed:
    """Return the number of raters from which on the power is as wanted, with its interval.

    Between the numbers that were tried, power is taken as linear; it is made not to fall.
    """
    ends = [[each.mean for each in series], [each.high for each in series]]
    ends.append([each.low for each in series])
    middle, low, high = (_crossing(raters, values, power) for values in ends)
    return Needed(middle, low, high)


def _crossing(raters: Sequence[int], values: Sequence[float], wanted: float) -> float | None:
    rising = np.maximum.accumulate(values)
    if rising[-1] < wanted:
        return None
    after = int(np.argmax(rising >= wanted))
    if after == 0:
        return float(raters[0])
    below, above = rising[after - 1], rising[after]
    part = (wanted - below) / (above - below)
    return float(raters[after - 1] + part * (raters[after] - raters[after - 1]))


def find_power(
    study: StudySettings,
    settings: PowerSettings,
    progress: Callable[[int, range], Any] = lambda raters, studies: iter(studies),
) -> Power:
    """Simulate studies with each number of raters.

    Args:
        study: its conditions, clips, orders and contrasts.
        settings: of the search.
        progress: receives a number of raters and the studies' numbers, and passes these on.

    Raises:
        ValueError: too few raters or clips, or contrasts that contradict each other.
    """
    shares, every = [], []
    truth = np.zeros(len(study.intended))
    for raters in settings.raters:
        found = simulate_studies(
            study,
            settings.plan,
            raters,
            settings.studies,
            settings.seed,
            settings.margin,
            partial(progress, raters),
        )
        truth = found.truth
        shares.append(tuple(found.supported(place) for place in range(len(study.intended))))
        whole = (found.outcomes == Outcome.SUPPORTED).all(axis=1)
        every.append(share(int(whole.sum()), len(whole)))
    names = tuple(each.name for each in study.intended)
    return Power(settings, names, truth, tuple(shares), tuple(every))
