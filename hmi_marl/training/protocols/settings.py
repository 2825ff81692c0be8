"""What a training run can be told, in frozen dataclasses that import no torch."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Literal

from hmi_marl.agents.learned.network import NetworkConfig
from hmi_marl.agents.learned.policy import PolicyCard, make_card
from hmi_marl.envs.config import VEHICLE_AI, TeamConfig, TeamSettings
from hmi_marl.envs.drivers import PAPER_DRIVERS
from hmi_marl.envs.streams import check_seed
from hmi_marl.training.protocols.phase import Phase

Critic = Literal["team", "own"]
Condition = Literal["traits", "hidden"]


@dataclass(frozen=True)
class PPOSettings:
    """rsl_rl's PPO.

    Raises:
        ValueError: a number out of its range, by name.
    """

    num_learning_epochs: int = 3
    """Times that each batch is learned from."""
    num_mini_batches: int = 16
    """Parts of a batch, a gradient step each."""
    gamma: float = 0.98
    """γ per step: 0.98 looks about 10 s ahead."""
    gae_lambda: float = 0.95
    """λ of generalised advantage estimation."""
    learning_rate: float = 1e-3
    """At the start."""
    final_learning_rate: float = 2e-5
    """At the end; in between it falls along a line."""
    entropy_coef: float = 0.01
    """Bonus for the policy's entropy at the start."""
    final_entropy_coef: float = 0.0
    """The same at the end."""
    clip_param: float = 0.2
    """How far an update may move the probability of an action, as a ratio."""
    max_grad_norm: float = 1.0
    """Longest gradient."""
    reward_scale: float = 0.1
    """Rewards are learned from in this unit, so that values are not in the hundreds."""

    def __post_init__(self) -> None:
        for name in ("num_learning_epochs", "num_mini_batches"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} is at least 1, but got {getattr(self, name)}")
        for name in ("gamma", "gae_lambda"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise ValueError(f"{name} lies in [0, 1], but got {getattr(self, name)}")
        for name in (
            "learning_rate",
            "final_learning_rate",
            "clip_param",
            "max_grad_norm",
            "reward_scale",
        ):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise ValueError(f"{name} is a positive number, but got {value}")
        for name in ("entropy_coef", "final_entropy_coef"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0):
                raise ValueError(f"{name} is a number of at least 0, but got {value}")


@dataclass(frozen=True)
class TrainSettings(TeamSettings):
    """What every protocol can be told.

    Raises:
        ValueError, TypeError: a value out of its range, saying what to use instead.
    """

    drivers: tuple[str, ...] = PAPER_DRIVERS
    """Who drives, drawn for each episode: known names, or name:beta,alpha,eta,inflation."""
    seed: int = 0
    """Same seed, same weights (on one machine, with one number of processes)."""
    num_teams: int = 512
    """Teams side by side. A batch is one whole episode of each."""
    condition: Condition = "traits"
    """What the policies know of the driver: their traits, or nothing ("hidden")."""
    critic: Critic = "team"
    """What values are learned from: the whole team's state, or what the seat itself sees."""
    rnn_hidden_dim: int = 0
    """Units of a recurrent layer in the vehicle AI's network, for hidden attention; 0 for none."""
    hmi_reads: tuple[str, ...] = ()
    """Parts of its observation that the vehicle AI reads; all of them by default."""
    network: NetworkConfig = field(default_factory=NetworkConfig)
    """Of every policy, and of every critic but for the memory."""
    ppo: PPOSettings = field(default_factory=PPOSettings)
    """How the learner learns."""
    device: str = "auto"
    """Of the learner: cpu, cuda, or auto, a GPU if there is one. The world stays on the CPU."""
    threads: int = 1
    """Of the world and of the learner, in each process. More help little where networks are small;
    the cores are better used by more processes."""
    snapshots: int = 0
    """How many times in each phase to keep the policies as they stand, in snapshots/STEPS."""
    checkpoint_every: float = 60.0
    """Least time between checkpoints [s]. Does not change results."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "seed", check_seed(self.seed))
        if self.num_teams < 1:
            raise ValueError(f"there is at least one team, but got num_teams = {self.num_teams}")
        if self.threads < 1:
            raise ValueError(f"there is at least one thread, but got threads = {self.threads}")
        if self.snapshots < 0:
            raise ValueError(f"snapshots is a number of times, but got {self.snapshots}")
        if self.checkpoint_every < 0:
            raise ValueError(f"checkpoint_every is a time [s], but got {self.checkpoint_every}")
        if self.network.rnn_hidden_dim:
            raise ValueError(
                "only the vehicle AI has a memory: set memory, not network.rnn_hidden_dim"
            )
        NetworkConfig(rnn_hidden_dim=self.rnn_hidden_dim)  # checks it
        least = (
            2 if self.rnn_hidden_dim else 1
        )  # rsl_rl mixes up the axes of one team with a memory
        if self.ppo.num_mini_batches * least > self.num_teams:
            raise ValueError(
                f"{self.num_teams} teams make no {self.ppo.num_mini_batches} mini-batches of at least "
                f"{least}; choose more teams or fewer mini-batches"
            )
        self.card(VEHICLE_AI, self.team(self.drivers))

    def phases(self) -> tuple[Phase, ...]:
        """What to do, one after the other."""
        raise NotImplementedError("a protocol lays out its phases")

    def card(
        self, seat: str, team: TeamConfig, by_intent: bool = False, sequential: bool = True
    ) -> PolicyCard:
        """The policy that learns in a seat: it reads all it sees but what it is not to know."""
        network = replace(
            self.network, rnn_hidden_dim=self.rnn_hidden_dim if seat == VEHICLE_AI else 0
        )
        knows = self.condition == "traits"
        card = make_card(seat, team, network, knows, by_intent=by_intent, sequential=sequential)
        return card.reading(self.hmi_reads) if self.hmi_reads and seat == VEHICLE_AI else card


def check_count(name: str, count: int) -> int:
    """Return a number of things, or raise if there are none."""
    if count < 1:
        raise ValueError(f"{name} is at least 1, but got {count}")
    return count
