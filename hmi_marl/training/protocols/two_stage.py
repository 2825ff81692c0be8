"""The paper's protocol: first the driver, then the HMI with that driver in the environment."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

from hmi_marl.checks import STEPS, Steps, StepsOrZero
from hmi_marl.envs.config import DRIVER, VEHICLE_AI
from hmi_marl.envs.drivers import DriverName
from hmi_marl.envs.rewards import Sharing
from hmi_marl.training.protocols.settings import LEARNED, Budget, Phase, TrainSettings

POPULATION = "population"


@dataclass(frozen=True)
class TwoStage(TrainSettings):
    """Two-stage, the paper's: a driver policy over the driver types, then an HMI.

    Example: hmi-marl train two-stage --hmi-for homer --out runs/homer
    """

    hmi_for: DriverName = POPULATION
    """Driver that the HMI is trained for: a name (average makes an AvgHMI), or population for all
    of the drivers, which the policies distinguish by the traits that they observe."""
    driver_steps: Steps = 12_000_000
    """Environment steps of the first stage."""
    hmi_steps: StepsOrZero = 2_000_000
    """Environment steps of the second stage; 0 for the driver alone."""
    driver_policy: str | None = None
    """Skip the first stage and use this driver: a trained run, rule or random, or several of them,
    mixture:NAME,NAME,..., of which one drives in each episode."""
    driver_reward: Sharing = "driving"
    """Reward of the driver. Distraction does not depend on what the driver does."""
    hmi_reward: Sharing = "team"
    """Reward of the HMI."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.driver_policy is not None:
            STEPS("hmi_steps", self.hmi_steps)
        self.team(self._assisted)

    @property
    def _assisted(self) -> tuple[str, ...]:
        return self.drivers if self.hmi_for.lower() == POPULATION else (self.hmi_for,)

    def phases(self) -> tuple[Phase, ...]:
        """See :meth:`TrainSettings.phases`."""
        driving = self.team(self.drivers, self.driver_reward)
        assisted = self.team(self._assisted, self.hmi_reward)
        hmi = (self.card(VEHICLE_AI, assisted),)
        partner = LEARNED if self.driver_policy is None else self.driver_policy
        second = Phase("hmi", VEHICLE_AI, assisted, self.hmi_steps, partner, hmi)
        if self.driver_policy is not None:
            return (second,)
        driver = (self.card(DRIVER, driving),)
        first = Phase("driver", DRIVER, driving, self.driver_steps, "never", driver)
        return (first, second) if self.hmi_steps else (first,)

    @classmethod
    def for_comparison(cls, budget: Budget, **shared: Any) -> Self:
        """See :meth:`TrainSettings.for_comparison`. The rewards are always the paper's."""
        return cls(driver_steps=budget.driver_steps, hmi_steps=budget.hmi_steps, **shared)
