"""The latent trait model in torch. :mod:`hmi_marl.agents.learned.trait_model` applies it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from rsl_rl.models import MLPModel  # type: ignore[import-untyped]
from rsl_rl.modules import MLP  # type: ignore[import-untyped]
from tensordict import TensorDict
from torch.nn.functional import one_hot

from hmi_marl.agents.learned.network import NetworkConfig
from hmi_marl.agents.learned.trait_model import ACTIONS, EXTRA, PARTS, TraitCard
from hmi_marl.training.ppo.heads import OneAction
from hmi_marl.training.ppo.models import GROUPS, array_of, layers_of, make_critic
from hmi_marl.training.traits.windows import Batch, Units

FIRST_LOG_VARIANCE = -3.0
"""Initial log variance of z: small enough that z depends on its mean, which is random then."""
FORGET_BIAS = 2.0
"""Added to the initial bias of the forget gate, so that evidence adds up over a whole window."""
SMALLEST_SPREAD = 1e-5
"""Added to the standard deviation of the encoder's means, which may all be equal."""
SMALLEST_UNIT = 0.05
"""Least scale of an input, so that rare events are not blown up."""
FORGETTING = 0.05
"""Weight of the current batch in the running averages of the encoder's units."""


class Posterior(NamedTuple):
    """q(z | τ) of P pools; both of shape (P, Z)."""

    mean: torch.Tensor
    log_variance: torch.Tensor

    def sample(self) -> torch.Tensor:
        """Draw z by reparametrisation, so that gradients pass; shape (P, Z)."""
        return self.mean + torch.randn_like(self.mean) * (0.5 * self.log_variance).exp()


class ContextEncoder(torch.nn.Module):
    """q(z | τ): an LSTM over windows, an average over a pool, two linear heads.

    Means are standardised by running averages over the demonstrations (:meth:`units`). The bound
    behind L2 holds for a z of constant entropy; without a fixed scale all z would shrink into one
    point, where L2 is low for any z.
    """

    def __init__(self, card: TraitCard) -> None:
        super().__init__()
        inputs, units = card.encoder_inputs, card.encoder_units
        self.memory = torch.nn.LSTM(inputs, units, batch_first=True)
        self.mean = torch.nn.Linear(units, card.latent)
        self.log_variance = torch.nn.Linear(units, card.latent)
        torch.nn.init.constant_(self.log_variance.bias, FIRST_LOG_VARIANCE)
        with torch.no_grad():
            bias = self.memory.get_parameter("bias_ih_l0")
            bias[units : 2 * units] += FORGET_BIAS
        self.register_buffer("input_centre", torch.zeros(inputs))
        self.register_buffer("input_scale", torch.ones(inputs))
        self.input_centre: torch.Tensor
        self.input_scale: torch.Tensor
        self.register_buffer("centre", torch.zeros(card.latent))
        self.register_buffer("scale", torch.ones(card.latent))
        self.centre: torch.Tensor
        self.scale: torch.Tensor

    def forward(self, x: torch.Tensor, actions: torch.Tensor, length: torch.Tensor) -> Posterior:
        """Return the posterior of P pools of n windows; arguments as for :meth:`read`."""
        return self.posterior(self.read(x, actions, length), self.centre, self.scale)

    @staticmethod
    def inputs(x: torch.Tensor, actions: torch.Tensor) -> torch.Tensor:
        """Do :func:`hmi_marl.agents.learned.trait_model.encoder_inputs` for any leading axes."""
        done = one_hot(actions.clamp_min(0), ACTIONS).to(x.dtype)
        before, since = x[..., -EXTRA : ACTIONS - EXTRA], x[..., ACTIONS - EXTRA :]
        repeated = (before * done).sum(dim=-1, keepdim=True)
        return torch.cat([x, done, repeated * since], dim=-1)

    def standardise_by(self, batch: Batch) -> None:
        """Take the inputs' units from a batch, so that rare events count as much as others."""
        with torch.no_grad():
            steps = torch.arange(batch.situations.shape[2], device=batch.length.device)
            there = steps < batch.length[..., None]
            read = self.inputs(batch.situations, batch.actions)[there]
            self.input_centre.copy_(read.mean(dim=0))
            self.input_scale.copy_(read.std(dim=0).clamp_min(SMALLEST_UNIT))

    def read(self, x: torch.Tensor, actions: torch.Tensor, length: torch.Tensor) -> torch.Tensor:
        """Return the final hidden states of P pools of n windows, averaged over each pool: (P, H).

        Args:
            x: situations, shape (P, n, T, D).
            actions: v_t, shape (P, n, T); those after a window's end are not read.
            length: steps of each window, shape (P, n).
        """
        pools, windows, steps, _ = x.shape
        read = (self.inputs(x, actions) - self.input_centre) / self.input_scale
        hidden, _ = self.memory(read.reshape(pools * windows, steps, -1))
        last = hidden[torch.arange(len(hidden), device=x.device), length.reshape(-1) - 1]
        return last.reshape(pools, windows, -1).mean(dim=1)

    def posterior(
        self, hidden: torch.Tensor, centre: torch.Tensor, scale: torch.Tensor
    ) -> Posterior:
        """Return the posterior of averaged hidden states (P, H), in units of :meth:`units`."""
        return Posterior((self.mean(hidden) - centre) / scale, self.log_variance(hidden))

    def units(self, hidden: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return centre and scale of a batch's raw means, and update their running averages."""
        raw = self.mean(hidden)
        centre, scale = raw.mean(dim=0), raw.std(dim=0) + SMALLEST_SPREAD
        with torch.no_grad():
            self.centre += FORGETTING * (centre - self.centre)
            self.scale += FORGETTING * (scale - self.scale)
        return centre, scale

    def folded(self) -> dict[str, torch.Tensor]:
        """Return the weights with the units of inputs and means folded in, for NumPy."""
        memory = self.memory.get_parameter
        from_inputs = memory("weight_ih_l0") / self.input_scale
        return {
            "encoder.input_weight": from_inputs,
            "encoder.hidden_weight": memory("weight_hh_l0"),
            "encoder.input_bias": memory("bias_ih_l0") - from_inputs @ self.input_centre,
            "encoder.hidden_bias": memory("bias_hh_l0"),
            "mean.weight": self.mean.weight / self.scale[:, None],
            "mean.bias": (self.mean.bias - self.centre) / self.scale,
            "log_variance.weight": self.log_variance.weight,
            "log_variance.bias": self.log_variance.bias,
        }


class Reward(torch.nn.Module):
    """f(s, a, s', z) = g(s, a, z) + γ h(s', z) − h(s, z)."""

    def __init__(self, card: TraitCard) -> None:
        super().__init__()
        self._gamma = card.gamma
        self.reward = _mlp(card, "reward")
        self.potential = _mlp(card, "potential")

    def forward(
        self, x: torch.Tensor, actions: torch.Tensor, after: torch.Tensor, z: torch.Tensor
    ) -> torch.Tensor:
        """Return f of transitions from situations x (B, D) by v_t (B,) to x' (B, D), z (B, Z)."""
        done = one_hot(actions, ACTIONS).to(x.dtype)
        base = self.reward(torch.cat([x, done, z], dim=-1))
        shaping = self._gamma * self.potential(torch.cat([after, z], dim=-1))
        return (base + shaping - self.potential(torch.cat([x, z], dim=-1))).squeeze(-1)


class Discriminator(torch.nn.Module):
    """The context encoder and the reward, which learn together.

    ``width``, shape (Z,), is the log variance with which L2 estimates z from the policy's driving.
    The bound holds for any. A separate one keeps the encoder's uncertainty about people apart from
    that about an untrained policy, which would drown z in noise.
    """

    def __init__(self, card: TraitCard) -> None:
        super().__init__()
        self.encoder = ContextEncoder(card)
        self.reward = Reward(card)
        self.width = torch.nn.Parameter(torch.zeros(card.latent))


def make_policy(card: TraitCard) -> MLPModel:
    """Return π(a | s, z), with a situation and z as inputs."""
    template = TensorDict({"actor": torch.zeros(1, card.inputs("policy"))}, batch_size=[1])
    head = {"class_name": OneAction, "choices": ACTIONS}
    sizes = (template, GROUPS, "actor", 1, card.policy.hidden_dims, card.policy.activation)
    return MLPModel(*sizes, distribution_cfg=head)


def make_value(card: TraitCard) -> MLPModel:
    """Return V(s, z) for the generator."""
    return make_critic(card.inputs("policy"), NetworkConfig((64, 64)))


def log_policy(policy: MLPModel, x: torch.Tensor, z: torch.Tensor) -> torch.Tensor:
    """Return log π(a | s, z) of every action, shape (..., 5)."""
    logits: torch.Tensor = policy.mlp(torch.cat([x, z], dim=-1))
    return torch.log_softmax(logits, dim=-1)


def log_likelihood(policy: MLPModel, batch: Batch, z: torch.Tensor) -> torch.Tensor:
    """Return log π(v_t | s_t, z) of every real step of a batch, given z of its pools, (P, Z)."""
    x, actions = batch.situations, batch.actions
    there = torch.arange(x.shape[2], device=x.device) < batch.length[..., None]
    every = log_policy(policy, x, z[:, None, None].expand(*x.shape[:3], -1))
    return every.gather(3, actions.clamp_min(0)[..., None]).squeeze(3)[there]


def weights_of_model(
    discriminator: Discriminator, policy: MLPModel, units: Units
) -> dict[str, NDArray[np.float32]]:
    """Return all weights by the names of :attr:`TraitCard.shapes`."""
    encoder = discriminator.encoder
    weights = {"state.centre": units.centre, "state.scale": units.scale}
    weights |= {name: array_of(values) for name, values in encoder.folded().items()}
    networks = (discriminator.reward.reward, discriminator.reward.potential, policy.mlp)
    for part, network in zip(PARTS, networks, strict=True):
        for name, values in layers_of(network).items():
            weights[f"{part}.{name}"] = values
    return weights


def _mlp(card: TraitCard, part: str) -> MLP:
    network: NetworkConfig = getattr(card, part)
    return MLP(card.inputs(part), 1, network.hidden_dims, network.activation)
