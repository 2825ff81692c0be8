"""One HMI for a whole population, π(a^A | a^H, s, z), with z from an evidence model."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hmi_marl.agents.adaptive.evidence_model import EvidenceModel, load_evidence
from hmi_marl.envs.drivers import PAPER_DRIVERS, TraitDistributions, Traits
from hmi_marl.envs.streams import Stream, mix
from hmi_marl.training.protocols.settings import PPOSettings
from hmi_marl.training.protocols.two_stage import TwoStage

if TYPE_CHECKING:
    import torch

HMI_READS = ("intended_action", "previous_intended_action", "applied_action", "alerted", "time")
"""Observation parts that carry information on attention; lidar and lanes do not."""
HIDDEN_PPO = PPOSettings(learning_rate=2e-3, num_mini_batches=8)
"""PPO for recurrent HMIs."""
_DECIMALS = 3


class Places:
    """:class:`Context` that maps a driver's traits θ to w(θ) of an evidence model."""

    def __init__(self, model: EvidenceModel) -> None:
        self._model = model
        self.size = model.card.latent
        self.digest = model.digest

    def __call__(self, traits: torch.Tensor) -> torch.Tensor:
        """See :class:`Context`."""
        places = self._model.places(Traits.from_array(traits.cpu().numpy()))
        return traits.new_tensor(places)


def strangers(count: int, seed: int) -> tuple[str, ...]:
    """Return drivers with uniformly drawn traits, in the form of the command line."""
    seeds = mix(seed, Stream.TRAITS, np.arange(count, dtype=np.uint64))
    drawn = TraitDistributions().draw(seeds).as_array().round(_DECIMALS)
    return tuple(
        f"stranger-{number}:" + ",".join(f"{value:g}" for value in traits)
        for number, traits in enumerate(drawn)
    )


def conditioned_hmi(
    driver_policy: str,
    hmi_steps: int,
    rnn_hidden_dim: int,
    num_teams: int,
    seed: int,
    others: int = 512,
) -> TwoStage:
    """Return settings of an HMI with hidden attention for named and uniformly drawn drivers.

    To be trained with ``train(..., context=Places(model))``.

    Args:
        driver_policy: driver policy.
        hmi_steps: environment steps to learn from.
        rnn_hidden_dim: recurrent units of the HMI.
        num_teams: teams in parallel.
        seed: seed of the training and of the drawn traits.
        others: number of drawn drivers; the four named ones drive in a third of the episodes.
    """
    types = PAPER_DRIVERS * max(1, others // 2 // len(PAPER_DRIVERS))
    return TwoStage(
        drivers=types + strangers(others, seed),
        driver_policy=driver_policy,
        hmi_steps=hmi_steps,
        ai_sees_attention=False,
        rnn_hidden_dim=rnn_hidden_dim,
        hmi_reads=HMI_READS,
        hmi_reward="attention",
        ppo=HIDDEN_PPO,
        num_teams=num_teams,
        seed=seed,
    )


def learn_conditioned(
    settings: TwoStage, evidence: Path, folder: Path, command_line: str = "", line: int = 0
) -> None:
    """Train such an HMI in ``folder``, with z from the evidence model of another run.

    Raises:
        FileNotFoundError, ValueError: there is no evidence model, or :func:`train` raised it.
    """
    from hmi_marl.training.ppo.run import train  # torch, with the threads that were set by then

    train(settings, folder, Places(load_evidence(evidence)), command_line=command_line, line=line)
