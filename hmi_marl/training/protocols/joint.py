"""One composite policy π_H∘π_AI of driver and vehicle AI, on the team's reward."""

from __future__ import annotations

from dataclasses import dataclass

from hmi_marl.envs.config import DRIVER, VEHICLE_AI
from hmi_marl.envs.rewards import Sharing
from hmi_marl.training.protocols.phase import TEAM, Phase
from hmi_marl.training.protocols.settings import TrainSettings, check_count


@dataclass(frozen=True)
class Joint(TrainSettings):
    """Joint: one composite policy acts for both seats and learns from one reward.

    Example: hmi-marl train joint --steps 14_000_000 --out runs/joint
    """

    steps: int = 14_000_000
    """Environment steps."""
    reward: Sharing = "team"
    """What it learns from."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_count("steps", self.steps)
        if self.rnn_hidden_dim:
            raise ValueError("the composite policy has no memory; use another protocol, or 0")

    def phases(self) -> tuple[Phase, ...]:
        """See :meth:`TrainSettings.phases`."""
        team = self.team(self.drivers, self.reward)
        cards = self.card(DRIVER, team), self.card(VEHICLE_AI, team, by_intent=True)
        return (Phase("joint", TEAM, team, self.steps, cards=cards, joint=True),)
