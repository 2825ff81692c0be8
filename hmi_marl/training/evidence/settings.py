"""Settings of learning an evidence model, in a frozen dataclass that imports no torch."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from hmi_marl.agents.adaptive.evidence_model import READS, EvidenceCard, parts_shown
from hmi_marl.agents.learned.network import NetworkConfig
from hmi_marl.agents.learned.trait_model import TraitModel
from hmi_marl.checks import (
    Checked,
    Count,
    LearningRate,
    OpenShare,
    Seconds,
    Share,
    Threads,
    Units,
    Weight,
)
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.streams import Seed

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
"""HMIs in the drives that are learned from, so that the evidence holds with any HMI."""


@dataclass(frozen=True)
class EvidenceSettings(Checked):
    """Settings of learning an evidence model.

    Raises:
        ValueError, TypeError: a value out of its range, by name.
    """

    driver_policy: str = "trained:driver"
    """Driver policy: a trained run, rule, random, or mixture:NAME,NAME,... of these."""
    hmis: tuple[str, ...] = HMIS
    """HMIs, each in an equal share of the drives."""
    traits: str = "trained:traits-self"
    """Trait model whose encoder is read: a run of ``hmi-marl traits train``, or trained:NAME."""
    drives: Count = 12_000
    """Episodes to learn from."""
    known: Share = 0.25
    """Share of the episodes with one of the named drivers; the other drivers' traits are drawn
    uniformly."""
    held_out: OpenShare = 0.05
    """Share of the episodes that is kept out of the learning, to measure the loss on."""
    updates: Count = 1500
    """Gradient steps."""
    batch: Count = 256
    """Episodes in each gradient step."""
    learning_rate: LearningRate = 3e-3
    """Learning rate at the start; it falls to a twentieth along half a cosine."""
    weight_decay: Weight = 1e-2
    """Weight decay of AdamW."""
    latent: Units = 16
    """Size of e_t and w."""
    reader: NetworkConfig = field(default_factory=lambda: NetworkConfig((64,)))
    """Network from turns to e_t."""
    place: NetworkConfig = field(default_factory=lambda: NetworkConfig((64, 64)))
    """Network from traits to w."""
    expected: NetworkConfig = field(default_factory=lambda: NetworkConfig((64, 64)))
    """Network from traits to the expected z."""
    reads: tuple[str, ...] = READS
    """Parts of the vehicle AI's observation that are read besides the encoder's features."""
    seed: Seed = 0
    """Random seed. The same seed gives the same weights (on one machine)."""
    threads: Threads = 1
    """Threads of the world and of the learner. Does not change the episodes."""
    checkpoint_every: Seconds = 60.0
    """Least time between checkpoints [s]. Does not change results."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.hmis:
            raise ValueError("hmis names at least one HMI, but got none")
        if not 2 <= self.batch <= self.learned:
            raise ValueError(
                f"batch lies in 2 to {self.learned}, the number of drives to learn from, but got "
                f"{self.batch}"
            )
        # Everything that a card refuses, before the trait model is loaded.
        EvidenceCard(parts_shown(self.team, self.reads), "", 1, 1, **self._sizes)

    @property
    def team(self) -> TeamConfig:
        """Configuration of the teams, but for the drivers, which are drawn separately."""
        return TeamConfig(ai_sees_attention=False)

    @property
    def learned(self) -> int:
        """Number of episodes that are learned from."""
        return self.drives - max(2, round(self.held_out * self.drives))

    @property
    def _sizes(self) -> dict[str, Any]:
        return {name: getattr(self, name) for name in ("latent", "reader", "place", "expected")}

    def card(self, team: TeamConfig, traits: TraitModel) -> EvidenceCard:
        """Card of the model for teams of this configuration, and the trait model that it reads."""
        return EvidenceCard.for_team(team, traits, self.reads, **self._sizes)
