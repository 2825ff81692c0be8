"""The paper's protocol: first the driver, then, with the driver in the environment, the HMI."""

from __future__ import annotations

from dataclasses import dataclass

from hmi_marl.envs.config import DRIVER, VEHICLE_AI
from hmi_marl.envs.rewards import Sharing
from hmi_marl.training.protocols.phase import LEARNED, Phase
from hmi_marl.training.protocols.settings import TrainSettings, check_count

POPULATION = "population"


@dataclass(frozen=True)
class TwoStage(TrainSettings):
    """Two-stage, the paper's: a driver policy over the driver types, then an HMI.

    Example: hmi-marl train two-stage --hmi-for homer --out runs/homer
    """

    hmi_for: str = POPULATION
    """Whom the HMI is trained for: one driver (average makes an AvgHMI), or population, all the
    drivers, told apart by what the policies know of them."""
    driver_steps: int = 12_000_000
    """Environment steps of the first stage."""
    hmi_steps: int = 2_000_000
    """Environment steps of the second stage; 0 for the driver alone."""
    driver_policy: str | None = None
    """Skip the first stage: a trained run whose driver to take, or rule or random."""
    driver_reward: Sharing = "driving"
    """What the driver learns from. The chain of distraction does not depend on what they do."""
    hmi_reward: Sharing = "team"
    """What the HMI learns from."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_count("driver_steps", self.driver_steps)
        if self.hmi_steps != 0 or self.driver_policy is not None:
            check_count("hmi_steps", self.hmi_steps)
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
