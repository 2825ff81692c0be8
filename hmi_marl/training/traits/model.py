"""The latent trait model in torch. :mod:`hmi_marl.agents.learned.trait_model` applies it."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from rsl_rl.models import MLPModel  # type: ignore[import-untyped]
from rsl_rl.modules import MLP  # type: ignore[import-untyped]
from tensordict import TensorDict
from torch.nn.functional import one_hot

from hmi_marl.agents.learned.network import NetworkConfig
from hmi_marl.agents.learned.situations import ACTIONS
from hmi_marl.agents.learned.trait_model import PARTS, TraitCard
from hmi_marl.training.ppo.heads import OneAction
from hmi_marl.training.ppo.models import GROUPS, layers_of, make_critic
from hmi_marl.training.traits.encoder import ContextEncoder
from hmi_marl.training.traits.episodes import Units
from hmi_marl.training.traits.windows import Batch


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
    encoder: ContextEncoder, reward: Reward, policy: MLPModel, units: Units
) -> dict[str, NDArray[np.float32]]:
    """Return all weights by the names of :attr:`TraitCard.shapes`."""
    weights = {"state.centre": units.centre, "state.scale": units.scale}
    weights |= encoder.arrays()
    networks = (reward.reward, reward.potential, policy.mlp)
    for part, network in zip(PARTS, networks, strict=True):
        for name, values in layers_of(network).items():
            weights[f"{part}.{name}"] = values
    return weights


def _mlp(card: TraitCard, part: str) -> MLP:
    network: NetworkConfig = getattr(card, part)
    return MLP(card.inputs(part), 1, network.hidden_dims, network.activation)
