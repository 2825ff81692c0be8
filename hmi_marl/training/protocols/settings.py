"""Settings of PPO and those that all protocols share, and a protocol's phases; no torch."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, ClassVar, Literal, Self

from hmi_marl.agents.learned.network import NetworkConfig
from hmi_marl.agents.learned.policy import INTENT, PolicyCard, make_card
from hmi_marl.checks import (
    Checked,
    Count,
    CountOrZero,
    Device,
    Factor,
    LearningRate,
    PowerOfTwo,
    Real,
    Seconds,
    Share,
    Threads,
    UnitsOrZero,
    Weight,
    check_mini_batches,
)
from hmi_marl.envs.config import DRIVER, VEHICLE_AI, TeamConfig, TeamSettings
from hmi_marl.envs.drivers import PAPER_DRIVERS, DriverName
from hmi_marl.envs.rewards import SHARES, Sharing
from hmi_marl.envs.streams import Seed


@dataclass(frozen=True)
class PPOSettings(Checked):
    """Settings of rsl_rl's PPO.

    Raises:
        ValueError: a number out of its range, by name.
    """

    num_learning_epochs: Count = 3
    """Times that each batch is learned from."""
    num_mini_batches: Count = 16
    """Parts of a batch, with a gradient step each."""
    gamma: Share = 0.98
    """Discount γ per step: 0.98 looks about 10 s ahead."""
    gae_lambda: Share = 0.95
    """λ of generalised advantage estimation."""
    learning_rate: LearningRate = 1e-3
    """Learning rate at the start."""
    final_learning_rate: LearningRate = 2e-5
    """Learning rate at the end; it changes linearly in between."""
    entropy_coef: Weight = 0.01
    """Coefficient of the policy's entropy bonus at the start."""
    final_entropy_coef: Weight = 0.0
    """Coefficient of the entropy bonus at the end; it changes linearly in between."""
    clip_param: Annotated[float, Real(0.0, 100.0, above=True)] = 0.2
    """Clip range of the ratio of an action's new to old probability."""
    max_grad_norm: Factor = 1.0
    """Largest norm of a gradient."""
    reward_scale: Factor = 0.1
    """Factor on rewards, so that values are not in the hundreds."""


Critic = Literal["team", "own"]
Condition = Literal["traits", "inflation", "hidden"]

LEARNED = "learned"
"""Partner of a phase: the other seat's policy as this run has learned it so far."""
TEAM = "team"
"""Seat of a phase in which both policies learn."""
OTHER_SEAT = {DRIVER: VEHICLE_AI, VEHICLE_AI: DRIVER}


@dataclass(frozen=True)
class Phase:
    """One stretch of a training run, in which the same policies learn throughout."""

    name: str
    seat: str
    """Seat that learns: "driver", "vehicle_ai" or "team"."""
    team: TeamConfig
    """Configuration of the teams, their reward included."""
    steps: int
    """Environment steps, rounded up to whole batches."""
    partner: str | None = None
    """Policy in the other seat: a name in the catalogue, a trained run, or ``LEARNED``."""
    cards: tuple[PolicyCard, ...] = ()
    """Cards of the policies that learn."""
    joint: bool = False
    """Seat "team": one composite policy learns; otherwise two policies at the same time."""
    progress: tuple[float, float] = (0.0, 1.0)
    """Part of its learner's whole schedule that this phase covers."""
    anchor: str | None = None
    """Driver policy that the driver who learns is held close to: a trained run, or ``LEARNED``, the
    driver that this run has learned before this phase."""
    anchor_kl: float = 0.0
    """Weight of the divergence from the anchor in the driver's loss."""

    def iterations(self, num_teams: int) -> int:
        """Batches of one episode of each team."""
        return math.ceil(self.steps / (num_teams * self.team.horizon))

    @property
    def sequential(self) -> bool:
        """Whether the vehicle AI sees a^H_t in this phase."""
        return all(card.sequential for card in self.cards)


@dataclass(frozen=True)
class Budget:
    """Environment steps and reward of one training, when protocols are compared."""

    driver_steps: int
    """Steps in which the driver learns, if the seats learn one after the other."""
    hmi_steps: int
    """Steps in which the HMI learns, if the seats learn one after the other."""
    rounds: int = 1
    """Rounds of protocols that alternate. Both numbers of steps are multiples of it."""
    reward: Sharing | None = None
    """Reward to learn from; None for the protocol's own."""
    together_share: float = 0.5
    """Share of the steps in which both learn, after two stages."""
    batch: int = 1
    """Steps in a batch. The numbers of steps are multiples of it."""

    @property
    def stages(self) -> tuple[int, int, int]:
        """Steps of the driver, of the HMI and of both together, one after the other.

        Whole batches; at least one for the driver and for both. The stages share what is left by
        ``together_share`` as they share the steps without it.
        """
        batches = self.steps // self.batch
        together = min(max(1, round(self.together_share * batches)), batches - 1)
        alone = batches - together
        driver = max(1, round(alone * self.driver_steps / self.steps))
        return driver * self.batch, (alone - driver) * self.batch, together * self.batch

    @classmethod
    def shared_out(
        cls,
        steps: int,
        driver_share: float,
        batch: int,
        rounds: int = 1,
        reward: Sharing | None = None,
    ) -> Self:
        """Share out ``steps``, the driver's share of them first, in whole batches of each round.

        Args:
            steps: environment steps of the whole training, to be rounded.
            driver_share: share of them in which the driver learns, between 0 and 1.
            batch: environment steps of a batch; each seat gets one in each round at least.
            rounds, reward: see the fields.
        """
        unit = rounds * batch
        whole = max(2, round(steps / unit))  # the same for every share
        driver = min(max(1, round(driver_share * whole)), whole - 1)
        return cls(driver * unit, (whole - driver) * unit, rounds, reward, batch=batch)

    @property
    def steps(self) -> int:
        """Steps of the whole training."""
        return self.driver_steps + self.hmi_steps

    def rewards(self, *names: str) -> dict[str, Any]:
        """The reward as settings of these names; none of them if the protocol has its own."""
        return {} if self.reward is None else dict.fromkeys(names, self.reward)


@dataclass(frozen=True)
class TrainSettings(Checked, TeamSettings):
    """Settings that all protocols share. A protocol adds its own and its phases.

    Raises:
        ValueError, TypeError: a value out of its range, saying what to use instead.
    """

    variants: ClassVar[Mapping[str, Mapping[str, Any]]] = {"": {}}
    """Settings with which protocols are compared, by what is added to the protocol's name."""

    drivers: tuple[DriverName, ...] = PAPER_DRIVERS
    """Drivers, one drawn for each episode: known names, or name:beta,alpha,eta,inflation."""
    seed: Seed = 0
    """Random seed. The same seed gives the same weights (on one machine)."""
    num_teams: Count = 512
    """Teams side by side, shared among the processes. A batch is one whole episode of each."""
    shards: PowerOfTwo = 2
    """Parts of a batch that are computed apart, so that weights do not depend on the number of
    processes, which is at most this. A power of two, halved while the teams do not suffice for it.
    More shards allow more processes, and take a little longer in one. On GPUs each process has one
    part."""
    condition: Condition = "traits"
    """Traits of the driver that the policies read: all of them, the inflation alone, or none
    ("hidden")."""
    sequential: bool = True
    """Sequential moves: the driver moves first and the vehicle AI sees a^H_t. Otherwise both move
    at the same time and the vehicle AI sees a^H_{t-1}."""
    critic: Critic = "team"
    """Input of the critics: the state of the whole team, or the seat's own observation."""
    rnn_hidden_dim: UnitsOrZero = 0
    """Recurrent units in the vehicle AI's network, for hidden attention; 0 for none."""
    hmi_reads: tuple[str, ...] = ()
    """Observation parts that the vehicle AI reads; all of them by default."""
    network: NetworkConfig = field(default_factory=NetworkConfig)
    """Network of each policy and each critic; critics are never recurrent."""
    ppo: PPOSettings = field(default_factory=PPOSettings)
    """Settings of PPO."""
    device: Device = "auto"
    """Device of the learner: cpu, cuda, or auto for a GPU if there is one. The world runs on the
    CPU."""
    threads: Threads | None = None
    """Threads of the world and of the learner in each process. By default one on the CPU, where
    more processes are the better use of more cores, and all cores where a GPU learns."""
    snapshots: CountOrZero = 0
    """Times in each phase that the policies are saved in snapshots/STEPS."""
    checkpoint_every: Seconds = 60.0
    """Least time between checkpoints [s]. Does not change results."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.network.rnn_hidden_dim:
            raise ValueError(
                "only the vehicle AI is recurrent: set rnn_hidden_dim, not network.rnn_hidden_dim"
            )
        check_mini_batches(self.ppo.num_mini_batches, self.num_teams)
        self.card(VEHICLE_AI, self.team(self.drivers))

    def phases(self) -> tuple[Phase, ...]:
        """Phases of the training, in their order."""
        raise NotImplementedError("a protocol lays out its phases")

    @classmethod
    def for_comparison(cls, budget: Budget, **shared: Any) -> Self:
        """Settings whose phases use up ``budget.steps``, to be compared with other protocols.

        ``shared`` are settings that all protocols have, or one of :attr:`variants`.
        """
        raise NotImplementedError("a protocol says how it uses a budget")

    @property
    def shards_used(self) -> int:
        """Number of shards: ``shards``, or fewer if the teams do not suffice for it.

        Each has as many teams, and at least one for each mini-batch.
        """
        count = self.shards
        while self.num_teams % count or self.num_teams // count < self.ppo.num_mini_batches:
            count //= 2
        return count

    @property
    def driver_terms(self) -> tuple[str, ...]:
        """Reward terms that the driver learns from at last; none if only the HMI learns."""
        for phase in reversed(self.phases()):
            if phase.seat != VEHICLE_AI:
                driver, vehicle_ai = SHARES[phase.team.reward]
                both = dict.fromkeys((*driver, *vehicle_ai))  # a composite policy learns from both
                return tuple(both) if phase.joint else driver
        return ()

    def card(self, seat: str, team: TeamConfig, by_intent: bool = False) -> PolicyCard:
        """Card of the policy that learns in a seat, with all inputs that it may read."""
        units = self.rnn_hidden_dim if seat == VEHICLE_AI else 0
        network = replace(self.network, rnn_hidden_dim=units)
        knows = ("inflation",) if self.condition == "inflation" else self.condition == "traits"
        moves = {"by_intent": by_intent, "sequential": self.sequential}
        card = make_card(seat, team, network, knows, **moves)
        if seat != VEHICLE_AI or not self.hmi_reads:
            return card
        # A composite policy's vehicle AI has logits for each a^H in place of reading it.
        return card.reading([n for n in self.hmi_reads if not (by_intent and n == INTENT)])
