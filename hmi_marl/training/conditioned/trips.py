"""Trips with drivers who are unknown at first, and what the exact rules say about each turn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hmi_marl.agents.adaptive.hmis import ConditionedHMI
from hmi_marl.agents.rollout import Observer, play
from hmi_marl.envs.config import VEHICLE_AI, TeamConfig
from hmi_marl.envs.drivers import Driver, FixedDrivers, Traits
from hmi_marl.envs.seats import Policy
from hmi_marl.envs.step_result import StepResult
from hmi_marl.envs.teaming import Teaming
from hmi_marl.envs.worlds import make_world
from hmi_marl.training.conditioned.teacher import Teacher


@dataclass(frozen=True, eq=False)
class TaughtTrips:
    """M trips of T steps."""

    inputs: NDArray[np.float32]
    """Inputs of the HMI's network, shape (M, T, inputs)."""
    advantage: NDArray[np.float32]
    """Advantage of alerting by the exact rule of the driver, shape (M, T)."""
    alerts: NDArray[np.bool_]
    """Whether the HMI alerted, shape (M, T)."""
    driving: NDArray[np.bool_]
    """Whether the trip was still going on, shape (M, T)."""

    @property
    def regret(self) -> float:
        """Mean regret of a trip, by the rules' own model."""
        wrong = self.driving & (self.alerts != (self.advantage > 0))
        return float(np.where(wrong, np.abs(self.advantage), 0.0).sum(axis=1).mean())

    @classmethod
    def joined(cls, parts: Sequence[TaughtTrips]) -> TaughtTrips:
        """Put several together."""
        names = "inputs", "advantage", "alerts", "driving"
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


class _Recorder(Observer):
    """Record the turns of one trip of every team."""

    def __init__(self, hmi: ConditionedHMI, teacher: Teacher, columns: NDArray[np.int64]) -> None:
        self._hmi, self._teacher, self._columns = hmi, teacher, columns
        self._turns: list[tuple[NDArray[np.float32], ...]] = []
        self._alerts: list[NDArray[np.bool_]] = []
        self._driving: list[NDArray[np.bool_]] = []

    def seen(self, teaming: Teaming, observations: NDArray[np.float32]) -> None:
        """Note what the network reads of the observations, and the advantage."""
        advantage = self._teacher.advantage(observations).astype(np.float32)
        self._turns.append((observations[:, self._columns], advantage))
        self._driving.append(~teaming.over)

    def after(self, teaming: Teaming, result: StepResult) -> None:
        """Note z as the HMI has just read it, and its alert."""
        read, advantage = self._turns[-1]
        context = self._hmi.policy.context
        assert context is not None
        self._turns[-1] = np.concatenate([read, context], axis=1, dtype=np.float32), advantage
        self._alerts.append(teaming.alerted > 0)

    def trips(self) -> TaughtTrips:
        """Return the trips."""
        inputs, advantage = (np.stack(part, axis=1) for part in zip(*self._turns, strict=True))
        return TaughtTrips(
            inputs, advantage, np.stack(self._alerts, axis=1), np.stack(self._driving, axis=1)
        )


def drive(
    team: TeamConfig,
    driver: Policy,
    hmi: ConditionedHMI,
    drivers: Sequence[Driver],
    teacher: Teacher,
    seeds: NDArray[np.uint64],
    threads: int,
) -> TaughtTrips:
    """Let N drivers take J trips each, unknown at the start of the first one.

    Args:
        team: settings of the teams, but for the drivers.
        driver, hmi: policies of the two seats.
        drivers: the N drivers.
        teacher: their exact rules.
        seeds: seeds of the trips, shape (N, J).
        threads: threads of the world.

    Returns:
        M = N J trips.
    """
    config = replace(team, driver=FixedDrivers(Traits.of(drivers)))
    world = make_world("batched", config.scene, len(seeds), threads)
    teaming, parts = Teaming(config, len(seeds), world), []
    columns = hmi.policy.card.columns(teaming.layouts[VEHICLE_AI])
    for trip in range(seeds.shape[1]):
        teaming.reset(seeds[:, trip])
        driver.reset(seeds[:, trip])
        (hmi.next_trip if trip else hmi.reset)(seeds[:, trip])
        teacher.reset()
        recorder = _Recorder(hmi, teacher, columns)
        play(teaming, driver, hmi, [recorder], steps=team.horizon)
        parts.append(recorder.trips())
    return TaughtTrips.joined(parts)
