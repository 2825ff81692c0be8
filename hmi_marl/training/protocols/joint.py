"""Both policies learn at the same time: as one composite policy π_H∘π_AI, or each by its PPO."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Self

from hmi_marl.checks import Steps
from hmi_marl.envs.config import DRIVER, VEHICLE_AI
from hmi_marl.envs.rewards import Sharing
from hmi_marl.training.protocols.anchored import Anchored
from hmi_marl.training.protocols.settings import TEAM, Budget, Phase


@dataclass(frozen=True)
class Joint(Anchored):
    """Joint: one composite policy acts for both seats and learns from one reward.

    Example: hmi-marl train joint --steps 14_000_000 --out runs/joint
    """

    steps: Steps = 14_000_000
    """Environment steps."""
    reward: Sharing = "team"
    """Reward of the composite policy: the sum of both agents' rewards where they differ."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.sequential:
            raise ValueError(
                "the composite policy draws a^A given a^H, so its moves are sequential; for others "
                "use another protocol, such as simultaneous"
            )

    def phases(self) -> tuple[Phase, ...]:
        """See :meth:`TrainSettings.phases`."""
        team = self.team(self.drivers, self.reward)
        cards = self.card(DRIVER, team), self.card(VEHICLE_AI, team, by_intent=True)
        return (Phase("joint", TEAM, team, self.steps, cards=cards, joint=True, **self.anchored),)

    @classmethod
    def for_comparison(cls, budget: Budget, **shared: Any) -> Self:
        """See :meth:`TrainSettings.for_comparison`."""
        return cls(steps=budget.steps, **budget.rewards("reward"), **shared)


@dataclass(frozen=True)
class Simultaneous(Anchored):
    """Simultaneous: two agents learn at once, with a common critic's view or their own.

    Example: hmi-marl train simultaneous --critic own --no-sequential --out runs/at-once
    """

    variants: ClassVar[Mapping[str, Mapping[str, Any]]] = {"": {}, "-moves": {"sequential": False}}

    steps: Steps = 14_000_000
    """Environment steps."""
    reward: Sharing = "team"
    """Reward of both policies."""

    def phases(self) -> tuple[Phase, ...]:
        """See :meth:`TrainSettings.phases`."""
        team = self.team(self.drivers, self.reward)
        cards = self.card(DRIVER, team), self.card(VEHICLE_AI, team)
        return (Phase("simultaneous", TEAM, team, self.steps, cards=cards, **self.anchored),)

    @classmethod
    def for_comparison(cls, budget: Budget, **shared: Any) -> Self:
        """See :meth:`TrainSettings.for_comparison`."""
        return cls(steps=budget.steps, **budget.rewards("reward"), **shared)
