"""Losses of two pools of each driver, to compare with that of trait models."""

from __future__ import annotations

import torch

from hmi_marl.training.ablations.design import PairLoss
from hmi_marl.training.traits.losses import (
    contrastive_loss,
    found_again_loss,
    same_driver_loss,
)

MARGIN = 2.0
"""ε of the contrastive loss, as in the paper's settings."""
FIRST_SHARPNESS = {"distance": 1.0, "cosine": 10.0}
"""Inverse temperature at the start."""


class PairLosses(torch.nn.Module):
    """Loss of the pools of P drivers, called as :func:`same_driver_loss` is.

    ``log_sharpness``, the log of the inverse temperature, learns with the encoder where a loss has
    one.
    """

    def __init__(self, name: PairLoss) -> None:
        super().__init__()
        self._name = name
        if name in FIRST_SHARPNESS:
            first = torch.tensor(FIRST_SHARPNESS[name])
            self.log_sharpness = torch.nn.Parameter(first.log())

    def forward(
        self,
        mean: torch.Tensor,
        log_variance: torch.Tensor,
        other_mean: torch.Tensor,
        other_log_variance: torch.Tensor,
    ) -> torch.Tensor:
        """Return the loss, given μ and log σ² of one pool and the other of each, (P, Z)."""
        if self._name == "posteriors":
            return same_driver_loss(mean, log_variance, other_mean, other_log_variance)
        if self._name == "distance":
            scores = -0.5 * ((mean[:, None] - other_mean[None]) ** 2).sum(dim=2)
            return found_again_loss(self.log_sharpness.exp() * scores)
        if self._name == "cosine":
            one, other = (torch.nn.functional.normalize(z, dim=1) for z in (mean, other_mean))
            return found_again_loss(self.log_sharpness.exp() * (one @ other.T))
        if self._name == "balanced-margin":
            return balanced_margin_loss(mean, other_mean, MARGIN)
        who = torch.arange(len(mean), device=mean.device).repeat(2)
        return contrastive_loss(torch.cat([mean, other_mean]), who, MARGIN)


def balanced_margin_loss(
    mean: torch.Tensor, other_mean: torch.Tensor, margin: float
) -> torch.Tensor:
    r"""Return the contrastive loss with pairs of one driver and other pairs weighted alike.

    .. math::
        E_k[\|μ_k - μ'_k\|^2] + E_{k \ne l}[\max(0, ε - \|μ_k - μ'_l\|)^2]

    Args:
        mean, other_mean: μ of one pool and of the other of P drivers, shape (P, Z).
        margin: ε.
    """
    squared = ((mean[:, None] - other_mean[None]) ** 2).sum(dim=2)
    apart = ~torch.eye(len(mean), dtype=torch.bool, device=mean.device)
    # The root's slope is infinite at 0, where equal vectors should have no gradient.
    distance = squared[apart].clamp_min(1e-12).sqrt()
    return squared.diagonal().mean() + ((margin - distance).clamp_min(0.0) ** 2).mean()
