"""Shards: the fixed parts of every batch, which make results independent of the processes.

A batch is cut into as many shards of as many teams whatever the number of processes, each of which
has some of them. What is computed of a shard (its actions, values, advantages, gradients) comes
from calls of the same shapes wherever that happens, and sums over shards are taken in one order,
so the last bit is the same too. Inputs are copied into a shard's own memory before, since where it
begins can matter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from rsl_rl.models import MLPModel  # type: ignore[import-untyped]
from rsl_rl.utils import (  # type: ignore[import-untyped]
    split_and_pad_trajectories,
    unpad_trajectories,
)

from hmi_marl.training.ppo.models import Inputs, logits_of
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


@dataclass(frozen=True)
class MiniBatch:
    """A shard's part of a mini-batch. Rows are steps, or (steps, teams) of recurrent policies."""

    seen: Inputs
    actions: torch.Tensor
    log_prob: torch.Tensor
    """Log π(a) when the action was drawn."""
    advantages: torch.Tensor
    returns: torch.Tensor
    padded: tuple[torch.Tensor, torch.Tensor] | None = None
    """Of recurrent policies, the actor's inputs by episode, and which of them there are."""


class Shard:
    """The teams of one shard: what they did in a batch, and what is learned from that.

    Args:
        actor, critic: models of this process, the same for all of its shards.
        sample: inputs of the shard's teams, which give the shapes.
        steps: T, steps in a batch.
        columns: columns of the actions.
        settings: settings of PPO.
    """

    def __init__(
        self,
        actor: MLPModel,
        critic: MLPModel,
        sample: Inputs,
        steps: int,
        columns: int,
        settings: PPOSettings,
    ) -> None:
        self._actor, self._critic, self._settings = actor, critic, settings
        teams, device = len(sample.actor), sample.actor.device

        def empty(*shape: int) -> torch.Tensor:
            return torch.zeros(steps, teams, *shape, device=device)

        self.seen = Inputs(empty(sample.actor.shape[1]), empty(sample.critic.shape[1]))
        self.logits = empty(actor.distribution.input_dim)
        self.actions = empty(columns)
        self.rewards, self.dones = empty(), empty()
        self.returns, self.advantages, self.log_prob = empty(), empty(), empty()
        self.step = 0
        """Steps that were recorded since the batch began."""
        self._memory: torch.Tensor | None = None
        self._generator: torch.Generator | None = None

    def begin(self, generator: torch.Generator | None) -> None:
        """Begin a batch of whole episodes, whose draws come from ``generator``."""
        self.step, self._memory, self._generator = 0, None, generator

    def act(self, seen: Inputs) -> torch.Tensor:
        """Sample actions, shape (n, columns), and record them with what they were drawn from."""
        step = self.step
        self.seen.actor[step].copy_(seen.actor)
        self.seen.critic[step].copy_(seen.critic)
        logits, self._memory = logits_of(self._actor, self.seen.actor[step], self._memory)
        self.logits[step].copy_(logits)
        actions = self._draw(logits)
        self.actions[step].copy_(actions)
        return actions

    def explore(self, seen: Inputs) -> torch.Tensor:
        """Sample actions that are not recorded, shape (n, columns)."""
        return self._draw(logits_of(self._actor, seen.copied().actor, self._memory)[0])

    def record(self, rewards: torch.Tensor, dones: torch.Tensor) -> None:
        """Record what followed the last actions, both of shape (n,)."""
        self.rewards[self.step].copy_(rewards)
        self.dones[self.step].copy_(dones)
        self.step += 1
        if self._memory is not None:  # a new episode begins without memory
            self._memory = self._memory * (dones == 0)[None, :, None]

    def add_value(self, teams: torch.Tensor, seen: Inputs) -> None:
        """Add γ V(``seen``) to the rewards just recorded of ``teams``, rows of this shard."""
        values = self._critic.mlp(seen.copied().critic).squeeze(-1)
        self.rewards[self.step - 1][teams] += self._settings.gamma * values

    @torch.no_grad()
    def estimate(self, seen: Inputs) -> None:
        """Estimate returns and advantages, of which ``seen`` is what followed the last step."""
        settings, steps = self._settings, len(self.rewards)
        parts = torch.split(self.seen.critic, -(-steps // settings.num_mini_batches))
        values = torch.cat([self._critic.mlp(part).squeeze(-1) for part in parts])
        following = torch.cat(
            [values[1:], self._critic.mlp(seen.copied().critic).squeeze(-1)[None]]
        )
        goes_on = 1.0 - self.dones
        errors = self.rewards + settings.gamma * goes_on * following - values
        decay = settings.gamma * settings.gae_lambda * goes_on
        advantage = torch.zeros_like(errors[0])
        for step in reversed(range(steps)):
            advantage = torch.addcmul(errors[step], decay[step], advantage)
            self.advantages[step] = advantage
        torch.add(self.advantages, values, out=self.returns)
        self._actor.distribution.update(self.logits)
        self.log_prob.copy_(self._actor.distribution.log_prob(self.actions))

    def mini_batches(self) -> list[MiniBatch]:
        """Return this shard's parts of the mini-batches.

        They are random steps of all teams, or whole episodes of some teams if the policy is
        recurrent.
        """
        if self._actor.is_recurrent:
            return self._whole_episodes()
        count = self._settings.num_mini_batches
        rows = self.rewards.numel() // count
        order = torch.randperm(self.rewards.numel(), generator=self._generator)[: count * rows]
        order = order.to(self.rewards.device)

        def shuffled(values: torch.Tensor) -> tuple[torch.Tensor, ...]:
            return torch.split(values.flatten(0, 1).index_select(0, order), rows)

        parts = zip(
            map(Inputs, shuffled(self.seen.actor), shuffled(self.seen.critic)),
            *map(shuffled, (self.actions, self.log_prob, self.advantages, self.returns)),
            strict=True,
        )
        return [MiniBatch(*part) for part in parts]

    def _whole_episodes(self) -> list[MiniBatch]:
        count = self._settings.num_mini_batches
        each = self.rewards.shape[1] // count
        batches = []
        for first in range(0, count * each, each):
            teams = slice(first, first + each)
            seen = Inputs(self.seen.actor[:, teams], self.seen.critic[:, teams])
            values = (self.actions, self.log_prob, self.advantages, self.returns)
            actions, log_prob, advantages, returns = (part[:, teams] for part in values)
            padded = split_and_pad_trajectories(seen.actor, self.dones[:, teams, None])
            batches.append(MiniBatch(seen, actions, log_prob, advantages, returns, padded))
        return batches

    def losses(self, batch: MiniBatch, entropy_coef: float) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the loss to minimise, and value loss, surrogate loss and entropy: shape (3,)."""
        clip = self._settings.clip_param
        log_prob, entropies = self.log_prob_and_entropy(batch)
        ratio = torch.exp(log_prob - batch.log_prob)
        clipped = ratio.clamp(1.0 - clip, 1.0 + clip)
        surrogate = -torch.min(batch.advantages * ratio, batch.advantages * clipped).mean()
        values = self._critic.mlp(batch.seen.critic).squeeze(-1)
        value = (batch.returns - values).pow(2).mean()
        entropy = entropies.mean()
        loss = surrogate + value - entropy_coef * entropy
        return loss, torch.stack([value, surrogate, entropy]).detach()

    def log_prob_and_entropy(self, batch: MiniBatch) -> tuple[torch.Tensor, torch.Tensor]:
        """Return log π(a) and the policy's entropy in every row, as it is now."""
        head = self._actor.distribution
        head.update(self._logits(batch))
        return head.log_prob(batch.actions), head.entropy

    def _logits(self, batch: MiniBatch) -> torch.Tensor:
        if batch.padded is None:
            return self._actor.mlp(batch.seen.actor)
        inputs, there = batch.padded
        remembered = unpad_trajectories(self._actor.rnn.rnn(inputs)[0], there)
        return self._actor.mlp(torch.cat([remembered, batch.seen.actor], dim=-1))

    def _draw(self, logits: torch.Tensor) -> torch.Tensor:
        head = self._actor.distribution
        head.update(logits)
        return head.sample(self._generator)
