"""Trips with drivers who are unknown at first, and what an alert is worth in each turn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hmi_marl.agents.adaptive.advantages import Advantages
from hmi_marl.agents.adaptive.hmis import ConditionedHMI
from hmi_marl.agents.hmis import BeliefAlert
from hmi_marl.agents.memory import Draws
from hmi_marl.agents.rollout import Observer, play
from hmi_marl.envs.config import VEHICLE_AI, TeamConfig
from hmi_marl.envs.drivers import Driver, FixedDrivers, Traits
from hmi_marl.envs.seats import Policy
from hmi_marl.envs.step_result import StepResult
from hmi_marl.envs.streams import Stream
from hmi_marl.envs.teaming import Teaming
from hmi_marl.envs.worlds import make_world

ODD_TURNS = 0.1
"""Share of turns in which AvgHMI does the opposite of its rule."""


@dataclass(frozen=True, eq=False)
class DrivenTrips:
    """M trips of T steps."""

    inputs: NDArray[np.float32]
    """Inputs of the HMI's network, shape (M, T, inputs)."""
    advantage: NDArray[np.float32]
    """Advantage of alerting that is expected under the belief about the driver, shape (M, T)."""
    alerts: NDArray[np.bool_]
    """Whether the HMI alerted, shape (M, T)."""
    driving: NDArray[np.bool_]
    """Whether the trip was still going on, shape (M, T)."""

    @property
    def regret(self) -> NDArray[np.float64]:
        """Sum of |advantage| over the turns in which the alert goes against its sign, (M,)."""
        wrong = self.driving & (self.alerts != (self.advantage > 0))
        lost: NDArray[np.float64] = np.where(wrong, np.abs(self.advantage), 0.0).sum(axis=1)
        return lost

    @classmethod
    def joined(cls, parts: Sequence[DrivenTrips]) -> DrivenTrips:
        """Put several together."""
        names = "inputs", "advantage", "alerts", "driving"
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


class _AndAverage:
    """HMI that is AvgHMI in every second team, and the HMI that is learned in the others.

    AvgHMI does the opposite of its rule in a share of its turns at random. So each round has trips
    that do not depend on what was learned, and learning does not swing with them.
    """

    def __init__(self, hmi: ConditionedHMI, config: TeamConfig, revealing: float) -> None:
        self._hmi = hmi
        self._average = BeliefAlert("average", config, revealing)
        self._draws = Draws(Stream.LEARNING)

    def begin(self, seeds: NDArray[np.uint64], is_known: bool) -> None:
        """Begin trips of unknown drivers, or of the same ones as before."""
        (self._hmi.next_trip if is_known else self._hmi.reset)(seeds)
        self._average.reset(seeds)
        self._draws.reset(seeds)

    def reset(self, seeds: NDArray[np.uint64], which: NDArray[np.bool_] | None = None) -> None:
        """See :meth:`Policy.reset`."""
        self.begin(seeds, False)

    def act(self, observations: NDArray[np.float32]) -> NDArray[np.int64]:
        """See :meth:`Policy.act`."""
        own, usual = self._hmi.act(observations), self._average.act(observations)
        other = np.where(self._draws.next() < ODD_TURNS, 1 - usual, usual)
        return np.where(np.arange(len(own)) % 2 == 0, own, other)


class _Recorder(Observer):
    """Record the turns of one trip of every team."""

    def __init__(
        self, hmi: ConditionedHMI, advantages: Advantages, columns: NDArray[np.int64]
    ) -> None:
        self._hmi, self._advantages, self._columns = hmi, advantages, columns
        self._turns: list[tuple[NDArray[Any], NDArray[Any]]] = []
        self._alerts: list[NDArray[np.bool_]] = []
        self._driving: list[NDArray[np.bool_]] = []

    def seen(self, teaming: Teaming, observations: NDArray[np.float32]) -> None:
        """Note what the network reads of the observations, and the candidates' advantages."""
        self._turns.append((observations[:, self._columns], self._advantages.observe(observations)))
        self._driving.append(~teaming.over)

    def after(self, teaming: Teaming, result: StepResult) -> None:
        """Note z as the HMI has just read it, the advantage by the same belief, and its alert."""
        read, of_each = self._turns[-1]
        context = self._hmi.policy.context
        assert context is not None
        p = self._advantages.by_chain(self._hmi.estimator.belief.probabilities)
        expected = (p * of_each).sum(axis=1).astype(np.float32)
        self._turns[-1] = np.concatenate([read, context], axis=1, dtype=np.float32), expected
        self._alerts.append(teaming.alerted > 0)

    def trips(self) -> DrivenTrips:
        """Return the trips."""
        inputs, advantage = (np.stack(part, axis=1) for part in zip(*self._turns, strict=True))
        return DrivenTrips(
            inputs, advantage, np.stack(self._alerts, axis=1), np.stack(self._driving, axis=1)
        )


def drive(
    team: TeamConfig,
    driver: Policy,
    hmi: ConditionedHMI,
    drivers: Sequence[Driver],
    advantages: Advantages,
    revealing: float,
    seeds: NDArray[np.uint64],
    threads: int,
) -> DrivenTrips:
    """Let N drivers take J trips each, unknown at the start of the first one.

    AvgHMI, with random exceptions, is the HMI of every second driver.

    Args:
        team: settings of the teams, but for the drivers.
        driver, hmi: policies of the two seats.
        drivers: the N drivers.
        advantages: of the candidates that ``hmi`` considers.
        revealing: assumed share of steps in which a^H differs from the last applied action.
        seeds: seeds of the trips, shape (N, J).
        threads: threads of the world.

    Returns:
        M = N J trips, of all drivers one after the other, then again.
    """
    config = replace(team, driver=FixedDrivers(Traits.of(drivers)))
    world = make_world("batched", config.scene, len(seeds), threads)
    teaming, parts = Teaming(config, len(seeds), world), []
    columns = hmi.policy.card.columns(teaming.layouts[VEHICLE_AI])
    seat = _AndAverage(hmi, team, revealing)
    for trip in range(seeds.shape[1]):
        teaming.reset(seeds[:, trip])
        driver.reset(seeds[:, trip])
        seat.begin(seeds[:, trip], is_known=trip > 0)
        advantages.reset(len(seeds))
        recorder = _Recorder(hmi, advantages, columns)
        play(teaming, driver, seat, [recorder], steps=team.horizon)
        parts.append(recorder.trips())
    return DrivenTrips.joined(parts)
