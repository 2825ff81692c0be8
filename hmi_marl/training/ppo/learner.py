"""Learners, and the batches that they learn from.

One PPO learns for a seat or for both, or one for each seat. A batch is a whole episode of every
team, played, recorded and averaged.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Protocol

import torch
from rsl_rl.algorithms import PPO  # type: ignore[import-untyped]
from rsl_rl.models import MLPModel  # type: ignore[import-untyped]
from rsl_rl.storage import RolloutStorage  # type: ignore[import-untyped]
from tensordict import TensorDict

from hmi_marl.envs.config import DRIVER, VEHICLE_AI
from hmi_marl.envs.rewards import ATTENTION_TERMS, TERMS
from hmi_marl.envs.vector import TeamVecEnv
from hmi_marl.training.ppo.models import IntentShown, View
from hmi_marl.training.protocols.settings import PPOSettings
from hmi_marl.training.runs.processes import Processes
from hmi_marl.training.runs.run import OPTIMIZER, flat_moments, with_moments

Extras = Mapping[str, Any]


class Learner(Protocol):
    """A learner acts in every step of a batch, then learns from the batch."""

    def begin(self, progress: float) -> None:
        """Begin a batch of whole episodes, at ``progress`` in [0, 1] of the schedules."""

    def act(self, observations: TensorDict) -> torch.Tensor:
        """Sample actions, shape (N, columns)."""
        ...

    def record(self, rewards: torch.Tensor, dones: torch.Tensor, extras: Extras) -> None:
        """Record what the environment returned for the last actions."""

    def learn(self, observations: TensorDict) -> dict[str, float]:
        """Learn from the batch, whose last step ``observations`` follow; return losses by name."""
        ...


class ShuffledOnce(RolloutStorage):  # type: ignore[misc]  # rsl_rl has no types
    """rsl_rl's storage that gathers the mini-batches once, not again in every epoch."""

    def mini_batch_generator(
        self, num_mini_batches: int, num_epochs: int = 8
    ) -> Iterator[RolloutStorage.Batch]:
        """See :meth:`RolloutStorage.mini_batch_generator`, whose batches these are."""
        first = list(super().mini_batch_generator(num_mini_batches, num_epochs=1))
        for _ in range(num_epochs):
            yield from first


class PPOLearner:
    """Learn by rsl_rl's PPO.

    Args:
        actor: policy of a seat, or composite policy of both.
        critic: value function.
        view: inputs of the two.
        sample: observations that give the shapes.
        steps: steps in a batch.
        columns: columns of the actions.
        processes: processes that share the gradients.
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
        processes: Processes,
    ) -> None:
        self.view, self.settings = view, settings
        seen = view(sample)
        storage = ShuffledOnce("rl", len(seen), steps, seen, [columns], device)
        self.ppo = PPO(
            actor,
            critic,
            storage,
            num_learning_epochs=settings.num_learning_epochs,
            num_mini_batches=settings.num_mini_batches,
            clip_param=settings.clip_param,
            gamma=settings.gamma,
            lam=settings.gae_lambda,
            entropy_coef=settings.entropy_coef,
            learning_rate=settings.learning_rate,
            max_grad_norm=settings.max_grad_norm,
            use_clipped_value_loss=False,  # its range is that of the policy's ratio, not of values
            schedule="fixed",  # begin() sets the learning rate
            device=device,
            multi_gpu_cfg=processes.as_rsl_rl(),
        )
        if processes.count > 1:
            self.ppo.broadcast_parameters()

    @property
    def actor(self) -> MLPModel:
        """The policy."""
        return self.ppo.actor

    def begin(self, progress: float) -> None:
        """See :meth:`Learner.begin`."""
        settings = self.settings
        start, end = settings.entropy_coef, settings.final_entropy_coef
        self.ppo.entropy_coef = _between(start, end, progress)
        rate = _between(settings.learning_rate, settings.final_learning_rate, progress)
        self.ppo.learning_rate = rate
        for group in self.ppo.optimizer.param_groups:
            group["lr"] = rate
        self.ppo.train_mode()
        self.ppo.actor.reset()  # whole episodes begin, with empty recurrent units

    def act(self, observations: TensorDict) -> torch.Tensor:
        """See :meth:`Learner.act`."""
        actions: torch.Tensor = self.ppo.act(self.view(observations))
        return actions

    def record(self, rewards: torch.Tensor, dones: torch.Tensor, extras: Extras) -> None:
        """See :meth:`Learner.record`.

        An episode that was truncated continues for the learner: V of the final observation is
        added to the last reward. (rsl_rl itself would take V of the state before.) The final
        observation precedes the driver's next action, so a vehicle AI's V reads no next a^H there.
        """
        rewards = rewards * self.settings.reward_scale
        if "final_teams" in extras:
            teams, late = extras["final_teams"], extras["time_outs"][extras["final_teams"]]
            if late.any():
                last = self.view(extras["final_observation"])
                values = self.ppo.critic(last).squeeze(-1)
                rewards[teams[late]] += self.settings.gamma * values[late]
        self.ppo.process_env_step(None, rewards, dones, {})

    def learn(
        self, observations: TensorDict, rewards: torch.Tensor | None = None
    ) -> dict[str, float]:
        """See :meth:`Learner.learn`.

        ``rewards``, shape (T, N), replace the recorded ones if they are only known after the batch,
        as in adversarial IRL.
        """
        if rewards is not None:
            self.ppo.storage.rewards.copy_((rewards * self.settings.reward_scale)[..., None])
        with torch.inference_mode():
            self.ppo.compute_returns(self.view(observations))
        losses: dict[str, float] = self.ppo.update()
        return losses | {"learning_rate": self.ppo.learning_rate}

    def discard(self) -> None:
        """Discard the steps recorded since the last update."""
        self.ppo.storage.clear()

    def explore(self, observations: TensorDict) -> torch.Tensor:
        """Sample actions that are not recorded, shape (N, columns)."""
        actions: torch.Tensor = self.ppo.actor(self.view(observations), stochastic_output=True)
        return actions

    def tensors(self) -> dict[str, torch.Tensor]:
        """Weights and the optimizer's state, by flat names."""
        saved = self.ppo.save()
        tensors = {
            f"{model}.{name}": value
            for model in ("actor", "critic")
            for name, value in saved[f"{model}_state_dict"].items()
        }
        return tensors | flat_moments(saved["optimizer_state_dict"])

    def load(self, tensors: Mapping[str, torch.Tensor]) -> None:
        """Restore what :meth:`tensors` returned; RuntimeError if it is of other networks."""
        models: dict[str, dict[str, torch.Tensor]] = {"actor": {}, "critic": {}}
        for full_name, value in tensors.items():
            kind, name = full_name.split(".", 1)
            if kind != OPTIMIZER:
                models[kind][name] = value
        optimizer = with_moments(self.ppo.optimizer.state_dict(), tensors)
        state: dict[str, Any] = {f"{name}_state_dict": values for name, values in models.items()}
        self.ppo.load(state | {"optimizer_state_dict": optimizer}, None, strict=True)


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

    def begin(self, progress: float) -> None:
        """See :meth:`Learner.begin`."""
        self.driver.begin(progress)
        self.vehicle_ai.begin(progress)

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


def play_batch(env: TeamVecEnv, learner: Learner, seed: int) -> dict[str, float]:
    """Play as many steps as an episode has, from the start of every team's episode.

    Teams that crash begin another episode, which the end of the batch truncates.

    Args:
        env: environment, which is reset.
        learner: acts and records.
        seed: team k gets the series of episodes of ``seed + k``.

    Returns:
        Means over the teams' first episodes, which are all complete: the seat's ``return``,
        each reward term, ``team_return`` (all eight), ``attention_return`` (the last three),
        ``length``, ``crash_rate`` and ``alerts``.
    """
    first = _FirstEpisodes(env.num_envs)
    with torch.inference_mode():
        observations, _ = env.reset(seed)
        for _ in range(env.max_episode_length):
            actions = learner.act(observations)
            observations, rewards, dones, extras = env.step(actions)
            learner.record(rewards, dones, extras)
            if "final_teams" in extras:
                first.add(extras)
    return first.means()


class _FirstEpisodes:
    """Statistics of each team's first episode in a batch."""

    def __init__(self, teams: int) -> None:
        self._waiting = torch.ones(teams, dtype=torch.bool)
        self._values: dict[str, list[torch.Tensor]] = {}

    def add(self, extras: dict[str, Any]) -> None:
        """Add the episodes that ended in a step."""
        teams = extras["final_teams"].cpu()
        first = self._waiting[teams]
        self._waiting[teams] = False
        for name, values in extras["log"].items():
            self._values.setdefault(name.removeprefix("Episode/"), []).append(values[first])

    def means(self) -> dict[str, float]:
        """Return means over all teams."""
        means = {name: float(torch.cat(kept).mean()) for name, kept in self._values.items()}
        means["team_return"] = sum(means[term] for term in TERMS)
        means["attention_return"] = sum(means[term] for term in ATTENTION_TERMS)
        return means
