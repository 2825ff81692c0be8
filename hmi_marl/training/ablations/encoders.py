"""Encoders of other designs than that of trait models."""

from __future__ import annotations

import torch

from hmi_marl.agents.learned.situations import ACTIONS, EXTRA
from hmi_marl.agents.learned.trait_encoder import BEHAVIOUR
from hmi_marl.agents.learned.trait_model import TraitCard
from hmi_marl.training.ablations.design import EncoderDesign
from hmi_marl.training.ablations.losses import PairLosses
from hmi_marl.training.traits.encoder import ContextEncoder, real_steps

_LIKELIHOODS = slice(BEHAVIOUR - 2, BEHAVIOUR)
"""Columns of b_t: how likely v_t and v_{t-1} are for the average driver."""


class DesignedEncoder(ContextEncoder):
    """A context encoder of any design, and the loss that it learns from.

    With the design of trait models it does what :class:`ContextEncoder` does. ``sums`` holds the
    summary of every window times its steps, so that pools are means over their windows, weighted by
    their steps, whatever the pooling over time.
    """

    def __init__(self, card: TraitCard, design: EncoderDesign) -> None:
        super().__init__(card)
        self.design = design
        self.pair_loss = PairLosses(design.loss)
        if design.pooling == "last-state":
            sizes = card.encoder
            self.recurrent = torch.nn.GRU(sizes.step_features, sizes.features, batch_first=True)

    def log_average(self, x: torch.Tensor) -> torch.Tensor:
        """See :meth:`ContextEncoder.log_average`."""
        return super().log_average(self._seen(x))

    def behaviour(self, x: torch.Tensor, actions: torch.Tensor) -> torch.Tensor:
        """See :meth:`ContextEncoder.behaviour`; columns that are no inputs are 0."""
        columns = super().behaviour(self._seen(x), actions)
        if self.design.inputs == "state-alone":
            return torch.zeros_like(columns)
        if self.design.inputs in ("no-average", "actions-and-alerts"):
            columns[..., _LIKELIHOODS] = 0.0
        return columns

    def observed(self, x: torch.Tensor) -> torch.Tensor:
        """See :meth:`ContextEncoder.observed`; zeros if the state is no input."""
        state = super().observed(x)
        hidden = self.design.inputs in ("no-state", "actions-and-alerts")
        return torch.zeros_like(state) if hidden else state

    def over_time(self, each: torch.Tensor, length: torch.Tensor) -> torch.Tensor:
        """See :meth:`ContextEncoder.over_time`."""
        if self.design.pooling == "mean":
            return super().over_time(each, length)
        if self.design.pooling == "maximum":
            there = real_steps(each, length)[:, None]
            summary = (self.spans(each) * there).amax(dim=2)  # features are 0 or more
        else:
            states, _ = self.recurrent(each)
            summary = states[torch.arange(len(each), device=each.device), length - 1]
        return summary * length[:, None]

    def _seen(self, x: torch.Tensor) -> torch.Tensor:
        """Return situations as the design has them."""
        if self.design.inputs != "no-alert-time":
            return x
        x = x.clone()
        since = x[..., x.shape[-1] - EXTRA + ACTIONS :]
        since[...] = 0.0
        since[..., -1] = 1.0  # long ago
        return x
