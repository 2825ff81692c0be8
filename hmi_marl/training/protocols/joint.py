"""Both policies learn at the same time: as one composite policy π_H∘π_AI, or each by its PPO."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Self

from hmi_marl.checks import Steps
from hmi_marl.envs.config import DRIVER, VEHICLE_AI
from hmi_marl.envs.rewards import Sharing
from hmi_marl.training.protocols.settings import TEAM, Budget, Phase, TrainSettings


@dataclass(frozen=True)
class Joint(TrainSettings):
    """Joint: one composite policy acts for both seats and learns from one reward.

    Example: hmi-marl train joint --steps 14_000_000 --out runs/joint
    """

    steps: Steps = 14_000_000
    """Environment steps."""
    reward: Sharing = "team"
    """Reward of the composite policy: the sum of both agents' rewards where they differ."""

    def phases(self) -> tuple[Phase, ...]:
        """See :meth:`TrainSettings.phases`."""
        team = self.team(self.drivers, self.reward)
        cards = self.card(DRIVER, team), self.card(VEHICLE_AI, team, by_intent=True)
        return (Phase("joint", TEAM, team, self.steps, cards=cards, joint=True),)

    @classmethod
    def for_comparison(cls, budget: Budget, **shared: Any) -> Self:
        """See :meth:`TrainSettings.for_comparison`."""
        return cls(steps=budget.steps, **budget.rewards("reward"), **shared)


@dataclass(frozen=True)
class Simultaneous(TrainSettings):
    """Simultaneous: two agents learn at once, with a common critic's view or their own.

    Example: hmi-marl train simultaneous --critic own --no-sequential --out runs/at-once
    """

    variants: ClassVar[Mapping[str, Mapping[str, Any]]] = {"": {}, "-moves": {"sequential": False}}

    steps: Steps = 14_000_000
    """Environment steps."""
    reward: Sharing = "team"
    """Reward of both policies."""
    sequential: bool = True
    """Sequential moves: the driver moves first and the vehicle AI sees a^H_t. Otherwise both move
    at the same time and the vehicle AI sees a^H_{t-1}."""

    def phases(self) -> tuple[Phase, ...]:
        """See :meth:`TrainSettings.phases`."""
        team = self.team(self.drivers, self.reward)
        cards = tuple(
            self.card(seat, team, sequential=self.sequential) for seat in (DRIVER, VEHICLE_AI)
        )
        return (Phase("simultaneous", TEAM, team, self.steps, cards=cards),)

    @classmethod
    def for_comparison(cls, budget: Budget, **shared: Any) -> Self:
        """See :meth:`TrainSettings.for_comparison`."""
        return cls(steps=budget.steps, **budget.rewards("reward"), **shared)
