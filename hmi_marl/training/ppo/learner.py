"""Learners, and the batches that they learn from.

One PPO learns for a seat or for both, or one for each seat. A batch is a whole episode of every
team, played, recorded and averaged, shard by shard (:mod:`hmi_marl.training.ppo.shards`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import chain
from typing import Any, Protocol

import torch
from rsl_rl.models import MLPModel  # type: ignore[import-untyped]
from tensordict import TensorDict

from hmi_marl.envs.config import DRIVER, VEHICLE_AI
from hmi_marl.envs.rewards import ATTENTION_TERMS, TERMS
from hmi_marl.envs.vector import TeamVecEnv
from hmi_marl.training.ppo.models import IntentShown, View
from hmi_marl.training.ppo.shards import MiniBatch, Shard, Shards
from hmi_marl.training.protocols.settings import PPOSettings
from hmi_marl.training.runs.run import OPTIMIZER, flat_moments, with_moments

Extras = Mapping[str, Any]
Generators = Sequence[torch.Generator | None]
ONE_SHARD = Shards()
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
        self._parts = [list(model.parameters()) for model in (actor, critic)]
        self._parameters = list(chain(*self._parts))
        self.optimizer = torch.optim.Adam(self._parameters, settings.learning_rate, fused=True)
        self.entropy_coef = settings.entropy_coef
        seen = view(sample)
        self._teams = len(seen.actor) // len(shards.own)
        shape = seen.of(slice(self._teams)), steps, columns, settings
        self.shards = [Shard(actor, critic, *shape) for _ in shards.own]
        """Shards of this process."""

    def begin(self, progress: float, generators: Generators = TORCHS_OWN) -> None:
        """See :meth:`Learner.begin`."""
        settings = self.settings
        start, end = settings.entropy_coef, settings.final_entropy_coef
        self.entropy_coef = _between(start, end, progress)
        rate = _between(settings.learning_rate, settings.final_learning_rate, progress)
        for group in self.optimizer.param_groups:
            group["lr"] = rate
        for shard, generator in zip(self.shards, generators, strict=True):
            shard.begin(generator)

    def act(self, observations: TensorDict) -> torch.Tensor:
        """See :meth:`Learner.act`."""
        seen = self.view(observations)
        return torch.cat([shard.act(seen.of(rows)) for shard, rows in self._own()])

    def record(self, rewards: torch.Tensor, dones: torch.Tensor, extras: Extras) -> None:
        """See :meth:`Learner.record`.

        An episode that was truncated continues for the learner: V of the final observation is
        added to the last reward. (rsl_rl itself would take V of the state before.) The final
        observation precedes the driver's next action, so a vehicle AI's V reads no next a^H there.
        """
        rewards = rewards * self.settings.reward_scale
        for shard, rows in self._own():
            shard.record(rewards[rows], dones[rows])
        if "final_teams" in extras and extras["time_outs"].any():
            self._continue(extras)

    def _continue(self, extras: Extras) -> None:
        """Add the values of the final observations of episodes that were truncated."""
        teams, last = extras["final_teams"], extras["final_observation"]
        late = extras["time_outs"][teams]
        for shard, rows in self._own():
            if (which := late & (teams >= rows.start) & (teams < rows.stop)).any():
                shard.add_value(teams[which] - rows.start, self.view(last[which]))

    def learn(
        self, observations: TensorDict, rewards: torch.Tensor | None = None
    ) -> dict[str, float]:
        """See :meth:`Learner.learn`.

        ``rewards``, shape (T, N), replace the recorded ones if they are only known after the batch,
        as in adversarial IRL.
        """
        seen = self.view(observations)
        for shard, rows in self._own():
            if rewards is not None:
                shard.rewards.copy_(rewards[:, rows] * self.settings.reward_scale)
            shard.estimate(seen.of(rows))
        self._normalise_advantages()
        batches = list(zip(*(shard.mini_batches() for shard in self.shards), strict=True))
        losses = [
            self._descend(parts)
            for _ in range(self.settings.num_learning_epochs)
            for parts in batches
        ]
        own = [torch.stack(of_shard).double().mean(0) for of_shard in zip(*losses, strict=True)]
        means = self._shards.mean(own).tolist()
        rate = self.optimizer.param_groups[0]["lr"]
        return dict(zip(("value", "surrogate", "entropy"), means, strict=True)) | {
            "learning_rate": rate
        }

    def _normalise_advantages(self) -> None:
        """Give the advantages of the whole batch mean 0 and standard deviation 1."""
        advantages = [shard.advantages for shard in self.shards]
        count = advantages[0].numel() * self._shards.count
        mean = self._shards.sum([values.double().sum() for values in advantages]) / count
        squares = [(values.double() - mean).square().sum() for values in advantages]
        spread = (self._shards.sum(squares) / max(1, count - 1)).sqrt()
        for values in advantages:
            values.copy_((values - mean) / (spread + 1e-8))

    def _descend(self, batches: Sequence[MiniBatch]) -> list[torch.Tensor]:
        """Take one step along the gradient over all shards; return the losses of the own ones."""
        gradients, losses = [], []
        for shard, batch in zip(self.shards, batches, strict=True):
            loss, of_shard = shard.losses(batch, self.entropy_coef)
            parts = torch.autograd.grad(loss, self._parameters)
            gradients.append(torch.cat([part.flatten() for part in parts]))
            losses.append(of_shard)
        flat = self._shards.mean(gradients)
        sizes = [parameter.numel() for parameter in self._parameters]
        for parameter, part in zip(self._parameters, torch.split(flat, sizes), strict=True):
            parameter.grad = part.view_as(parameter)
        for parameters in self._parts:
            torch.nn.utils.clip_grad_norm_(parameters, self.settings.max_grad_norm)
        self.optimizer.step()
        return losses

    def discard(self) -> None:
        """Discard the steps recorded since the last update."""
        for shard in self.shards:
            shard.step = 0

    def explore(self, observations: TensorDict) -> torch.Tensor:
        """Sample actions that are not recorded, shape (N, columns)."""
        seen = self.view(observations)
        return torch.cat([shard.explore(seen.of(rows)) for shard, rows in self._own()])

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
        weights: dict[str, dict[str, torch.Tensor]] = {"actor": {}, "critic": {}}
        for full_name, value in tensors.items():
            kind, name = full_name.split(".", 1)
            if kind != OPTIMIZER:
                weights[kind][name] = value
        self.actor.load_state_dict(weights["actor"])
        self.critic.load_state_dict(weights["critic"])
        self.optimizer.load_state_dict(with_moments(self.optimizer.state_dict(), tensors))

    def _own(self) -> list[tuple[Shard, slice]]:
        """Shards of this process with their rows among its teams."""
        starts = range(0, self._teams * len(self.shards), self._teams)
        return [
            (shard, slice(start, start + self._teams))
            for shard, start in zip(self.shards, starts, strict=True)
        ]


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
        seed: team k of the whole batch gets the series of episodes of ``seed + k``.
        shards: cut of the batch, over which means are taken.

    Returns:
        Means over the teams' first episodes, which are all complete: the seat's ``return``,
        each reward term, ``team_return`` (all eight), ``attention_return`` (the last three),
        ``length``, ``crash_rate`` and ``alerts``.
    """
    first = _FirstEpisodes(env.num_envs)
    before = shards.processes.rank * env.num_envs
    with torch.inference_mode():
        observations, _ = env.reset((seed + before) % 2**64)
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
