"""The anchor of protocols in which the driver learns together with the HMI."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from hmi_marl.agents.catalogue import is_learned
from hmi_marl.agents.learned.policy import LearnedPolicy, load_policy
from hmi_marl.checks import Weight, shown
from hmi_marl.envs.config import DRIVER, TeamConfig
from hmi_marl.training.protocols.settings import TrainSettings

OWN_DRIVER = "first-stage"
"""Anchor of :class:`FineTune`: the driver of its own first stage."""


@dataclass(frozen=True)
class Anchored(TrainSettings):
    """Settings of protocols whose driver may be held close to a given one while both learn.

    Raises:
        ValueError: ``anchor_kl`` without an anchor.
    """

    anchor: str | None = None
    """Learned driver policy that the driver is held close to while both learn: a trained run, or
    trained:NAME. The driver does not start from it."""
    anchor_kl: Weight = 0.0
    """Weight λ of KL(driver || anchor), in nats per step, in the driver's loss: human-regularised
    PPO. 0 only records the divergence, as anchor_kl in the curve."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.anchor is None and self.anchor_kl:
            raise ValueError(
                f"anchor_kl = {self.anchor_kl:g} needs an anchor, such as --anchor trained:driver"
            )

    @property
    def anchored(self) -> dict[str, Any]:
        """Fields of a phase in which the driver is held close to the anchor."""
        return {"anchor": self.anchor, "anchor_kl": self.anchor_kl}


def load_anchor(name: str, config: TeamConfig) -> LearnedPolicy:
    """Load the driver policy of this name as an anchor, for teams set up by ``config``.

    Raises:
        FileNotFoundError, ValueError: it is no learned driver policy, or one with a memory, or it
            reads what the driver does not observe in these teams.
    """
    if not is_learned(name, DRIVER):
        raise ValueError(
            f"anchor is a learned driver policy, the folder of a run or trained:NAME, not "
            f"{shown(name)}"
        )
    policy = load_policy(name, DRIVER, config)
    if policy.card.network.rnn_hidden_dim or policy.card.context:
        raise ValueError(f"anchor {name} has a memory or reads a vector z; use one without")
    return policy
