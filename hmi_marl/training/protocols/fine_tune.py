"""Both policies learn in two stages, and then go on together."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

from hmi_marl.checks import Share, Steps, StepsOrZero
from hmi_marl.envs.config import DRIVER, VEHICLE_AI
from hmi_marl.envs.rewards import Sharing
from hmi_marl.training.protocols.anchored import OWN_DRIVER, Anchored
from hmi_marl.training.protocols.settings import LEARNED, TEAM, Budget, Phase


@dataclass(frozen=True)
class FineTune(Anchored):
    """Fine-tune: two stages, first a driver and then an HMI, and then both together.

    While both learn, policies, critics and optimisers go on from those of the stages. A critic
    whose reward changes learns the new values in the first batches. "--anchor first-stage" holds
    the driver close to that of this run's first stage.

    Example: hmi-marl train fine-tune --anchor first-stage --anchor-kl 0.1 --out runs/tuned
    """

    driver_steps: Steps = 12_000_000
    """Environment steps of the first stage, in which the driver learns without an HMI."""
    hmi_steps: StepsOrZero = 2_000_000
    """Environment steps of the second stage, in which the HMI learns with that driver; 0 for an HMI
    that begins to learn together with the driver."""
    together_steps: Steps = 8_000_000
    """Environment steps in which both learn at the same time."""
    together_progress: Share = 0.5
    """Point of the schedules of learning rate and entropy bonus at which both begin to learn
    together: with 0 these are as high as at the start of a stage, with 1 as low as at its end."""
    driver_reward: Sharing = "driving"
    """Reward of the driver in the first stage."""
    hmi_reward: Sharing = "team"
    """Reward of the HMI in the second stage."""
    together_reward: Sharing = "team"
    """Reward of both while both learn."""

    def phases(self) -> tuple[Phase, ...]:
        """See :meth:`TrainSettings.phases`."""
        alone = self.team(self.drivers, self.driver_reward)
        assisted = self.team(self.drivers, self.hmi_reward)
        both = self.team(self.drivers, self.together_reward)
        driver, hmi = self.card(DRIVER, alone), self.card(VEHICLE_AI, assisted)
        first = Phase("driver", DRIVER, alone, self.driver_steps, "never", (driver,))
        second = Phase("hmi", VEHICLE_AI, assisted, self.hmi_steps, LEARNED, (hmi,))
        anchor = LEARNED if self.anchor == OWN_DRIVER else self.anchor
        last = Phase(
            "together",
            TEAM,
            both,
            self.together_steps,
            cards=(driver, hmi),
            progress=(self.together_progress, 1.0),
            anchor=anchor,
            anchor_kl=self.anchor_kl,
        )
        return (first, second, last) if self.hmi_steps else (first, last)

    @classmethod
    def for_comparison(cls, budget: Budget, **shared: Any) -> Self:
        """See :meth:`TrainSettings.for_comparison`. The stages' rewards are always the paper's."""
        driver, hmi, together = budget.stages
        return cls(
            driver_steps=driver,
            hmi_steps=hmi,
            together_steps=together,
            **budget.rewards("together_reward"),
            **shared,
        )
