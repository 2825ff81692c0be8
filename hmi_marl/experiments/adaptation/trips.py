r"""Trips in a row with the same drivers: what an HMI earns as it gets to know them.

With R_k, R_a and R_h the rewards of the HMI that knows the driver, of AvgHMI and of another HMI,
from the same driver on the same roads, HMI h closes the share

.. math:: 1 - \frac{E[R_k - R_h]}{E[R_k - R_a]}

of the gap. Intervals of ratios are bootstrapped over drivers, all HMIs together.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from hmi_marl.agents.adaptive.hmis import AdaptiveHMI
from hmi_marl.agents.rollout import HandsOver, Observer, play
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import FixedDrivers, Traits
from hmi_marl.envs.rewards import ATTENTION_TERMS
from hmi_marl.envs.seats import Policy
from hmi_marl.envs.step_result import StepResult
from hmi_marl.envs.teaming import Teaming
from hmi_marl.reporting import statistics
from hmi_marl.reporting.statistics import CONFIDENCE, UNKNOWN, Estimate

DRAWS = 2000
"""Resamples of a bootstrap."""


@dataclass(frozen=True, eq=False)
class HandOver:
    """Unannounced change of drivers."""

    trip: int
    """Trip of the change, from 0."""
    step: int
    """Step of that trip before which the drivers change, from 0."""
    traits: Traits
    """Traits of the new drivers."""


@dataclass(frozen=True, eq=False)
class Trips:
    """Rewards of E drivers' trips with one HMI. J trips of T steps."""

    rewards: NDArray[np.float64]
    """Attention reward of each step, shape (E, J, T); 0 after a crash."""
    driving: NDArray[np.bool_]
    """Whether the trip was still going on, shape (E, J, T)."""
    probabilities: NDArray[np.float64] | None = None
    """Belief of an adaptive HMI in each turn, shape (E, J, T, K), if that was kept."""

    @property
    def returns(self) -> NDArray[np.float64]:
        """Attention return of each trip, shape (E, J)."""
        return self.rewards.sum(axis=2)


class _Recorder(Observer):
    """Keep the reward and an adaptive HMI's belief in each step of each trip."""

    def __init__(self, shape: tuple[int, int, int], adaptive: AdaptiveHMI | None) -> None:
        self.rewards, self.driving = np.zeros(shape), np.zeros(shape, np.bool_)
        self.probabilities: NDArray[np.float64] | None = None
        self._adaptive = adaptive
        self.trip = self._step = 0

    def next_trip(self, trip: int) -> None:
        """Begin this trip, from 0."""
        self.trip, self._step = trip, 0

    def before(self, teaming: Teaming) -> None:
        """Note which teams are still driving."""
        self.driving[:, self.trip, self._step] = ~teaming.over

    def after(self, teaming: Teaming, result: StepResult) -> None:
        """Note the attention reward and the belief."""
        reward = sum(result.terms[name] for name in ATTENTION_TERMS)
        self.rewards[:, self.trip, self._step] = reward
        if self._adaptive is not None:
            belief = self._adaptive.estimator.belief.probabilities
            if self.probabilities is None:
                self.probabilities = np.zeros((*self.rewards.shape, belief.shape[1]))
            self.probabilities[:, self.trip, self._step] = belief
        self._step += 1


def play_trips(
    config: TeamConfig,
    driver: Policy,
    hmi: Policy,
    drivers: Traits,
    seeds: NDArray[np.uint64],
    hand_over: HandOver | None = None,
    on_drivers: Callable[[Traits], object] | None = None,
    keep_beliefs: bool = False,
) -> Trips:
    """Let E drivers take J trips each, side by side, in the batched world.

    An adaptive HMI does not know them at the start of their first trip and keeps its belief from
    then on; another HMI begins every trip anew.

    Args:
        config: settings of the teams; its driver is not read.
        driver, hmi: policies of the two seats.
        drivers: traits of E drivers.
        seeds: seeds of the trips, shape (E, J).
        hand_over: change of drivers on the way.
        on_drivers: called with the drivers' traits, at the start of each trip and when they change.
        keep_beliefs: keep an adaptive HMI's beliefs, step by step.
    """
    count, trips = seeds.shape
    note_drivers = on_drivers or (lambda traits: None)
    adaptive = hmi if isinstance(hmi, AdaptiveHMI) else None
    recorder = _Recorder((count, trips, config.horizon), adaptive if keep_beliefs else None)
    current = drivers
    for trip in range(trips):
        recorder.next_trip(trip)
        observers: list[Observer] = [recorder]
        if hand_over is not None and trip == hand_over.trip:
            observers.insert(0, HandsOver(hand_over.step, hand_over.traits, note_drivers))
        teaming = Teaming(replace(config, driver=FixedDrivers(current)), count, "batched")
        begin_trip = adaptive.next_trip if adaptive and trip > 0 else hmi.reset
        teaming.reset(seeds[:, trip])
        driver.reset(seeds[:, trip])
        begin_trip(seeds[:, trip])
        note_drivers(current)
        play(teaming, driver, hmi, observers, steps=config.horizon)
        current = teaming.traits
    return Trips(recorder.rewards, recorder.driving, recorder.probabilities)


# Measures.


def by_turn(trips: Trips, values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Order values (E, J, T) by turns driven, shape (E, J T), with NaN after the last turn.

    Turns after a crash are left out, and later trips move up.
    """
    driving = trips.driving.reshape(len(values), -1)
    flat = np.where(driving, values.reshape(len(values), -1), np.nan)
    order = np.argsort(~driving, axis=1, kind="stable")
    return np.take_along_axis(flat, order, axis=1)


def earned_between(trips: Trips, first: int, last: int) -> NDArray[np.float64]:
    """Sum the attention reward over turns ``first`` to ``last`` - 1 driven, shape (E,)."""
    rewards: NDArray[np.float64] = np.nansum(by_turn(trips, trips.rewards)[:, first:last], axis=1)
    return rewards


@dataclass(frozen=True)
class Closed:
    """Gap from AvgHMI to the HMI that knows the driver, and how much of it an HMI closes."""

    share: Estimate
    """Share of the gap that is closed; NaN if there is none."""
    gap: Estimate
    """Gain from knowing the driver, per driver, over the same turns."""
    regret: Estimate
    """Gain of the knowing HMI over this one."""


def closed(
    knowing: NDArray[np.float64],
    average: NDArray[np.float64],
    own: NDArray[np.float64],
    same_driver: NDArray[np.int64],
    seed: int = 0,
) -> Closed:
    """Measure how much of the gap an HMI closes, by each HMI's reward from each of E drivers, (E,).

    Trips with the same number in ``same_driver``, (E,), are drawn together in the bootstrap.
    """
    _, driver = np.unique(same_driver, return_inverse=True)
    drivers = int(driver.max()) + 1
    gaps, regrets = (np.bincount(driver, knowing - other, drivers) for other in (average, own))
    each = np.bincount(driver, minlength=drivers)
    weights = _resamples(drivers, seed)
    gap, regret = weights @ gaps, weights @ regrets
    count = weights @ each
    per_gap, per_regret = (
        _interval(drawn / count, statistics.ratio(sums, each))
        for drawn, sums in ((gap, gaps), (regret, regrets))
    )
    if per_gap.low <= 0:
        return Closed(UNKNOWN, per_gap, per_regret)
    linear = statistics.ratio(gaps - regrets, gaps)
    with np.errstate(divide="ignore", invalid="ignore"):  # a few resamples may have no gap
        return Closed(_interval(1.0 - regret / gap, linear), per_gap, per_regret)


def ratio(above: NDArray[np.float64], below: NDArray[np.float64], seed: int = 0) -> Estimate:
    """Divide the mean of ``above`` (E,) by the size of ``below``'s, paired; NaN if that is 0."""
    weights, sign = _resamples(len(above), seed), np.sign(below.mean())
    linear = statistics.ratio(above, sign * below)
    with np.errstate(divide="ignore", invalid="ignore"):
        return _interval((weights @ above) / np.abs(weights @ below), linear)


def by_second(
    trips: Trips, values: NDArray[np.float64], steps_per_second: int
) -> NDArray[np.float64]:
    """Average values (E, J, T) over drivers, by whole seconds that half of them or more reach."""
    turns = by_turn(trips, values)
    enough = np.isfinite(turns).mean(axis=0) >= 0.5
    means = np.nanmean(turns[:, enough], axis=0)
    whole = len(means) // steps_per_second * steps_per_second
    seconds: NDArray[np.float64] = means[:whole].reshape(-1, steps_per_second).mean(axis=1)
    return seconds


@lru_cache(maxsize=2)
def _resamples(count: int, seed: int) -> NDArray[np.float64]:
    """Draw how often each of ``count`` is in each resample, shape (DRAWS, count), read-only."""
    rng = np.random.default_rng(seed)
    drawn = rng.multinomial(count, np.full(count, 1 / count), DRAWS).astype(np.float64)
    drawn.flags.writeable = False
    return drawn


def _interval(draws: NDArray[np.float64], linear: Estimate) -> Estimate:
    """Take the interval from the draws, and all else from a linearised estimate."""
    low, high = np.quantile(draws, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
    return replace(linear, low=float(low), high=float(high))
