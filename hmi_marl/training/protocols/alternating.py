"""Best responses in rounds: the driver learns with the HMI fixed, then the HMI with the driver."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

from hmi_marl.checks import Count, Steps
from hmi_marl.envs.config import DRIVER, VEHICLE_AI
from hmi_marl.envs.rewards import Sharing
from hmi_marl.training.protocols.settings import LEARNED, Budget, Phase, TrainSettings


@dataclass(frozen=True)
class Alternating(TrainSettings):
    """Alternating: in every round each policy learns while the other stays as it is.

    Example: hmi-marl train alternating --rounds 4 --out runs/rounds
    """

    rounds: Count = 4
    """Rounds. In the first one the driver learns without an HMI."""
    driver_steps: Steps = 12_000_000
    """Environment steps in which the driver learns, over all rounds."""
    hmi_steps: Steps = 2_000_000
    """Environment steps in which the HMI learns, over all rounds."""
    driver_reward: Sharing = "driving"
    """Reward of the driver. Without an HMI, as in the first round, a distracted step gives the team
    less than 0, so that "team" teaches the driver to crash."""
    hmi_reward: Sharing = "team"
    """Reward of the HMI."""

    def phases(self) -> tuple[Phase, ...]:
        """See :meth:`TrainSettings.phases`."""
        steps = {DRIVER: self.driver_steps, VEHICLE_AI: self.hmi_steps}
        rewards = {DRIVER: self.driver_reward, VEHICLE_AI: self.hmi_reward}
        phases = []
        for k in range(self.rounds):
            for seat in (DRIVER, VEHICLE_AI):
                team = self.team(self.drivers, rewards[seat])
                first = k == 0 and seat == DRIVER
                phases.append(
                    Phase(
                        f"round {k + 1}, {seat}",
                        seat,
                        team,
                        max(1, steps[seat] // self.rounds),
                        "never" if first else LEARNED,
                        (self.card(seat, team),),
                        progress=(k / self.rounds, (k + 1) / self.rounds),
                    )
                )
        return tuple(phases)

    @classmethod
    def for_comparison(cls, budget: Budget, **shared: Any) -> Self:
        """See :meth:`TrainSettings.for_comparison`."""
        return cls(
            rounds=budget.rounds,
            driver_steps=budget.driver_steps,
            hmi_steps=budget.hmi_steps,
            **budget.rewards("driver_reward", "hmi_reward"),
            **shared,
        )
