"""What learning latent traits can be told, in frozen dataclasses that import no torch."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal, get_args

from hmi_marl.agents.learned.network import NetworkConfig
from hmi_marl.agents.learned.trait_model import TraitCard
from hmi_marl.checks import check_count
from hmi_marl.envs.observations import Layout
from hmi_marl.envs.streams import check_seed
from hmi_marl.training.ppo.settings import PPOSettings

Supervision = Literal["none", "id", "preference"]


@dataclass(frozen=True)
class LossWeights:
    """Weights of the losses of the paper's loss table, and how far the encoder imitates.

    Raises:
        ValueError: a weight below 0, or not finite.
    """

    reconstruct: float = 1.0
    """Of L1."""
    information: float = 5.0
    """Of L2."""
    contrast: float = 10.0
    """Of L3."""
    regularise: float = 1e-4
    """Of L4."""
    imitate: float = 0.0
    """How much the encoder learns from −log π(a | s, z) on demonstrations, which is not in the
    paper. The policy always learns from it: driving at random it would crash at once, and give the
    discriminator nothing to compare. With 1 the encoder learns what of z the policy can use, which
    makes the unsupervised setting much more accurate."""

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            _check_positive(name, value, zero=True)

    def by_loss(self) -> dict[str, float]:
        """The same by the names of the losses."""
        return {
            "L1": self.reconstruct,
            "L2": self.information,
            "L3": self.contrast,
            "L4": self.regularise,
            "imitation": 1.0,
        }


@dataclass(frozen=True)
class TraitSettings:
    """How latent traits are learned from demonstrations.

    Raises:
        ValueError, TypeError: a value out of its range, saying what to use instead.
    """

    supervision: Supervision = "none"
    """What is labelled: nothing, who drives (id), or whether they like help (preference)."""
    labelled: float = 0.2
    """Share of each driver's windows that is labelled."""
    softness: float = 0.0
    """For graded labels: how far apart two labels may be and still count as alike, as the standard
    deviation of a Gaussian in units of the labels; 0 for labels that are equal or not."""
    margin: float = 2.0
    """ε of L3, how far apart vectors of different labels are to be."""
    held_out: float = 0.2
    """Share of each driver's windows, the last ones, that is never learned from."""
    latent: int = 2
    """Size of z."""
    pool: int = 8
    """Windows of one driver that are pooled."""
    encoder_units: int = 128
    """Units of the context encoder's recurrent layer."""
    imitation_updates: int = 600
    """Updates before the policy drives: the policy learns by imitation, the encoder by what does
    not need the policy's driving."""
    steps: int = 1_000_000
    """Environment steps of the policy, rounded up to whole rounds."""
    num_teams: int = 64
    """Cars that the policy drives in a round, one window each; pools of them share one z."""
    expert_pools: int = 16
    """Pools of demonstrations in each update of the discriminator, two of each driver drawn."""
    labelled_pools: int = 16
    """Labelled pools in each update, if there are labels."""
    updates: int = 2
    """Of the discriminator in each round."""
    settling: float = 0.06
    """Share of the rounds, at the start, in which the discriminator learns alone."""
    learning_rate: float = 5e-4
    """Of the discriminator."""
    imitation_rate: float = 5e-3
    """Of the policy, where it learns from demonstrations."""
    weights: LossWeights = field(default_factory=LossWeights)
    """Of the losses."""
    reward: NetworkConfig = field(default_factory=lambda: NetworkConfig((32, 32)))
    """Of the base reward g."""
    potential: NetworkConfig = field(default_factory=lambda: NetworkConfig((32,)))
    """Of the potential h."""
    policy: NetworkConfig = field(default_factory=lambda: NetworkConfig((32,)))
    """Of the policy π."""
    ppo: PPOSettings = field(
        default_factory=lambda: PPOSettings(
            num_learning_epochs=4,
            num_mini_batches=4,
            learning_rate=1e-3,
            final_learning_rate=1e-4,
            entropy_coef=0.0,
            reward_scale=1.0,
        )
    )
    """Of the generator. Its reward f − log π already holds the entropy."""
    seed: int = 0
    """Same seed and demonstrations, same weights (on one machine)."""
    device: str = "auto"
    """Of the learner: cpu, cuda, or auto, a GPU if there is one."""
    threads: int = 1
    """Of the world and of the learner."""
    checkpoint_every: float = 60.0
    """Least time between checkpoints [s]. Does not change results."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "seed", check_seed(self.seed))
        if self.supervision not in get_args(Supervision):
            raise ValueError(
                f"supervision is one of {', '.join(get_args(Supervision))}, not "
                f"{self.supervision!r}"
            )
        if self.softness and self.supervision == "id":
            raise ValueError("softness is for graded labels, but who drives is not graded")
        for name in ("steps", "num_teams", "expert_pools", "updates", "threads", "pool", "latent"):
            check_count(name, getattr(self, name))
        if self.expert_pools % 2:
            raise ValueError(f"expert_pools is an even number, but got {self.expert_pools}")
        if self.imitation_updates < 0:
            raise ValueError(
                f"imitation_updates is a number of times, but got {self.imitation_updates}"
            )
        if not 0.0 <= self.settling <= 1.0:
            raise ValueError(f"settling is a share in [0, 1], but got {self.settling}")
        if not 0.0 <= self.held_out < 1.0:
            raise ValueError(f"held_out is a share in [0, 1), but got {self.held_out}")
        if not 0.0 < self.labelled <= 1.0:
            raise ValueError(f"labelled is a share in (0, 1], but got {self.labelled}")
        if self.labelled_pools < 2:
            raise ValueError(
                f"L3 compares pools: labelled_pools is at least 2, but got {self.labelled_pools}"
            )
        for name, zero in (
            ("softness", True),
            ("margin", False),
            ("learning_rate", False),
            ("imitation_rate", False),
        ):
            _check_positive(name, getattr(self, name), zero)
        if self.checkpoint_every < 0:
            raise ValueError(f"checkpoint_every is a time [s], but got {self.checkpoint_every}")
        if self.num_teams % self.pool:
            raise ValueError(
                f"the policy's windows are pooled too: num_teams is a multiple of pool = {self.pool}, "
                f"but got {self.num_teams}"
            )
        if self.ppo.num_mini_batches > self.num_teams:
            raise ValueError(
                f"{self.num_teams} teams make no {self.ppo.num_mini_batches} mini-batches"
            )

    def rounds(self, horizon: int) -> int:
        """How many rounds, if a window has ``horizon`` steps."""
        return math.ceil(self.steps / (self.num_teams * horizon))

    def card(self, layout: Layout) -> TraitCard:
        """The model for states of this layout."""
        return TraitCard(
            tuple((part.name, part.size) for part in layout.parts),
            self.latent,
            self.encoder_units,
            self.pool,
            self.ppo.gamma,
            self.reward,
            self.potential,
            self.policy,
        )


def _check_positive(name: str, value: float, zero: bool) -> None:
    if not (math.isfinite(value) and (value >= 0 if zero else value > 0)):
        least = "a number of at least 0" if zero else "a positive number"
        raise ValueError(f"{name} is {least}, but got {value}")
