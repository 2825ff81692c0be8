"""The context encoder in torch. :mod:`hmi_marl.agents.learned.trait_encoder` applies it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from rsl_rl.modules import MLP  # type: ignore[import-untyped]
from torch.nn.functional import one_hot, pad

from hmi_marl.agents.learned.situations import ACTIONS, EXTRA
from hmi_marl.agents.learned.trait_encoder import BEHAVIOUR, COUNT_SCALE, LEAST_LOG
from hmi_marl.agents.learned.trait_model import TraitCard
from hmi_marl.training.ppo.models import array_of, layers_of
from hmi_marl.training.traits.windows import Batch

FIRST_LOG_VARIANCE = -2.0
"""Log variance of z at the start: small enough that z depends on its mean, which is random then."""
SMALLEST_SPREAD = 1e-5
"""Added to the standard deviation of the encoder's means, which may all be equal."""
FORGETTING = 0.05
"""Weight of the current batch in the running averages of the means' units."""


def real_steps(each: torch.Tensor, length: torch.Tensor) -> torch.Tensor:
    """Mark the steps before the end of windows (N, T, .) of these lengths (N,); shape (N, T)."""
    return torch.arange(each.shape[1], device=each.device) < length[:, None]


class Posterior(NamedTuple):
    """q(z | τ) of P pools; both of shape (P, Z)."""

    mean: torch.Tensor
    log_variance: torch.Tensor

    def sample(self) -> torch.Tensor:
        """Draw z by reparametrisation, so that gradients pass; shape (P, Z)."""
        return self.mean + torch.randn_like(self.mean) * (0.5 * self.log_variance).exp()


class ContextEncoder(torch.nn.Module):
    """q(z | τ): features of some steps each, averaged over all steps of a pool, and a network.

    Means are standardised by running averages over the demonstrations (:meth:`units`). The bound
    behind L2 holds for a z of constant entropy; without a fixed scale all z would shrink into one
    point, where L2 is low for any z.
    """

    centre: torch.Tensor
    scale: torch.Tensor

    def __init__(self, card: TraitCard) -> None:
        super().__init__()
        sizes, self.latent = card.encoder, card.latent
        self.average = MLP(
            card.situation_size, ACTIONS, sizes.average.hidden_dims, sizes.average.activation
        )
        """π(a | s) of the average driver."""
        self.state_layer = torch.nn.Linear(card.state_size, sizes.state_features)
        self.step_layer = torch.nn.Linear(BEHAVIOUR + sizes.state_features, sizes.step_features)
        self.span_layer = torch.nn.Conv1d(sizes.step_features, sizes.features, sizes.span)
        self.head = MLP(
            sizes.features + 1, 2 * card.latent, sizes.head.hidden_dims, sizes.head.activation
        )
        self._hidden = sizes.head.hidden_dims
        with torch.no_grad():
            self.head[-1].bias[card.latent :] += FIRST_LOG_VARIANCE
        self.register_buffer("centre", torch.zeros(card.latent))
        self.register_buffer("scale", torch.ones(card.latent))

    def forward(self, batch: Batch) -> Posterior:
        """Return the posterior of P pools."""
        return self.posterior(self.sums(batch).sum(dim=1), self.centre, self.scale)

    def learning(self) -> list[torch.nn.Parameter]:
        """Return the parameters but those of the average driver, who learns by imitation alone."""
        own = {id(weight) for weight in self.average.parameters()}
        return [weight for weight in self.parameters() if id(weight) not in own]

    def log_average(self, x: torch.Tensor) -> torch.Tensor:
        """Return log π(a | s) of the average driver in situations (..., D + EXTRA): (..., 5)."""
        return torch.log_softmax(self.average(x), dim=-1)

    def behaviour(self, x: torch.Tensor, actions: torch.Tensor) -> torch.Tensor:
        """Do :func:`hmi_marl.agents.learned.trait_encoder.behaviour` for any leading axes."""
        extra = x[..., -EXTRA:]
        before, since = extra[..., :ACTIONS], extra[..., ACTIONS:]
        done = one_hot(actions.clamp_min(0), ACTIONS).to(x.dtype)
        repeated = (before * done).sum(dim=-1, keepdim=True)
        with torch.no_grad():
            likely = self.log_average(x).clamp_min(LEAST_LOG)
        both = [(likely * which).sum(dim=-1, keepdim=True) for which in (done, before)]
        return torch.cat([extra, done, repeated * since, *both], dim=-1)

    def observed(self, x: torch.Tensor) -> torch.Tensor:
        """Return features of the observed states of situations (..., D + EXTRA)."""
        return torch.relu(self.state_layer(x[..., :-EXTRA]))

    def sums(self, batch: Batch) -> torch.Tensor:
        """Return features summed over the steps of each window, and their number: (P, n, F + 1)."""
        x, actions, length = batch
        pools, windows, steps, _ = x.shape
        read = [self.behaviour(x, actions), self.observed(x)]
        each = torch.relu(self.step_layer(torch.cat(read, dim=-1)))
        total = self.over_time(each.reshape(pools * windows, steps, -1), length.reshape(-1))
        count = length.reshape(-1, 1).to(x.dtype)
        return torch.cat([total, count], dim=1).reshape(pools, windows, -1)

    def over_time(self, each: torch.Tensor, length: torch.Tensor) -> torch.Tensor:
        """Return features summed over the steps of windows, shape (N, F).

        Args:
            each: features of every step, shape (N, T, step_features).
            length: steps of each window, shape (N,).
        """
        return (self.spans(each) * real_steps(each, length)[:, None]).sum(dim=2)

    def spans(self, each: torch.Tensor) -> torch.Tensor:
        """Return features of some steps each, (N, F, T), given those of every step (N, T, .)."""
        (span,) = self.span_layer.kernel_size
        return torch.relu(self.span_layer(pad(each.transpose(1, 2), (span - 1, 0))))

    def raw(self, sums: torch.Tensor) -> Posterior:
        """Return the posterior of pools, given their sums (P, F + 1), before :meth:`units`."""
        steps = sums[:, -1:]
        read = torch.cat([sums[:, :-1] / steps, COUNT_SCALE * steps.log()], dim=1)
        mean, log_variance = self.head(read).split(self.latent, dim=1)
        return Posterior(mean, log_variance)

    def posterior(self, sums: torch.Tensor, centre: torch.Tensor, scale: torch.Tensor) -> Posterior:
        """Return the posterior of pools, given their sums (P, F + 1), in units of :meth:`units`."""
        mean, log_variance = self.raw(sums)
        return Posterior((mean - centre) / scale, log_variance)

    def prepare(self, batch: Batch) -> None:
        """Take the units of the means from a batch of demonstrations."""
        with torch.no_grad():
            raw = self.raw(self.sums(batch).sum(dim=1)).mean
            self.centre.copy_(raw.mean(dim=0))
            self.scale.copy_(raw.std(dim=0) + SMALLEST_SPREAD)

    def units(self, sums: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return centre and scale of a batch's raw means, and update their running averages."""
        raw = self.raw(sums).mean
        centre, scale = raw.mean(dim=0), raw.std(dim=0) + SMALLEST_SPREAD
        with torch.no_grad():
            self.centre += FORGETTING * (centre - self.centre)
            self.scale += FORGETTING * (scale - self.scale)
        return centre, scale

    def arrays(self) -> dict[str, NDArray[np.float32]]:
        """Return the weights by the names of :meth:`EncoderConfig.shapes`, the units folded in."""
        found = {}
        for name in ("state_layer", "step_layer", "span_layer"):
            layer = getattr(self, name)
            found[f"{name}.weight"], found[f"{name}.bias"] = map(
                array_of, (layer.weight, layer.bias)
            )
        # From the oldest step first, on the last axis, to the newest step first, on the first.
        found["span_layer.weight"] = found["span_layer.weight"].transpose(2, 0, 1)[::-1].copy()
        for part in ("head", "average"):
            layers = layers_of(getattr(self, part))
            found |= {f"{part}.{name}": values for name, values in layers.items()}
        last = f"head.layer{len(self._hidden)}"
        centre, scale = array_of(self.centre), array_of(self.scale)
        weight, bias = found[f"{last}.weight"], found[f"{last}.bias"]
        weight[: self.latent] /= scale[:, None]
        bias[: self.latent] = (bias[: self.latent] - centre) / scale
        return {f"encoder.{name}": values for name, values in found.items()}
