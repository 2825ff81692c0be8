"""Shards: the fixed parts of every batch, which make results independent of the processes.

A batch is cut into as many shards of as many teams whatever the number of processes, each of which
has some of them. What is computed of a shard (its actions, values, advantages, gradients) comes
from calls of the same shapes wherever that happens, and sums over shards are taken in one order,
so the last bit is the same too.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import torch
from rsl_rl.models import MLPModel  # type: ignore[import-untyped]

from hmi_marl.agents.learned.policy import INTENTS
from hmi_marl.training.ppo.layers import Layers, policy_of
from hmi_marl.training.ppo.models import Inputs
from hmi_marl.training.protocols.settings import PPOSettings
from hmi_marl.training.runs.processes import ALONE, Processes


@dataclass(frozen=True)
class Shards:
    """The number of shards of a batch, and this process's part of them.

    ``count`` is a power of two, and a multiple of the number of processes.
    """

    count: int = 1
    processes: Processes = ALONE

    @property
    def own(self) -> range:
        """Numbers of the shards that this process has."""
        each = self.count // self.processes.count
        return range(self.processes.rank * each, (self.processes.rank + 1) * each)

    def sum(self, parts: Sequence[torch.Tensor]) -> torch.Tensor:
        """Return the sum over all shards, of each of which a process gives its own ``parts``."""
        return in_pairs(self.processes.gather(in_pairs(parts)))

    def mean(self, parts: Sequence[torch.Tensor]) -> torch.Tensor:
        """Return the mean over all shards; see :meth:`sum`."""
        return self.sum(parts) / self.count


def in_pairs(parts: Sequence[torch.Tensor]) -> torch.Tensor:
    """Add a power of two of tensors as (a + b) + (c + d).

    The parts of a process are a branch of this tree, so the order is the same for any number of
    processes.
    """
    while len(parts) > 1:
        parts = [one + other for one, other in zip(parts[::2], parts[1::2], strict=True)]
    return parts[0]


def flat(
    parameters: Sequence[torch.Tensor],
) -> tuple[torch.Tensor, list[torch.Tensor]]:
    """Return a copy of all parameters in one vector, and views of it in their shapes."""
    vector = torch.cat([parameter.detach().flatten() for parameter in parameters])
    parts = torch.split(vector, [parameter.numel() for parameter in parameters])
    pairs = zip(parts, parameters, strict=True)
    return vector, [part.view_as(parameter) for part, parameter in pairs]


_ALIGNED = 16
"""Numbers in the 64 bytes to which torch aligns memory. Every shard's memory begins at such a
multiple: products of a few rows round in another way if their memory begins elsewhere."""


@dataclass(frozen=True)
class Rollout:
    """Steps of a batch: of one shard, shape (T, n, ...), or of all of a process, (S, T, n, ...).

    Copies, single products and single sums round in one way only, so a process makes them for all
    of its shards at once.
    """

    actor: torch.Tensor
    """Inputs of the actor."""
    critic: torch.Tensor
    """Inputs of the critic."""
    logits: torch.Tensor
    actions: torch.Tensor
    log_prob: torch.Tensor
    """Log π(a) when the action was drawn."""
    rewards: torch.Tensor
    dones: torch.Tensor
    values: torch.Tensor
    """V of every step, and of what followed the last one: shape (..., T + 1, n)."""
    returns: torch.Tensor
    advantages: torch.Tensor
    anchor: torch.Tensor
    """Log-probabilities of a^H under the anchor, shape (..., 5); (..., 0) without an anchor."""

    @classmethod
    def empty(cls, shards: int, steps: int, sample: Inputs, logits: int, columns: int) -> Rollout:
        """Make one of ``shards`` that share the teams of ``sample``."""
        teams, device = len(sample.actor) // shards, sample.actor.device

        def zeros(*shape: int, steps: int = steps) -> torch.Tensor:
            size = math.prod((steps, teams, *shape))
            apart = -(-size // _ALIGNED) * _ALIGNED
            memory = torch.zeros(shards, apart, device=device)[:, :size]
            return torch.unflatten(memory, 1, (steps, teams, *shape))

        return cls(
            actor=zeros(sample.actor.shape[1]),
            critic=zeros(sample.critic.shape[1]),
            logits=zeros(logits),
            actions=zeros(columns),
            log_prob=zeros(),
            rewards=zeros(),
            dones=zeros(),
            values=zeros(steps=steps + 1),
            returns=zeros(),
            advantages=zeros(),
            anchor=zeros(0),
        )

    def with_anchor(self, columns: int) -> Rollout:
        """Return one with room for so many log-probabilities under an anchor, else the same."""
        shape = (*self.rewards.shape, columns)
        return replace(self, anchor=torch.zeros(shape, device=self.rewards.device))

    def of(self, shard: int) -> Rollout:
        """Return the part of one shard, in the same memory."""
        return Rollout(**{name: values[shard] for name, values in vars(self).items()})

    def estimate(self, settings: PPOSettings) -> None:
        """Estimate advantages and returns from the rewards and the values."""
        before, after = self.values[..., :-1, :], self.values[..., 1:, :]
        goes_on = 1.0 - self.dones
        errors = self.rewards + settings.gamma * goes_on * after - before
        decay = settings.gamma * settings.gae_lambda * goes_on
        advantage = torch.zeros_like(errors[..., 0, :])
        for step in reversed(range(errors.shape[-2])):
            advantage = errors[..., step, :] + decay[..., step, :] * advantage
            self.advantages[..., step, :] = advantage
        torch.add(self.advantages, before, out=self.returns)


@dataclass(frozen=True)
class MiniBatch:
    """A shard's part of a mini-batch. Rows are steps, or (steps, teams) of recurrent policies."""

    actor: torch.Tensor
    critic: torch.Tensor
    actions: torch.Tensor
    log_prob: torch.Tensor
    advantages: torch.Tensor
    returns: torch.Tensor
    anchor: torch.Tensor
    carried: torch.Tensor | None = None
    """0 where a step begins another episode, else 1, of recurrent policies."""

    @classmethod
    def values(cls, rollout: Rollout) -> list[torch.Tensor]:
        """Tensors of a rollout that it has parts of, in the order of the fields."""
        return [getattr(rollout, part.name) for part in fields(cls) if part.name != "carried"]


class Shard:
    """What is computed of the teams of one shard alone.

    Args:
        actor, critic: models of this process, the same for all of its shards.
        rollout: part of the rollout with this shard's steps.
        settings: settings of PPO.
    """

    def __init__(
        self, actor: MLPModel, critic: MLPModel, rollout: Rollout, settings: PPOSettings
    ) -> None:
        self.rollout, self._settings = rollout, settings
        self._policy, self._value = policy_of(actor), Layers(critic.mlp)
        self._head, self._recurrent = actor.distribution, actor.is_recurrent
        self._gradient, into = flat([*actor.parameters(), *critic.parameters()])
        count = len(list(actor.parameters()))
        self._of_policy, self._of_value = into[:count], into[count:]
        self._memory: torch.Tensor | None = None
        self._generator: torch.Generator | None = None
        self.anchor_kl: float | None = None
        """Weight λ of the divergence from the anchor in the loss; None without an anchor."""

    def begin(self, generator: torch.Generator | None) -> None:
        """Begin a batch of whole episodes, whose draws come from ``generator``."""
        self._memory, self._generator = None, generator

    def act(self, step: int) -> torch.Tensor:
        """Sample actions, shape (n, columns), given the recorded inputs of a step."""
        logits, self._memory = self._policy.act(self.rollout.actor[step], self._memory)
        self.rollout.logits[step] = logits
        return self._draw(logits)

    def explore(self, inputs: torch.Tensor) -> torch.Tensor:
        """Sample actions that are not recorded, shape (n, columns)."""
        return self._draw(self._policy.act(inputs.clone(), self._memory)[0])

    def forget(self, dones: torch.Tensor) -> None:
        """Clear the recurrent state of teams that begin another episode, where ``dones`` is 1."""
        if self._memory is not None:
            self._memory = self._memory * (dones == 0)[:, None]

    def value(self, inputs: torch.Tensor) -> torch.Tensor:
        """Return V, shape (m,), of the critic's inputs, shape (m, columns)."""
        return self._value.forward(inputs.clone())[-1].squeeze(-1)

    @torch.no_grad()
    def evaluate(self, following: torch.Tensor) -> None:
        """Compute values and log-probabilities of all steps.

        ``following`` are the critic's inputs after the last step, shape (n, columns).
        """
        rollout, steps = self.rollout, len(self.rollout.rewards)
        some = -(-steps // self._settings.num_mini_batches)  # as much as stays in the cache
        for first in range(0, steps, some):
            inputs = rollout.critic[first : first + some]
            values = self._value.forward(inputs.flatten(0, 1))[-1]
            rollout.values[first : first + len(inputs)] = values.view(inputs.shape[:2])
        rollout.values[-1] = self.value(following)
        self._head.update(rollout.logits)
        rollout.log_prob.copy_(self._head.log_prob(rollout.actions))

    def mini_batches(self) -> list[MiniBatch]:
        """Return this shard's parts of the mini-batches.

        They are random steps of all teams, or whole episodes of some teams if the policy is
        recurrent.
        """
        if self._recurrent:
            return self._whole_episodes()
        count, total = self._settings.num_mini_batches, self.rollout.rewards.numel()
        rows = total // count
        order = torch.randperm(total, generator=self._generator)[: count * rows]
        order = order.to(self.rollout.rewards.device)
        shuffled = [
            torch.split(values.flatten(0, 1).index_select(0, order), rows)
            for values in MiniBatch.values(self.rollout)
        ]
        return [MiniBatch(*parts) for parts in zip(*shuffled, strict=True)]

    def _whole_episodes(self) -> list[MiniBatch]:
        rollout, count = self.rollout, self._settings.num_mini_batches
        each = rollout.rewards.shape[1] // count
        carried = torch.zeros_like(rollout.dones)
        torch.sub(1.0, rollout.dones[:-1], out=carried[1:])
        batches = []
        for first in range(0, count * each, each):
            teams = slice(first, first + each)
            parts: list[Any] = [values[:, teams] for values in MiniBatch.values(rollout)]
            batches.append(MiniBatch(*[*parts, carried[:, teams]]))
        return batches

    @torch.no_grad()
    def gradient(self, batch: MiniBatch, entropy_coef: float) -> tuple[torch.Tensor, torch.Tensor]:
        """Gradient of the loss with respect to all weights, flat, which the next call replaces.

        Also returns the value loss, the surrogate loss and the entropy, shape (3,), or (4,) with
        the divergence from the anchor.
        """
        clip, rows = self._settings.clip_param, batch.advantages.numel()
        logits, passed = self._policy.forward(batch.actor, batch.carried)
        self._head.update(logits)
        ratio = (self._head.log_prob(batch.actions) - batch.log_prob).exp_()
        wanted = batch.advantages * ratio
        clipped = batch.advantages * ratio.clamp(1.0 - clip, 1.0 + clip)
        # Where the clipped term is less, it is a constant. The derivative of the ratio is itself.
        of_log_prob = torch.where(wanted <= clipped, wanted, 0.0).mul_(-1.0 / rows)
        of_logits = self._head.gradient(batch.actions, of_log_prob, -entropy_coef / rows)
        losses = [-torch.minimum(wanted, clipped).mean(), self._head.entropy.mean()]
        if self.anchor_kl is not None:
            divergence, of_intent = self._head.first.divergence(batch.anchor)
            losses.append(divergence.mean())
            if self.anchor_kl:
                of_logits[..., :INTENTS] += of_intent.mul_(self.anchor_kl / rows)
        self._policy.backward(passed, of_logits, self._of_policy)
        passed = self._value.forward(batch.critic.flatten(0, -2))
        errors = passed[-1].squeeze(-1) - batch.returns.flatten()
        value = errors.square().mean()
        self._value.backward(passed, errors.mul_(2.0 / rows).unsqueeze(-1), self._of_value)
        return self._gradient, torch.stack([value, *losses])

    def _draw(self, logits: torch.Tensor) -> torch.Tensor:
        self._head.update(logits)
        actions: torch.Tensor = self._head.sample(self._generator)
        return actions
