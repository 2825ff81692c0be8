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

    Example: hmi-marl train simultaneous --critic own --parallel --out runs/at-once
    """

    steps: int = 14_000_000
    """Environment steps."""
    reward: Sharing = "team"
    """What they learn from."""
    parallel: bool = False
    """Both act at once, the vehicle AI seeing a^H one step late, instead of taking turns."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_count("steps", self.steps)

    def phases(self) -> tuple[Phase, ...]:
        """See :meth:`TrainSettings.phases`."""
        team = self.team(self.drivers, self.reward)
        turns = not self.parallel
        cards = tuple(self.card(seat, team, taking_turns=turns) for seat in (DRIVER, VEHICLE_AI))
        return (Phase("simultaneous", TEAM, team, self.steps, cards=cards),)
