"""What a protocol is made of: phases, in each of which somebody learns beside somebody."""

from __future__ import annotations

import math
from dataclasses import dataclass

from hmi_marl.agents.learned.policy import PolicyCard
from hmi_marl.envs.config import DRIVER, VEHICLE_AI, TeamConfig

LEARNED = "learned"
"""As a partner: the other seat's policy, as far as this run has learned it."""
TEAM = "team"


@dataclass(frozen=True)
class Phase:
    """One stretch of a training run."""

    name: str
    seat: str
    """Who learns: "driver", "vehicle_ai" or "team"."""
    team: TeamConfig
    """How teams are set up, and whose reward."""
    steps: int
    """Environment steps, rounded up to whole batches."""
    partner: str | None = None
    """In the other seat: a name of the catalogue, a trained run, or ``LEARNED``."""
    cards: tuple[PolicyCard, ...] = ()
    """Of the policies that learn."""
    joint: bool = False
    """Seat "team": one composite policy; otherwise two that learn at the same time."""
    progress: tuple[float, float] = (0.0, 1.0)
    """Which part of all that its learner will learn this phase is, for schedules."""

    def iterations(self, num_teams: int, processes: int) -> int:
        """Batches of one episode of each team in each process."""
        return math.ceil(self.steps / (num_teams * self.team.horizon * processes))

    @property
    def sequential(self) -> bool:
        """Whether the vehicle AI learns to see a^H_t."""
        return all(card.sequential for card in self.cards)


OTHER = {DRIVER: VEHICLE_AI, VEHICLE_AI: DRIVER}
"""The other seat."""
