"""Learners, and the batches that they learn from.

One PPO learns for a seat or for both, or one for each seat. A batch is a whole episode of every
team, played, recorded and averaged, shard by shard (:mod:`hmi_marl.training.ppo.shards`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import torch
from rsl_rl.models import MLPModel  # type: ignore[import-untyped]
from tensordict import TensorDict

from hmi_marl.agents.learned.policy import INTENTS
from hmi_marl.envs.config import DRIVER, VEHICLE_AI
from hmi_marl.envs.rewards import ATTENTION_TERMS, TERMS
from hmi_marl.envs.vector import TeamVecEnv
from hmi_marl.training.ppo.anchor import Anchor
from hmi_marl.training.ppo.models import IntentShown, View
from hmi_marl.training.ppo.shards import MiniBatch, Rollout, Shard, Shards, flat
from hmi_marl.training.protocols.settings import PPOSettings
from hmi_marl.training.runs.divergence import are_finite, check_finite
from hmi_marl.training.runs.run import flat_moments, with_moments

Extras = Mapping[str, Any]
Generators = Sequence[torch.Generator | None]
ONE_SHARD = Shards()
_RATE = "ppo.learning_rate"
_LOSSES = ("value", "surrogate", "entropy")
ANCHOR_KL = "anchor_kl"
"""Column of the curve: divergence of the driver from the anchor [nats per step]."""
TORCHS_OWN: Generators = (None,)
"""Torch's own generator, for a single shard."""


class Learner(Protocol):
    """A learner acts in every step of a batch, then learns from the batch."""

    def begin(self, progress: float, generators: Generators = TORCHS_OWN) -> None:
        """Begin a batch of whole episodes, at ``progress`` in [0, 1] of the schedules.

        All draws come from ``generators``, one for each shard of this process.
        """

    def act(self, observations: TensorDict) -> torch.Tensor:
        """Sample actions, shape (N, columns)."""
        ...

    def record(self, rewards: torch.Tensor, dones: torch.Tensor, extras: Extras) -> None:
        """Record what the environment returned for the last actions."""

    def learn(self, observations: TensorDict) -> dict[str, float]:
        """Learn from the batch, whose last step ``observations`` follow; return losses by name."""
        ...


class PPOLearner:
    """Learn by PPO with the models and the losses of rsl_rl's, shard by shard.

    Args:
        actor: policy of a seat, or composite policy of both.
        critic: value function.
        view: inputs of the two.
        sample: observations of this process's teams, which give the shapes.
        steps: steps in a batch.
        columns: columns of the actions.
        shards: cut of the batch.
    """

    def __init__(
        self,
        actor: MLPModel,
        critic: MLPModel,
        view: View,
        sample: TensorDict,
        steps: int,
        columns: int,
        settings: PPOSettings,
        device: str,
        shards: Shards = ONE_SHARD,
    ) -> None:
        self.view, self.settings, self._shards = view, settings, shards
        self.actor, self.critic = actor.to(device), critic.to(device)
        """Policy and value function."""
        parameters = [*actor.parameters(), *critic.parameters()]
        weights, views = flat(parameters)
        for parameter, place in zip(parameters, views, strict=True):
            parameter.data = place  # so that the optimizer has a single tensor to go through
        self._weights = torch.nn.Parameter(weights)
        self._of_actor = sum(parameter.numel() for parameter in actor.parameters())
        self.optimizer = torch.optim.Adam([self._weights], settings.learning_rate, fused=True)
        self.entropy_coef = settings.entropy_coef
        head, own = actor.distribution, len(shards.own)
        self.rollout = Rollout.empty(own, steps, view(sample), head.input_dim, columns)
        """Steps of this process's shards."""
        self.shards = [
            Shard(actor, critic, self.rollout.of(number), settings) for number in range(own)
        ]
        """Shards of this process."""
        self._step = 0
        self._anchor: Anchor | None = None

    def anchor_to(self, anchor: Anchor | None) -> None:
        """Hold the driver close to a policy from the next batch on; None lets it go."""
        self._anchor = anchor
        self.rollout = self.rollout.with_anchor(0 if anchor is None else INTENTS)
        for number, shard in enumerate(self.shards):
            shard.rollout = self.rollout.of(number)
            shard.anchor_kl = None if anchor is None else anchor.kl

    def begin(self, progress: float, generators: Generators = TORCHS_OWN) -> None:
        """See :meth:`Learner.begin`."""
        settings = self.settings
        start, end = settings.entropy_coef, settings.final_entropy_coef
        self.entropy_coef = _between(start, end, progress)
        rate = _between(settings.learning_rate, settings.final_learning_rate, progress)
        for group in self.optimizer.param_groups:
            group["lr"] = rate
        self._step = 0
        for shard, generator in zip(self.shards, generators, strict=True):
            shard.begin(generator)

    def act(self, observations: TensorDict) -> torch.Tensor:
        """See :meth:`Learner.act`."""
        seen, rollout, step = self.view(observations), self.rollout, self._step
        rollout.actor[:, step] = self._by_shard(seen.actor)
        rollout.critic[:, step] = self._by_shard(seen.critic)
        if (anchor := self._anchor) is not None:
            read = self._by_shard(anchor.inputs(observations))
            rollout.anchor[:, step] = torch.stack([anchor.log_probs(each) for each in read])
        actions = torch.stack([shard.act(step) for shard in self.shards])
        rollout.actions[:, step] = actions
        return actions.flatten(0, 1)

    def record(self, rewards: torch.Tensor, dones: torch.Tensor, extras: Extras) -> None:
        """See :meth:`Learner.record`.

        An episode that was truncated continues for the learner: V of the final observation is
        added to the last reward. (rsl_rl itself would take V of the state before.) The final
        observation precedes the driver's next action, so a vehicle AI's V reads no next a^H there.
        """
        ended = self._by_shard(dones)
        self.rollout.rewards[:, self._step] = self._by_shard(rewards * self.settings.reward_scale)
        self.rollout.dones[:, self._step] = ended
        for shard, its_ended in zip(self.shards, ended, strict=True):
            shard.forget(its_ended)
        if "final_teams" in extras and extras["time_outs"].any():
            self._continue(extras)
        self._step += 1

    def _continue(self, extras: Extras) -> None:
        """Add γ V of the final observations of episodes that were truncated."""
        teams, last = extras["final_teams"], extras["final_observation"]
        late = extras["time_outs"][teams]
        each = self.rollout.rewards.shape[-1]
        for number, shard in enumerate(self.shards):
            if (which := late & (teams // each == number)).any():
                values = shard.value(self.view(last[which]).critic)
                rewards = shard.rollout.rewards[self._step]
                rewards[teams[which] % each] += self.settings.gamma * values

    def learn(
        self, observations: TensorDict, rewards: torch.Tensor | None = None
    ) -> dict[str, float]:
        """See :meth:`Learner.learn`.

        ``rewards``, shape (T, N), replace the recorded ones if they are only known after the batch,
        as in adversarial IRL.

        Raises:
            FloatingPointError: learning diverges: logits that the batch was played by, losses or
                weights are not finite.
        """
        rate = self.optimizer.param_groups[0]["lr"]
        if not are_finite([self.rollout.logits]):
            check_finite({"logits": math.nan}, rate, _RATE)  # its actions mean nothing
        if rewards is not None:
            scaled = self._by_shard((rewards * self.settings.reward_scale).T)
            self.rollout.rewards.copy_(scaled.transpose(1, 2))
        following = self._by_shard(self.view(observations).critic)
        for shard, inputs in zip(self.shards, following, strict=True):
            shard.evaluate(inputs)
        self.rollout.estimate(self.settings)
        self._normalise_advantages()
        batches = list(zip(*(shard.mini_batches() for shard in self.shards), strict=True))
        losses = [
            self._descend(parts)
            for _ in range(self.settings.num_learning_epochs)
            for parts in batches
        ]
        own = [torch.stack(of_shard).double().mean(0) for of_shard in zip(*losses, strict=True)]
        means = self._shards.mean(own).tolist()
        names = _LOSSES if self._anchor is None else (*_LOSSES, ANCHOR_KL)
        found = dict(zip(names, means, strict=True))
        weights = 0.0 if are_finite([self._weights]) else math.nan
        check_finite(found | {"weights": weights}, rate, _RATE)
        return found | {"learning_rate": rate}

    def _normalise_advantages(self) -> None:
        """Give the advantages of the whole batch mean 0 and standard deviation 1."""
        advantages = [shard.rollout.advantages for shard in self.shards]
        count = advantages[0].numel() * self._shards.count
        mean = self._shards.sum([values.double().sum() for values in advantages]) / count
        squares = [(values.double() - mean).square().sum() for values in advantages]
        spread = (self._shards.sum(squares) / max(1, count - 1)).sqrt()
        for values in advantages:
            values.copy_((values - mean) / (spread + 1e-8))

    def _descend(self, batches: Sequence[MiniBatch]) -> list[torch.Tensor]:
        """Take one step along the gradient over all shards; return the losses of the own ones."""
        own = [
            shard.gradient(batch, self.entropy_coef)
            for shard, batch in zip(self.shards, batches, strict=True)
        ]
        gradient = self._shards.mean([of_shard for of_shard, _ in own])
        for part in (gradient[: self._of_actor], gradient[self._of_actor :]):
            part *= (self.settings.max_grad_norm / (part.norm() + 1e-6)).clamp(max=1.0)
        self._weights.grad = gradient
        self.optimizer.step()
        return [losses for _, losses in own]

    def discard(self) -> None:
        """Discard the steps recorded since the last update."""
        self._step = 0

    def explore(self, observations: TensorDict) -> torch.Tensor:
        """Sample actions that are not recorded, shape (N, columns)."""
        seen = self._by_shard(self.view(observations).actor)
        pairs = zip(self.shards, seen, strict=True)
        return torch.cat([shard.explore(inputs) for shard, inputs in pairs])

    def _by_shard(self, values: torch.Tensor) -> torch.Tensor:
        """Reshape values of all teams, (N, ...), to (shards, n, ...)."""
        return torch.unflatten(values, 0, (len(self.shards), -1))

    def tensors(self) -> dict[str, torch.Tensor]:
        """Weights and the optimizer's state, by flat names."""
        tensors = {
            f"{name}.{weight}": value
            for name, model in (("actor", self.actor), ("critic", self.critic))
            for weight, value in model.state_dict().items()
        }
        return tensors | flat_moments(self.optimizer.state_dict())

    def load(self, tensors: Mapping[str, torch.Tensor]) -> None:
        """Restore what :meth:`tensors` returned; RuntimeError if it is of other networks."""
        self.actor.load_state_dict(weights_among(tensors, "actor"))
        self.critic.load_state_dict(weights_among(tensors, "critic"))
        self.optimizer.load_state_dict(with_moments(self.optimizer.state_dict(), tensors))


def weights_among(tensors: Mapping[str, torch.Tensor], model: str) -> dict[str, torch.Tensor]:
    """Return the weights of "actor" or "critic" among what :meth:`PPOLearner.tensors` returned."""
    start = f"{model}."
    return {n.removeprefix(start): values for n, values in tensors.items() if n.startswith(start)}


class TwoLearners:
    """Learn the driver's and the vehicle AI's policies at the same time, each by its own PPO.

    A transition of each agent reaches from its turn to its next turn, so its reward is that of the
    whole step.

    ``intent_shown`` shows a^H_t to the vehicle AI; None for simultaneous moves.
    """

    def __init__(
        self, driver: PPOLearner, vehicle_ai: PPOLearner, intent_shown: IntentShown | None
    ) -> None:
        self.driver, self.vehicle_ai, self._intent_shown = driver, vehicle_ai, intent_shown

    def begin(self, progress: float, generators: Generators = TORCHS_OWN) -> None:
        """See :meth:`Learner.begin`."""
        self.driver.begin(progress, generators)
        self.vehicle_ai.begin(progress, generators)

    def act(self, observations: TensorDict) -> torch.Tensor:
        """See :meth:`Learner.act`."""
        intents = self.driver.act(observations)
        alerts = self.vehicle_ai.act(self._show(observations, intents))
        return torch.cat([intents, alerts], dim=1)

    def record(self, rewards: torch.Tensor, dones: torch.Tensor, extras: Extras) -> None:
        """See :meth:`Learner.record`; each agent's own reward stands in ``extras``."""
        self.driver.record(extras["rewards"][DRIVER], dones, extras)
        self.vehicle_ai.record(extras["rewards"][VEHICLE_AI], dones, extras)

    def learn(self, observations: TensorDict) -> dict[str, float]:
        """See :meth:`Learner.learn`."""
        with torch.inference_mode():  # the vehicle AI's observation in its next turn
            following = self._show(observations, self.driver.explore(observations))
        losses = self.driver.learn(observations)
        of_hmi = self.vehicle_ai.learn(following)
        return losses | {f"vehicle_ai_{name}": value for name, value in of_hmi.items()}

    def _show(self, observations: TensorDict, intents: torch.Tensor) -> TensorDict:
        return self._intent_shown(observations, intents) if self._intent_shown else observations


def _between(start: float, end: float, progress: float) -> float:
    return start + (end - start) * progress


def play_batch(
    env: TeamVecEnv, learner: Learner, seed: int, shards: Shards = ONE_SHARD
) -> dict[str, float]:
    """Play as many steps as an episode has, from the start of every team's episode.

    Teams that crash begin another episode, which the end of the batch truncates.

    Args:
        env: environment with this process's teams, which is reset.
        learner: acts and records.
        seed: team k of the whole batch gets the series of episodes of ``team_seed(seed, k)``.
        shards: cut of the batch, over which means are taken.

    Returns:
        Means over the teams' first episodes, which are all complete: the seat's ``return``,
        each reward term, ``team_return`` (all eight), ``attention_return`` (the last three),
        ``length``, ``crash_rate`` and ``alerts``.
    """
    first = _FirstEpisodes(env.num_envs)
    first_team = shards.processes.rank * env.num_envs
    with torch.inference_mode():
        observations, _ = env.reset(seed, first_team)
        for _ in range(env.max_episode_length):
            actions = learner.act(observations)
            observations, rewards, dones, extras = env.step(actions)
            learner.record(rewards, dones, extras)
            if "final_teams" in extras:
                first.add(extras)
        return first.means(shards)


class _FirstEpisodes:
    """Statistics of each team's first episode in a batch."""

    def __init__(self, teams: int) -> None:
        self._waiting = torch.ones(teams, dtype=torch.bool)
        self._values: dict[str, torch.Tensor] = {}

    def add(self, extras: dict[str, Any]) -> None:
        """Add the episodes that ended in a step."""
        teams = extras["final_teams"].cpu()
        first = self._waiting[teams]
        teams = teams[first]
        self._waiting[teams] = False
        for name, values in extras["log"].items():
            kept = self._values.setdefault(
                name.removeprefix("Episode/"), torch.zeros(len(self._waiting))
            )
            kept[teams] = values[first]

    def means(self, shards: Shards) -> dict[str, float]:
        """Return means over all teams."""
        values = torch.stack(list(self._values.values())).double()
        parts = [part.contiguous().mean(1) for part in values.chunk(len(shards.own), dim=1)]
        means = dict(zip(self._values, shards.mean(parts).tolist(), strict=True))
        means["team_return"] = sum(means[term] for term in TERMS)
        means["attention_return"] = sum(means[term] for term in ATTENTION_TERMS)
        return means
