"""What the learning of an evidence model can be told."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from hmi_marl.agents.adaptive.evidence_model import READS, EvidenceCard
from hmi_marl.agents.learned.network import NetworkConfig
from hmi_marl.checks import check_count
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.streams import check_seed

HMIS = (
    "never",
    "random:0.05",
    "random:0.2",
    "random:0.5",
    "belief:average",
    "belief:lisa",
    "belief:marge",
    "belief:bart",
)
"""Who alerts in the drives that are learned from: the evidence is to hold beside any HMI."""


@dataclass(frozen=True)
class EvidenceSettings:
    """How an evidence model is learned.

    Raises:
        ValueError, TypeError: a value out of its range, by name.
    """

    driver_policy: str = "trained:driver"
    """Who steers: a trained run, or rule or random."""
    hmis: tuple[str, ...] = HMIS
    """Who alerts; each in an equal share of the drives."""
    drives: int = 24_000
    """Episodes to learn from."""
    known: float = 0.4
    """Share of them driven by the drivers with a name; the others' traits are drawn evenly."""
    held_out: float = 0.05
    """Share of the drives that is not learned from, to see how well others are told."""
    updates: int = 2000
    """Gradient steps."""
    batch: int = 256
    """Drives in each."""
    learning_rate: float = 3e-3
    """At the start; it falls to a twentieth along half a cosine."""
    weight_decay: float = 1e-2
    """Of AdamW."""
    latent: int = 16
    """Z, the size of e_t and w."""
    segment: int = 25
    """Turns after which the encoder's memory is emptied."""
    encoder: NetworkConfig = field(default_factory=lambda: NetworkConfig((64,), rnn_hidden_dim=48))
    """From turns to e_t."""
    place: NetworkConfig = field(default_factory=lambda: NetworkConfig((64, 64)))
    """From traits to w."""
    reads: tuple[str, ...] = READS
    """Parts of the vehicle AI's observation that the encoder reads."""
    seed: int = 0
    """Same seed, same weights (on one machine)."""
    threads: int = 1
    """Of the world and of the learner. Does not change who drives how."""
    checkpoint_every: float = 60.0
    """Least time between checkpoints [s]. Does not change results."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "seed", check_seed(self.seed))
        for name in ("drives", "updates", "batch", "threads", "latent", "segment"):
            check_count(name, getattr(self, name))
        if not self.hmis:
            raise ValueError("somebody has to sit in the vehicle AI's seat: name hmis")
        if not 0.0 <= self.known <= 1.0:
            raise ValueError(f"known lies in [0, 1], but got {self.known}")
        if not (math.isfinite(self.learning_rate) and self.learning_rate > 0):
            raise ValueError(f"learning_rate is a positive number, but got {self.learning_rate}")
        if not 0.0 < self.held_out < 1.0:
            raise ValueError(f"held_out lies between 0 and 1, but got {self.held_out}")
        if not (math.isfinite(self.weight_decay) and self.weight_decay >= 0):
            raise ValueError(f"weight_decay is at least 0, but got {self.weight_decay}")
        if not 2 <= self.batch <= self.learned:
            raise ValueError(
                f"batch lies in 2 to {self.learned}, the number of drives to learn from, but got "
                f"{self.batch}"
            )
        if not self.encoder.rnn_hidden_dim:
            raise ValueError(
                "an encoder has a memory of at least one unit: set encoder.rnn_hidden_dim"
            )
        self.card(self.team)

    @property
    def team(self) -> TeamConfig:
        """How the teams are set up; who drives is drawn apart."""
        return TeamConfig(ai_sees_attention=False)

    @property
    def learned(self) -> int:
        """How many drives are learned from."""
        return self.drives - max(2, round(self.held_out * self.drives))

    def card(self, team: TeamConfig) -> EvidenceCard:
        """Of the model that is learned."""
        return EvidenceCard.for_team(
            team,
            self.reads,
            latent=self.latent,
            segment=self.segment,
            encoder=self.encoder,
            place=self.place,
        )
