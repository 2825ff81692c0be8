r"""The HMI that is conditioned on z, in torch, and its loss.

With A_t the advantage of alerting, by the exact rules of the drivers who may be at the wheel,
that is expected under the belief of the estimator, and ℓ_t the log odds of an alert by the HMI,
which reads only mean and standard deviation of z under that belief, the loss is

.. math:: E\left[ |A_t| \log(1 + e^{-\mathrm{sign}(A_t)\, ℓ_t}) \right]

It weighs each step by what is at stake. An HMI that minimises it alerts with more than even odds
exactly where the advantage that is expected, given all that it has read, is positive: it comes
close to :class:`ExpectedValueHMI` without caution, which knows the whole belief. 1 / log 2 times
the loss is an upper bound of what it loses against that HMI per step, by the advantages' own
account. The advantage for the driver at the wheel alone has the same expectation if the belief is
right, but varies more from trip to trip.
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from rsl_rl.modules import MLP  # type: ignore[import-untyped]

from hmi_marl.agents.learned.policy import PolicyCard
from hmi_marl.training.ppo.models import layers_of, memory_of


class Student(torch.nn.Module):
    """A recurrent HMI over whole trips.

    Args:
        card: its card, of a recurrent network with two outputs.
    """

    def __init__(self, card: PolicyCard) -> None:
        super().__init__()
        network, inputs = card.network, card.inputs
        self.memory = torch.nn.GRU(inputs, network.rnn_hidden_dim, batch_first=True)
        self.layers = MLP(
            network.rnn_hidden_dim + inputs, card.outputs, network.hidden_dims, network.activation
        )

    def forward(self, inputs: torch.Tensor) -> torch.Tensor:
        """Return the log odds of an alert, (B, T), for B trips from their start, (B, T, inputs)."""
        remembered, _ = self.memory(inputs)
        logits: torch.Tensor = self.layers(torch.cat([remembered, inputs], dim=-1))
        return logits[..., 1] - logits[..., 0]

    def loss(
        self, inputs: torch.Tensor, advantage: torch.Tensor, driving: torch.Tensor
    ) -> torch.Tensor:
        """Return the loss per step; see the module.

        Args:
            inputs: inputs of B trips, shape (B, T, inputs).
            advantage: A_t, shape (B, T).
            driving: whether the trip was still going on, shape (B, T).
        """
        odds = self(inputs)
        missed = torch.nn.functional.softplus(-torch.sign(advantage) * odds)
        return (advantage.abs() * missed)[driving].mean()

    def weights(self) -> dict[str, NDArray[np.float32]]:
        """Return the weights by the names of :meth:`NetworkConfig.shapes`."""
        return layers_of(self.layers) | memory_of(self.memory)
