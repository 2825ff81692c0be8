"""The discriminator: the context encoder and the reward learn together, against a frozen policy."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import torch
from rsl_rl.models import MLPModel  # type: ignore[import-untyped]
from torch.optim.swa_utils import AveragedModel

from hmi_marl.agents.learned.trait_model import TraitCard
from hmi_marl.training.runs.divergence import check_finite
from hmi_marl.training.runs.run import flat_moments, with_moments
from hmi_marl.training.traits.encoder import Posterior
from hmi_marl.training.traits.losses import (
    adversarial_loss,
    cohesion_loss,
    contrastive_loss,
    information_loss,
    information_losses,
    log_discriminator,
    regularisation_loss,
)
from hmi_marl.training.traits.model import Discriminator, Reward, log_likelihood, log_policy
from hmi_marl.training.traits.settings import TraitSettings
from hmi_marl.training.traits.windows import Batch, transitions

LONGEST_GRADIENT = 10.0
AVERAGED = 100
"""Rounds over which the reward that is kept is averaged: equally until so many have passed, then
exponentially. The reward of a single round follows what the policy happens to do there."""
_MODEL, _AVERAGE, _RATE = "model.", "average.", "learning_rate"


class Labelled(NamedTuple):
    """Labelled pools."""

    batch: Batch
    labels: torch.Tensor
    """Shape (P,)."""


class DiscriminatorLearner:
    """Learn the discriminator: the context encoder and the reward, against a fixed policy.

    Args:
        settings: weights of the losses and learning rates.
        policy: π(a | s, z). It learns here too, but only by imitation; to the discriminator its
            log π is a constant.
    """

    def __init__(
        self, card: TraitCard, settings: TraitSettings, policy: MLPModel, device: str
    ) -> None:
        self.model = Discriminator(card).to(device)
        self._averaged = AveragedModel(self.model.reward, avg_fn=_averaged)
        self._settings, self._policy = settings, policy
        self._learning = [*self.model.reward.parameters(), self.model.width]
        if not settings.fixed_encoder:
            self._learning += self.model.encoder.learning()
        self._optimizer = torch.optim.Adam(
            [
                {"params": self._learning, "lr": settings.learning_rate},
                {"params": list(policy.mlp.parameters()), "lr": settings.imitation_rate},
            ]
        )

    @property
    def averaged(self) -> Reward:
        """The reward, its weights averaged over the rounds so far: the one to keep.

        The policy learns from the present one.
        """
        reward = self._averaged.module
        assert isinstance(reward, Reward)
        return reward

    def average(self) -> None:
        """Let the present reward enter the average; to be called once in each round."""
        self._averaged.update_parameters(self.model.reward)

    def encode(self, batch: Batch) -> Posterior:
        """Return q(z | τ) of every pool."""
        posterior: Posterior = self.model.encoder(batch)
        return posterior

    def learn(
        self,
        experts: Batch,
        labelled: Labelled | None = None,
        driven: Batch | None = None,
        z: torch.Tensor | None = None,
    ) -> dict[str, float]:
        """Make one update.

        Args:
            experts: demonstrations without labels; pools 2k and 2k + 1 are of the same driver.
            labelled: demonstrations with labels, if there are any.
            driven: the policy's driving, in which pool k was given z k; without it only imitation
                and L3 are learned from.
            z: latent vectors of ``driven``, shape (P, Z).

        Returns:
            Losses by name, each without its weight; the mean σ of z, and the σ that L2 uses
            (``width``); and the shares of demonstrated and of driven transitions that D recognises
            as such.

        Raises:
            FloatingPointError: learning diverges: one of these, or the gradient, is not finite.
        """
        losses, measures = self.losses(experts, labelled, driven, z)
        weights = self._settings.weights.by_loss()
        total = torch.stack([weights[name] * loss for name, loss in losses.items()]).sum()
        self._optimizer.zero_grad()
        total.backward()  # type: ignore[no-untyped-call]
        norm = torch.nn.utils.clip_grad_norm_(self._learning, LONGEST_GRADIENT)
        found = {name: value.item() for name, value in (losses | measures).items()}
        check_finite(found | {"gradient": norm.item()}, self._settings.learning_rate, _RATE)
        self._optimizer.step()
        return found

    def losses(
        self,
        experts: Batch,
        labelled: Labelled | None = None,
        driven: Batch | None = None,
        z: torch.Tensor | None = None,
    ) -> tuple[dict[str, torch.Tensor], dict[str, torch.Tensor]]:
        """Return the losses and the other measures of :meth:`learn`."""
        encoder, settings = self.model.encoder, self._settings
        with torch.set_grad_enabled(not settings.fixed_encoder):
            sums = encoder.sums(experts).sum(dim=1)
            known = None if labelled is None else encoder.sums(labelled.batch).sum(dim=1)
            every = sums if known is None else torch.cat([sums, known])
            fixed = encoder.centre, encoder.scale
            units = fixed if settings.fixed_encoder else encoder.units(every)
            posterior = encoder.posterior(sums, *units)
        z_experts = posterior.sample()
        # The policy learns from the whole gradient, the encoder from a share of it.
        constant = z_experts.detach()
        z_imitated = constant + settings.weights.imitate * (z_experts - constant)
        losses = {"imitation": -log_likelihood(self._policy, experts, z_imitated).mean()}
        if settings.weights.cohesion:
            losses["cohesion"] = cohesion_loss(z_experts[::2], z_experts[1::2])
        if labelled is not None and known is not None:
            losses["L3"] = contrastive_loss(
                encoder.posterior(known, *units).sample(),
                labelled.labels,
                settings.margin,
                settings.label_bandwidth,
            )
        measures = {
            "sigma": (0.5 * posterior.log_variance.detach()).exp().mean(),
            "width": (0.5 * self.model.width.detach()).exp().mean(),
        }
        if driven is not None and z is not None:
            again = encoder.posterior(encoder.sums(driven).sum(dim=1), *units)
            losses["L4"] = regularisation_loss(posterior.mean, posterior.log_variance)
            losses["L2"] = information_loss(z, again.mean, self.model.width.expand_as(z))
            expert_f, expert_log_pi = self._judge(experts, z_experts)
            policy_f, policy_log_pi = self._judge(driven, z)
            losses["L1"] = adversarial_loss(expert_f, expert_log_pi, policy_f, policy_log_pi)
            half = math.log(0.5)
            experts_found = log_discriminator(expert_f, expert_log_pi).detach() > half
            policy_found = log_discriminator(policy_f, policy_log_pi).detach() < half
            measures |= {
                "experts_recognised": experts_found.float().mean(),
                "policy_recognised": policy_found.float().mean(),
            }
        return losses, measures

    def _judge(self, batch: Batch, z: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the reward f and log π of every transition, given z of the pools, (P, Z)."""
        steps = transitions(batch)
        given = z[steps.pool]
        with torch.no_grad():
            all_log_pi = log_policy(self._policy, steps.before, given)
            log_pi = all_log_pi.gather(1, steps.actions[:, None]).squeeze(1)
        return self.model.reward(steps.before, steps.actions, steps.after, given), log_pi

    def rewards(self, driven: Batch, z: torch.Tensor) -> torch.Tensor:
        """Return the reward f of every driven step but the last, shape (P, n, T - 1)."""
        steps = transitions(driven)
        with torch.no_grad():
            f = self.model.reward(steps.before, steps.actions, steps.after, z[steps.pool])
        rewards: torch.Tensor = f.reshape(*driven.length.shape, -1)
        return rewards

    def information(self, driven: Batch, z: torch.Tensor) -> torch.Tensor:
        """Return log q(z | τ) of the vectors given to driven pools, shape (P,) [nats]."""
        with torch.no_grad():
            mean = self.encode(driven).mean
            return -information_losses(z, mean, self.model.width.expand_as(z))

    def tensors(self) -> dict[str, torch.Tensor]:
        """Weights and the optimizer's state, by flat names."""
        tensors = {
            f"{of}{name}": value
            for of, module in ((_MODEL, self.model), (_AVERAGE, self._averaged))
            for name, value in module.state_dict().items()
        }
        return tensors | flat_moments(self._optimizer.state_dict())

    def load(self, tensors: Mapping[str, torch.Tensor]) -> None:
        """Restore what :meth:`tensors` returned; RuntimeError if it is of another model."""
        for of, module in ((_MODEL, self.model), (_AVERAGE, self._averaged)):
            mine = {name: value for name, value in tensors.items() if name.startswith(of)}
            module.load_state_dict({name.removeprefix(of): v for name, v in mine.items()})
        self._optimizer.load_state_dict(with_moments(self._optimizer.state_dict(), tensors))


def _averaged(
    average: torch.Tensor, present: torch.Tensor, rounds: torch.Tensor | int
) -> torch.Tensor:
    """Average weights over so many earlier rounds and the present one."""
    return torch.lerp(average, present, 1 / min(int(rounds) + 1, AVERAGED))
