r"""Caution: the inflation whose driver policy fits best what a person intended.

Each trip is played again, and a driver policy that is given the measured β, α and η says how likely
each a^H_t was for every inflation on a grid. Only steps in which the person looked at the road
count. A person is no such policy: with probability ε, which is fitted too, any of the five actions
is assumed instead,

.. math::
    \log L(\text{inflation}, \varepsilon) = \sum_{t: d_t = 0} \log ((1 - \varepsilon)
    \pi(a^H_t | o_t(\text{inflation})) + \varepsilon / 5)

so that what the policy never does is not infinitely unlikely. 1 - ε is the share of actions that
the policy explains. The model being wrong in detail, its likelihood alone would be too sure:
the interval is the wider one of that of the likelihood ratio, and of the 95 % of estimates from
trips drawn again with replacement (bootstrap).

Of inflations that fit alike the estimate is the one nearest to the average driver's: from trips in
which the policy explains nothing, or without a look at the road, nothing is known.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import DRIVERS, Driver
from hmi_marl.envs.worlds import VEHICLE_ACTIONS
from hmi_marl.exact.identify import StochasticPolicy, check_stochastic, replay_intents
from hmi_marl.people.record import TripRecord
from hmi_marl.reporting.statistics import CONFIDENCE, Estimate

GRID = np.arange(1.0, 12.01, 0.25)
"""Inflations that are tried; the policies that come with the package have learned 3 to 9."""
LAPSES = np.array([0.01, 0.02, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0])
"""Values of ε that are tried."""
FEWEST_TRIPS = 5
"""Trips that the interval takes at least: of fewer, drawing again says nothing."""
_DRAWS = 2000
_DROP = 1.92
_TIED = 1e-6
"""Difference of log likelihoods that counts as none."""


@dataclass(frozen=True)
class MeasuredInflation:
    """Caution of one person."""

    inflation: Estimate
    """Estimate and interval; the whole grid where the trips are too few."""
    explained: float
    """Share of actions that the policy explains, 1 - ε."""
    steps: int
    """Steps in which the person looked at the road."""
    grid: tuple[float, ...]
    """Inflations that were tried."""
    log_likelihood: tuple[float, ...]
    """Of all trips with each of them, with the best ε, less the highest."""


def measure_inflation(
    trips: Sequence[TripRecord],
    policy: StochasticPolicy,
    attention: tuple[float, float, float],
    grid: NDArray[np.float64] = GRID,
    seed: int = 0,
) -> MeasuredInflation:
    """Measure the caution of one person.

    Args:
        trips: of the person in the driver's seat, with looking away seen.
        policy: driver policy that gives probabilities, for the teams of these trips.
        attention: the person's β, α and η, which the policy may observe.
        grid: inflations to try, shape (M,), rising.
        seed: of the bootstrap.

    Raises:
        TypeError: a policy without probabilities.
        ValueError: trips of differing teams, or such as end otherwise when they are played again.
    """
    check_stochastic(policy)
    config = _config(trips)
    candidates = [Driver("candidate", *attention, float(inflation)) for inflation in grid]
    table, steps = _table(config, policy, candidates, trips)
    total = table.sum(axis=0)  # (M, number of LAPSES)
    profile = total.max(axis=1)
    tied = profile >= profile.max() - _TIED
    best = int(np.where(tied, abs(grid - DRIVERS["average"].inflation), np.inf).argmin())
    lapse = LAPSES[total[best] >= total[best].max() - _TIED].max()
    low, high = _interval(table, profile, grid, seed)
    return MeasuredInflation(
        Estimate(float(grid[best]), low, high),
        float(1.0 - lapse),
        steps,
        tuple(grid.tolist()),
        tuple((profile - profile.max()).tolist()),
    )


def _config(trips: Sequence[TripRecord]) -> TeamConfig:
    """Settings of all trips, which differ at most in the driver, whom no trip with a person has."""
    configs = [replace(trip.config, driver="average") for trip in trips]
    if any(config != configs[0] for config in configs):
        raise ValueError(
            "the trips have different settings of road or rewards; name recordings with the same"
        )
    return configs[0]


def _table(
    config: TeamConfig,
    policy: StochasticPolicy,
    candidates: Sequence[Driver],
    trips: Sequence[TripRecord],
) -> tuple[NDArray[np.float64], int]:
    """Log likelihood by trip, inflation and ε, shape (E, M, number of LAPSES), and the steps."""
    length = np.array([len(trip) for trip in trips])
    shape = len(trips), int(length.max())
    intents, alerts, away, applied = np.zeros((4, *shape), np.int64)
    for row, trip in enumerate(trips):
        steps = slice(0, len(trip))
        intents[row, steps], alerts[row, steps] = trip.intents, trip.alerts
        away[row, steps] = trip.looking_away or 0
    applied[:, 0] = intents[:, 0]
    for t in range(1, shape[1]):
        applied[:, t] = np.where(away[:, t] == 1, applied[:, t - 1], intents[:, t])
    seeds = np.array([trip.seed for trip in trips], np.uint64)
    attends = (away == 0) & (np.arange(shape[1]) < length[:, None])
    table = np.zeros((len(trips), len(candidates), len(LAPSES)))
    rows = np.arange(len(trips))
    replayed = replay_intents(config, policy, candidates, seeds, applied, alerts, length)
    for t, chances in enumerate(replayed):
        chosen = chances[:, rows, intents[:, t]].T[:, :, None]  # (E, M, 1)
        likely = (1.0 - LAPSES) * chosen + LAPSES / len(VEHICLE_ACTIONS)
        table += np.where(attends[:, t, None, None], np.log(likely), 0.0)
    return table, int(attends.sum())


def _interval(
    table: NDArray[np.float64], profile: NDArray[np.float64], grid: NDArray[np.float64], seed: int
) -> tuple[float, float]:
    """Ends of the interval; see the module."""
    if len(table) < FEWEST_TRIPS:
        return float(grid[0]), float(grid[-1])
    rng = np.random.default_rng(seed)
    weights = rng.multinomial(len(table), np.full(len(table), 1 / len(table)), _DRAWS)
    redrawn = np.tensordot(weights.astype(np.float64), table, axes=1).max(axis=2)
    tail = (1 - CONFIDENCE) / 2
    drawn = np.quantile(grid[redrawn.argmax(axis=1)], [tail, 1 - tail])
    likely = grid[profile >= profile.max() - _DROP]
    return float(min(drawn[0], likely[0])), float(max(drawn[1], likely[-1]))
