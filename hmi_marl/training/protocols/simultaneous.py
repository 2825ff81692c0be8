"""Both policies learn at the same time, each by a PPO of its own."""

from __future__ import annotations

from dataclasses import dataclass

from hmi_marl.envs.config import DRIVER, VEHICLE_AI
from hmi_marl.envs.rewards import Sharing
from hmi_marl.training.protocols.phase import TEAM, Phase
from hmi_marl.training.protocols.settings import TrainSettings, check_count


@dataclass(frozen=True)
class Simultaneous(TrainSettings):
    """Simultaneous: two agents learn at once, with a common critic's view or their own.

    Example: hmi-marl train simultaneous --critic own --no-sequential --out runs/at-once
    """

    steps: int = 14_000_000
    """Environment steps."""
    reward: Sharing = "team"
    """What they learn from."""
    sequential: bool = True
    """The driver moves first and the vehicle AI sees a^H_t; if not, both move at the same time and
    it sees a^H_{t-1}."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_count("steps", self.steps)

    def phases(self) -> tuple[Phase, ...]:
        """See :meth:`TrainSettings.phases`."""
        team = self.team(self.drivers, self.reward)
        cards = tuple(
            self.card(seat, team, sequential=self.sequential) for seat in (DRIVER, VEHICLE_AI)
        )
        return (Phase("simultaneous", TEAM, team, self.steps, cards=cards),)
