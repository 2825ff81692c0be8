"""The evidence model in torch, and its loss."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from rsl_rl.modules import MLP  # type: ignore[import-untyped]

from hmi_marl.agents.adaptive.evidence_model import EvidenceCard
from hmi_marl.agents.learned.network import NetworkConfig
from hmi_marl.envs.drivers import TRAIT_NAMES
from hmi_marl.training.ppo.models import array_of, layers_of

LOSS_EVERY = 5
"""Turns between those that enter the loss, as neighbouring turns carry almost the same evidence."""


class EvidenceNetwork(torch.nn.Module):
    """Networks of :class:`EvidenceModel`: from turns to e_t, from traits to w and to expected z.

    Args:
        card: card of the model.
    """

    centre: torch.Tensor
    scale: torch.Tensor

    def __init__(self, card: EvidenceCard) -> None:
        super().__init__()
        self.card = card
        self.register_buffer("centre", torch.zeros(card.standardised))
        self.register_buffer("scale", torch.ones(card.standardised))
        self.reader = _mlp(card.inputs, card.latent, card.reader)
        self.place = _mlp(len(TRAIT_NAMES), card.latent, card.place)
        self.expected = _mlp(len(TRAIT_NAMES), card.context, card.expected)

    def forward(
        self, turns: torch.Tensor, shown_traits: torch.Tensor, every: int = 1
    ) -> torch.Tensor:
        """Return the evidence of B drives for the B drivers, shape (B, T / every, B).

        Args:
            turns: turns of the drives, shape (B, T, inputs).
            shown_traits: the drivers' traits, scaled by :func:`traits_part`, shape (B, 4).
            every: evidence up to every such turn is returned.
        """
        size = self.card.standardised
        read = (turns[..., :size] - self.centre) / self.scale
        each = self.reader(torch.cat([read, turns[..., size:]], dim=-1))
        return each.cumsum(dim=1)[:, every - 1 :: every] @ self.place(shown_traits).T

    def settle(self, temperature: float, shown_traits: torch.Tensor) -> None:
        """Scale the evidence, and standardise w over a population.

        The evidence for one driver over another does not change if the same vector is added to all
        w, or if w is stretched and e_t is shrunk.

        Args:
            temperature: factor on the evidence.
            shown_traits: traits of the population over which w gets mean 0 and standard deviation
                1; shape (M, 4).
        """
        reader, place = _last_layer(self.reader), _last_layer(self.place)
        with torch.no_grad():
            places = self.place(shown_traits)
            middle, spread = places.mean(dim=0), places.std(dim=0).clamp(min=1e-6)
            place.bias.sub_(middle).div_(spread)
            place.weight.div_(spread[:, None])
            reader.bias.mul_(temperature * spread)
            reader.weight.mul_(temperature * spread[:, None])

    def loss_at_end(
        self,
        turns: torch.Tensor,
        driving: torch.Tensor,
        shown_traits: torch.Tensor,
        temperatures: torch.Tensor,
    ) -> torch.Tensor:
        """Return the loss after whole drives, for several factors on the evidence.

        Args:
            turns, driving, shown_traits: see :meth:`loss`.
            temperatures: factors, shape (S,).

        Returns:
            Losses, shape (S,).
        """
        last = driving.sum(dim=1).clamp(min=1) - 1
        whole = self(turns, shown_traits)[torch.arange(len(turns)), last]  # (B, B)
        log_posterior = torch.log_softmax(temperatures[:, None, None] * whole, dim=-1)
        return -torch.diagonal(log_posterior, dim1=1, dim2=2).mean(dim=1)

    def loss(
        self, turns: torch.Tensor, driving: torch.Tensor, shown_traits: torch.Tensor
    ) -> torch.Tensor:
        r"""Return the mean of -log p(driver | the turns up to now), over every fifth turn.

        This is a softmax over the drivers of the batch: its optimum is the log likelihood of the
        turns up to a constant that all drivers share (noise-contrastive estimation).

        Args:
            turns, shown_traits: see :meth:`forward`.
            driving: whether a turn is real, shape (B, T).
        """
        log_posterior = torch.log_softmax(self(turns, shown_traits, LOSS_EVERY), dim=-1)
        right = torch.diagonal(log_posterior, dim1=0, dim2=2).T  # (B, T / LOSS_EVERY)
        return -right[driving[:, LOSS_EVERY - 1 :: LOSS_EVERY]].mean()

    def expected_loss(self, z: torch.Tensor, shown_traits: torch.Tensor) -> torch.Tensor:
        """Return the mean squared error of the expected z, given z of B drives, shape (B, Z)."""
        return (self.expected(shown_traits) - z).square().mean()

    def weights(self) -> dict[str, NDArray[np.float32]]:
        """Return the weights by the names of ``card.shapes``."""
        parts = {
            "read": {"centre": array_of(self.centre), "scale": array_of(self.scale)},
            "reader": layers_of(self.reader),
            "place": layers_of(self.place),
            "expected": layers_of(self.expected),
        }
        return {
            f"{part}.{name}": values
            for part, weights in parts.items()
            for name, values in weights.items()
        }


def _mlp(inputs: int, outputs: int, network: NetworkConfig) -> MLP:
    return MLP(inputs, outputs, network.hidden_dims, network.activation)


def _last_layer(network: torch.nn.Module) -> torch.nn.Linear:
    return [layer for layer in network.modules() if isinstance(layer, torch.nn.Linear)][-1]
