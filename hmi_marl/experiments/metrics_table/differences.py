"""Differences between HMIs with the same drivers, paired by episode.

All cells of a table play the same episodes, so what they differ by is known far more exactly by the
differences of each episode than by two means with intervals of their own.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hmi_marl.experiments.episodes import Episodes
from hmi_marl.reporting import statistics
from hmi_marl.reporting.statistics import UNKNOWN, Estimate

OWN, AVERAGE, NONE = "own", "AvgHMI", "NoHMI"
"""Rows that are compared: every driver with the own HMI, with AvgHMI, and without."""
ALL = "all"
"""In place of a driver's name: mean over the drivers."""
PAIRS = ((OWN, AVERAGE), (OWN, NONE), (AVERAGE, NONE))
"""Rows that are compared with each other, one less the other."""
Played = Mapping[tuple[str, str], Episodes]
"""Episodes by HMI and driver; the own HMI has the driver's name."""
Values = NDArray[np.float64]

METRICS: Mapping[str, Callable[[Episodes], Values]] = {
    "distraction_return": lambda episodes: episodes.returns["distraction"],
    "speed_return": lambda episodes: episodes.returns["speed_reward"],
    "attention_return": Episodes.attention_return,
    "steps": lambda episodes: episodes.length.astype(np.float64),
    "speed_return_per_step": lambda episodes: _per_step(episodes.returns["speed_reward"], episodes),
}
"""Values of each episode, shape (E,), by metric."""


@dataclass(frozen=True)
class Differences:
    """Means of rows and of differences between rows, over episodes."""

    rows: Mapping[str, Mapping[str, Estimate]]
    """Means over the drivers, by row and metric."""
    between_rows: Mapping[str, Mapping[str, Mapping[str, Estimate]]]
    """One row less another, by "ROW - ROW", metric, and driver or :data:`ALL`."""
    between_drivers: Mapping[str, Mapping[str, Mapping[str, Estimate]]]
    """Distraction return of one driver less another's, by row, the one and the other."""
    extra_speed_lost: Mapping[str, Mapping[str, Estimate]]
    """Speed return that one driver loses by AvgHMI in place of the own HMI, less what another
    loses, by the one and the other."""
    spared: Mapping[str, Estimate]
    """Share of the distraction without an HMI that the own HMI spares, by driver."""
    average_share: Mapping[str, Estimate]
    """Share of what the own HMI gains over none that AvgHMI gains, by driver."""

    @classmethod
    def of(cls, played: Played, drivers: Sequence[str]) -> Differences:
        """Compare the rows of a table."""
        values = {
            (row, metric): {driver: of(_row(played, row, driver)) for driver in drivers}
            for row in (OWN, AVERAGE, NONE)
            for metric, of in METRICS.items()
        }
        distraction = {row: values[row, "distraction_return"] for row in (OWN, AVERAGE, NONE)}
        lost = _apart(values[OWN, "speed_return"], values[AVERAGE, "speed_return"])
        gained = _apart(distraction[OWN], distraction[NONE])
        by_average = _apart(distraction[AVERAGE], distraction[NONE])
        return cls(
            rows={
                row: {metric: _mean_over(values[row, metric]) for metric in METRICS}
                for row in (OWN, AVERAGE, NONE)
            },
            between_rows={
                f"{one} - {other}": {
                    metric: _by_driver(_apart(values[one, metric], values[other, metric]))
                    for metric in METRICS
                }
                for one, other in PAIRS
            },
            between_drivers={row: _between(distraction[row]) for row in distraction},
            extra_speed_lost=_between(lost),
            spared={
                driver: statistics.ratio(gained[driver], -distraction[NONE][driver])
                for driver in drivers
            },
            average_share={
                driver: statistics.ratio(by_average[driver], gained[driver])
                if gained[driver].mean() > 0.0
                else UNKNOWN
                for driver in drivers
            },
        )


def _row(played: Played, row: str, driver: str) -> Episodes:
    return played[driver if row == OWN else row, driver]


def _per_step(amounts: Values, episodes: Episodes) -> Values:
    """Values (E,) whose mean is the sum of amounts over the sum of steps, linearised."""
    ratio = amounts.sum() / episodes.length.sum()
    linear: Values = ratio + (amounts - ratio * episodes.length) / episodes.length.mean()
    return linear


def _apart(ones: Mapping[str, Values], others: Mapping[str, Values]) -> dict[str, Values]:
    return {driver: ones[driver] - others[driver] for driver in ones}


def _between(values: Mapping[str, Values]) -> dict[str, dict[str, Estimate]]:
    """Every driver less every other one, in the same episodes."""
    return {
        one: {
            other: statistics.mean(values[one] - values[other]) for other in values if other != one
        }
        for one in values
    }


def _by_driver(values: Mapping[str, Values]) -> dict[str, Estimate]:
    by_driver = {driver: statistics.mean(each) for driver, each in values.items()}
    return by_driver | {ALL: _mean_over(values)}


def _mean_over(values: Mapping[str, Values]) -> Estimate:
    """Mean over the drivers, each of whom plays the same episodes."""
    return statistics.mean(np.mean(list(values.values()), axis=0))
