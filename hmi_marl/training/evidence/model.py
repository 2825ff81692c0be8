"""The evidence model in torch, and its loss."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from rsl_rl.modules import MLP  # type: ignore[import-untyped]

from hmi_marl.agents.adaptive.evidence_model import DERIVED, EvidenceCard
from hmi_marl.envs.drivers import TRAIT_NAMES
from hmi_marl.training.ppo.models import array_of, layers_of, memory_of

LOOKED_AT = 5
"""Every so manieth turn counts in the loss: neighbouring turns tell nearly the same."""


class Evidence(torch.nn.Module):
    """Encoder and places, the same functions as :class:`EvidenceModel`'s.

    Args:
        card: what they are.
    """

    centre: torch.Tensor
    scale: torch.Tensor

    def __init__(self, card: EvidenceCard) -> None:
        super().__init__()
        self.card = card
        columns, network = card.read_size + DERIVED, card.encoder
        self.register_buffer("centre", torch.zeros(card.read_size))
        self.register_buffer("scale", torch.ones(card.read_size))
        self.memory = torch.nn.GRU(columns, network.rnn_hidden_dim, batch_first=True)
        self.encoder = MLP(
            network.rnn_hidden_dim + columns, card.latent, network.hidden_dims, network.activation
        )
        self.place = MLP(
            len(TRAIT_NAMES), card.latent, card.place.hidden_dims, card.place.activation
        )

    def forward(
        self, turns: torch.Tensor, shown_traits: torch.Tensor, every: int = 1
    ) -> torch.Tensor:
        """Evidence of B drives up to some turns for the B drivers, shape (B, T / every, B).

        Args:
            turns: shape (B, T, columns), T a whole number of segments.
            shown_traits: as :func:`traits_part` shows them, shape (B, 4).
            every: up to how manieth turns it is told.
        """
        batch, steps, columns = turns.shape
        size = self.card.read_size
        read = (turns[..., :size] - self.centre) / self.scale
        x = torch.cat([read, turns[..., size:]], dim=-1).reshape(-1, self.card.segment, columns)
        remembered, _ = self.memory(x)
        each = self.encoder(torch.cat([remembered, x], dim=-1)).reshape(batch, steps, -1)
        return each.cumsum(dim=1)[:, every - 1 :: every] @ self.place(shown_traits).T

    def settle(self, temperature: float, shown_traits: torch.Tensor) -> None:
        """Give so many times the evidence from now on, and put places into units of a population.

        The evidence for one driver over another stays what it is if the same is added to all
        places, or if they are stretched and e_t is shrunk: units are free, and these ones make w a
        good input for what is conditioned on it.

        Args:
            temperature: factor on the evidence.
            shown_traits: of the population, whose places get mean 0 and spread 1; shape (M, 4).
        """
        encoder, place = _last_layer(self.encoder), _last_layer(self.place)
        with torch.no_grad():
            places = self.place(shown_traits)
            middle, spread = places.mean(dim=0), places.std(dim=0).clamp(min=1e-6)
            place.bias.sub_(middle).div_(spread)
            place.weight.div_(spread[:, None])
            encoder.bias.mul_(temperature * spread)
            encoder.weight.mul_(temperature * spread[:, None])

    def loss_at_end(
        self,
        turns: torch.Tensor,
        driving: torch.Tensor,
        shown_traits: torch.Tensor,
        temperatures: torch.Tensor,
    ) -> torch.Tensor:
        """The loss of whole drives alone, if there were so many times the evidence.

        Args:
            turns, driving, shown_traits: as of :meth:`loss`.
            temperatures: shape (S,).

        Returns:
            Shape (S,).
        """
        last = driving.sum(dim=1).clamp(min=1) - 1
        whole = self(turns, shown_traits)[torch.arange(len(turns)), last]  # (B, B)
        told = torch.log_softmax(temperatures[:, None, None] * whole, dim=-1)
        return -torch.diagonal(told, dim1=1, dim2=2).mean(dim=1)

    def loss(
        self, turns: torch.Tensor, driving: torch.Tensor, shown_traits: torch.Tensor
    ) -> torch.Tensor:
        r"""Mean of -log p(who of the B it was | the turns up to now), over every fifth turn.

        A softmax over the drivers of the batch: its optimum is the log likelihood of the turns, up
        to a number that all drivers share (noise-contrastive estimation).

        Args:
            turns, shown_traits: as of :meth:`forward`.
            driving: which turns there were, shape (B, T).
        """
        told = torch.log_softmax(self(turns, shown_traits, LOOKED_AT), dim=-1)
        right = torch.diagonal(told, dim1=0, dim2=2).T  # (B, T / LOOKED_AT)
        return -right[driving[:, LOOKED_AT - 1 :: LOOKED_AT]].mean()

    def weights(self) -> dict[str, NDArray[np.float32]]:
        """By the names of ``card.shapes``."""
        parts = {
            "read": {"centre": array_of(self.centre), "scale": array_of(self.scale)},
            "encoder": layers_of(self.encoder) | memory_of(self.memory),
            "place": layers_of(self.place),
        }
        return {
            f"{part}.{name}": values
            for part, weights in parts.items()
            for name, values in weights.items()
        }


def _last_layer(network: torch.nn.Module) -> torch.nn.Linear:
    return [layer for layer in network.modules() if isinstance(layer, torch.nn.Linear)][-1]
