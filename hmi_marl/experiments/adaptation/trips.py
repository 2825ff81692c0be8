"""Trip after trip with the same drivers, step by step: what an HMI earns as it learns of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hmi_marl.agents.adaptive.hmis import AdaptiveHMI
from hmi_marl.agents.rollout import HandsOver, Observer, play
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import Traits
from hmi_marl.envs.rewards import ATTENTION_TERMS
from hmi_marl.envs.seats import Policy
from hmi_marl.envs.teaming import StepResult, Teaming


@dataclass(frozen=True, eq=False)
class AtTheWheel:
    """A population in which it is settled who drives: the same in every episode."""

    traits: Traits
    """Of the drivers of N teams."""

    def draw(self, seeds: NDArray[np.uint64]) -> Traits:
        """See :meth:`Population.draw`; the seeds change nothing."""
        return self.traits


@dataclass(frozen=True, eq=False)
class HandOver:
    """Another driver takes the wheel, unannounced."""

    trip: int
    """In which trip, from 0."""
    step: int
    """Before which step of it, from 0."""
    traits: Traits
    """Of the new drivers."""


@dataclass(frozen=True, eq=False)
class Trips:
    """What E drivers' trips were worth with one HMI. J trips of T steps."""

    rewards: NDArray[np.float64]
    """Attention reward of each step, shape (E, J, T); 0 after a crash."""
    driving: NDArray[np.bool_]
    """Whether the trip was still going on, shape (E, J, T)."""
    probabilities: NDArray[np.float64] | None = None
    """What an adaptive HMI believed in its turn, shape (E, J, T, K), if that was kept."""

    @property
    def returns(self) -> NDArray[np.float64]:
        """Attention return of each trip, shape (E, J)."""
        return self.rewards.sum(axis=2)


class _Recorder(Observer):
    """Keep what each step of each trip was worth, and what an adaptive HMI believed in it."""

    def __init__(self, shape: tuple[int, int, int], adaptive: AdaptiveHMI | None) -> None:
        self.rewards, self.driving = np.zeros(shape), np.zeros(shape, np.bool_)
        self.probabilities: NDArray[np.float64] | None = None
        self._adaptive = adaptive
        self.trip = self._step = 0

    def next_trip(self, trip: int) -> None:
        """From now on it is this trip, from 0."""
        self.trip, self._step = trip, 0

    def before(self, teaming: Teaming) -> None:
        """Note who is still driving."""
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
    told: Callable[[Traits], object] | None = None,
    keep_beliefs: bool = False,
) -> Trips:
    """Let E drivers take J trips each, side by side, in the batched world.

    An adaptive HMI does not know them at the start of their first trip and keeps what it has learned
    from then on; another one begins every trip anew.

    Args:
        config: of the teams; its driver is not read.
        driver: policy of the driver's seat.
        hmi: policy of the vehicle AI's seat.
        drivers: who drive, E of them.
        seeds: of the trips, shape (E, J).
        hand_over: a change of drivers on the way.
        told: is called with who drives, at the start and when that changes.
        keep_beliefs: keep what an adaptive HMI believed, step by step.
    """
    count, trips = seeds.shape
    tell = told or (lambda traits: None)
    adaptive = hmi if isinstance(hmi, AdaptiveHMI) else None
    recorder = _Recorder((count, trips, config.horizon), adaptive if keep_beliefs else None)
    at_the_wheel = drivers
    for trip in range(trips):
        recorder.next_trip(trip)
        observers: list[Observer] = [recorder]
        if hand_over is not None and trip == hand_over.trip:
            observers.insert(0, HandsOver(hand_over.step, hand_over.traits, tell))
        teaming = Teaming(replace(config, driver=AtTheWheel(at_the_wheel)), count, "batched")
        begin_trip = adaptive.next_trip if adaptive and trip > 0 else hmi.reset
        teaming.reset(seeds[:, trip])
        driver.reset(seeds[:, trip])
        begin_trip(seeds[:, trip])
        tell(at_the_wheel)
        play(teaming, driver, hmi, observers, steps=config.horizon)
        at_the_wheel = teaming.traits
    return Trips(recorder.rewards, recorder.driving, recorder.probabilities)
