"""Settings of learning latent traits, in frozen dataclasses that import no torch."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Annotated, Literal

from hmi_marl.agents.learned.network import NetworkConfig
from hmi_marl.agents.learned.trait_encoder import EncoderConfig
from hmi_marl.agents.learned.trait_model import TraitCard
from hmi_marl.checks import (
    Checked,
    Count,
    CountOrZero,
    Device,
    Factor,
    LearningRate,
    Real,
    Seconds,
    Share,
    Steps,
    Threads,
    Units,
    Weight,
    Whole,
    check_mini_batches,
)
from hmi_marl.envs.observations import Layout
from hmi_marl.envs.streams import Seed
from hmi_marl.training.protocols.settings import PPOSettings

Supervision = Literal["self", "none", "id", "preference"]
LABELLED: tuple[Supervision, ...] = ("id", "preference")
"""Settings in which some windows have labels."""
PAPER_HELD_OUT = 0.2
"""Share of windows that the paper's settings hold out by default."""
PAPER_IMITATION = 600
"""Updates of imitation before the policy drives in the paper's settings by default."""
PAPER_LATENT, SELF_LATENT = 2, 8
"""Sizes of z by default: in the paper's settings, and in the self-supervised one."""


@dataclass(frozen=True)
class LossWeights(Checked):
    """Weights of the losses in the paper's loss table, and of imitation in the encoder.

    Raises:
        ValueError: a weight below 0, or not finite.
    """

    reconstruct: Weight = 1.0
    """Weight of L1, the adversarial loss."""
    information: Weight = 5.0
    """Weight of L2, the information loss."""
    contrast: Weight = 10.0
    """Weight of L3, the contrastive loss."""
    regularise: Weight = 1e-4
    """Weight of L4, the regularisation."""
    cohesion: Weight = 0.0
    """Weight of the squared distance between pools of one driver, labelled or not, which is not in
    the paper."""
    imitate: Weight = 0.0
    """Weight of −log π(a | s, z) on demonstrations in the encoder, which is not in the paper. The
    policy always learns from it: a random policy would crash at once and leave the discriminator
    nothing to compare. With 1 the encoder also learns the part of z that the policy can use."""

    def by_loss(self) -> dict[str, float]:
        """Weights by the names of the losses."""
        return {
            "L1": self.reconstruct,
            "L2": self.information,
            "L3": self.contrast,
            "L4": self.regularise,
            "cohesion": self.cohesion,
            "imitation": 1.0,
        }


@dataclass(frozen=True)
class TraitSettings(Checked):
    """Settings of learning latent traits from demonstrations.

    Raises:
        ValueError, TypeError: a value out of its range, saying what to use instead.
    """

    supervision: Supervision = "self"
    """How the encoder learns. In the paper's settings, from adversarial IRL, with labels of some
    windows: none, the driver (id), or the driver's wish for help (preference). Self-supervised
    (self), from which windows are of one driver, which takes many drivers; adversarial IRL then
    leaves the encoder as it is."""
    labelled: Annotated[float, Real(0.0, 1.0, above=True)] = 0.2
    """Share of each driver's windows that is labelled."""
    label_bandwidth: Annotated[float, Real(1e-6, 1e6, or_zero=True)] = 0.0
    """Bandwidth of the Gaussian by which graded labels count as similar, in units of the labels; 0
    if labels are only equal or different."""
    margin: Factor = 2.0
    """Margin ε of L3: least distance between latent vectors of different labels."""
    held_out: Annotated[float, Real(0.0, 1.0, below=True)] | None = None
    """Share of each driver's windows, the last ones, that is kept out of the learning; by default
    0.2, or 0 if self-supervised, which is judged by drivers who are kept out altogether."""
    latent: Units | None = None
    """Size of z; by default 8 if self-supervised, else 2 as in the paper."""
    pool: Count = 8
    """Windows of one driver that are pooled."""
    encoder: EncoderConfig = field(default_factory=EncoderConfig)
    """Sizes of the context encoder."""
    average_updates: CountOrZero = 300
    """Updates at the start, in which the average driver's policy is learned by imitation. The
    encoder reads how likely actions are under it."""
    encoder_updates: CountOrZero = 600
    """Updates after that in which the encoder learns if self-supervised."""
    drivers_per_update: Annotated[int, Whole(2, 100_000)] = 64
    """Drivers in each of these updates, with two pools each."""
    encoder_rate: LearningRate = 2e-3
    """Learning rate of these updates at the start; it falls to a twentieth along half a cosine."""
    weight_decay: Weight = 1e-2
    """Weight decay in these updates."""
    imitation_updates: CountOrZero | None = None
    """Updates before the policy drives, in which the policy learns by imitation and the encoder
    from the losses that need no driving by the policy. By default 600; or 0 if self-supervised,
    where the encoder learns nothing from them, and the reward learns what bad driving is from a
    policy that cannot drive yet (it goes on to imitate in every round)."""
    steps: Steps = 1_000_000
    """Environment steps of the policy, rounded up to whole rounds."""
    num_teams: Count = 64
    """Cars that the policy drives in a round, one window each. The cars of a pool share one z."""
    expert_pools: Count = 16
    """Pools of demonstrations in each update of the discriminator, in pairs of one driver."""
    labelled_pools: Annotated[int, Whole(2, 1_000_000)] = 16
    """Labelled pools in each update, if there are labels; L3 compares them."""
    updates: Count = 2
    """Updates of the discriminator in each round."""
    settling: Share = 0.06
    """Share of the rounds, at the start, in which only the discriminator learns."""
    learning_rate: LearningRate = 5e-4
    """Learning rate of the discriminator."""
    imitation_rate: LearningRate = 5e-3
    """Learning rate of the policy's imitation."""
    weights: LossWeights = field(default_factory=LossWeights)
    """Weights of the losses."""
    information_reward: Weight = 0.0
    """Weight of log q(z | τ) in the policy's reward, in equal parts over a window's steps, as in
    InfoGAIL and PEMIRL: the policy is then paid for driving from which z can be inferred. The paper
    has the information term in the encoder's loss alone."""
    reward: NetworkConfig = field(default_factory=lambda: NetworkConfig((32, 32)))
    """Network of the base reward g."""
    potential: NetworkConfig = field(default_factory=lambda: NetworkConfig((32,)))
    """Network of the potential h."""
    policy: NetworkConfig = field(default_factory=lambda: NetworkConfig((32,)))
    """Network of the policy π."""
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
    """Settings of the policy's PPO. Its reward f − log π already contains the entropy."""
    seed: Seed = 0
    """Random seed. The same seed and demonstrations give the same weights (on one machine)."""
    device: Device = "auto"
    """Device of the learner: cpu, cuda, or auto for a GPU if there is one."""
    threads: Threads = 1
    """Threads of the world and of the learner."""
    checkpoint_every: Seconds = 60.0
    """Least time between checkpoints [s]. Does not change results."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.label_bandwidth and self.supervision == "id":
            raise ValueError(
                f"label_bandwidth = {self.label_bandwidth} is for graded labels, but drivers are "
                "not graded; set it to 0, or supervision to preference"
            )
        if self.expert_pools % 2:
            raise ValueError(f"expert_pools is an even number, but got {self.expert_pools}")
        if self.num_teams % self.pool:
            raise ValueError(
                f"num_teams is a multiple of pool = {self.pool}, since the policy's windows are "
                f"pooled too, but got {self.num_teams}"
            )
        check_mini_batches(self.ppo.num_mini_batches, self.num_teams)

    @property
    def fixed_encoder(self) -> bool:
        """Whether the encoder stays as it is in adversarial IRL."""
        return self.supervision == "self"

    @property
    def held_out_share(self) -> float:
        """Share of each driver's windows that is kept out of the learning."""
        if self.held_out is not None:
            return self.held_out
        return 0.0 if self.supervision == "self" else PAPER_HELD_OUT

    @property
    def imitation(self) -> int:
        """Updates of imitation before the policy drives."""
        if self.imitation_updates is not None:
            return self.imitation_updates
        return 0 if self.supervision == "self" else PAPER_IMITATION

    @property
    def latent_size(self) -> int:
        """Z, the size of z."""
        return self.latent or (SELF_LATENT if self.supervision == "self" else PAPER_LATENT)

    def rounds(self, horizon: int) -> int:
        """Number of rounds, for windows of ``horizon`` steps."""
        return math.ceil(self.steps / (self.num_teams * horizon))

    def card(self, layout: Layout) -> TraitCard:
        """Card of the model for states of this layout."""
        return TraitCard(
            tuple((part.name, part.size) for part in layout.parts),
            self.latent_size,
            self.encoder,
            self.pool,
            self.ppo.gamma,
            self.reward,
            self.potential,
            self.policy,
        )
