"""Who learns: one PPO for a seat or for both, or two of them that take turns."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Protocol

import torch
from rsl_rl.algorithms import PPO  # type: ignore[import-untyped]
from rsl_rl.models import MLPModel  # type: ignore[import-untyped]
from rsl_rl.storage import RolloutStorage  # type: ignore[import-untyped]
from tensordict import TensorDict

from hmi_marl.envs.config import DRIVER, VEHICLE_AI
from hmi_marl.training.ppo.views import IntentShown, SeatView
from hmi_marl.training.protocols.settings import PPOSettings
from hmi_marl.training.runs.checkpoint import OPTIMIZER, flat_moments, with_moments
from hmi_marl.training.runs.processes import Processes

Extras = Mapping[str, Any]


class Learner(Protocol):
    """Acts in every step of a batch, then learns from it."""

    def begin(self, progress: float) -> None:
        """Begin a batch of whole episodes; ``progress`` in [0, 1] is how much has been learned."""

    def act(self, observations: TensorDict) -> torch.Tensor:
        """Explore: actions of shape (N, columns)."""
        ...

    def record(self, rewards: torch.Tensor, dones: torch.Tensor, extras: Extras) -> None:
        """What the last actions led to, as the environment told it."""

    def learn(self, observations: TensorDict) -> dict[str, float]:
        """Learn from the batch, which ``observations`` follow; returns losses by name."""
        ...


class ShuffledOnce(RolloutStorage):  # type: ignore[misc]  # rsl_rl has no types
    """rsl_rl's storage, which gathers the same mini-batches anew in every epoch, gathering once."""

    def mini_batch_generator(
        self, num_mini_batches: int, num_epochs: int = 8
    ) -> Iterator[RolloutStorage.Batch]:
        """See :meth:`RolloutStorage.mini_batch_generator`, whose batches these are."""
        first = list(super().mini_batch_generator(num_mini_batches, num_epochs=1))
        for _ in range(num_epochs):
            yield from first


class PPOLearner:
    """One rsl_rl PPO.

    Args:
        actor: of a seat, or of both.
        critic: its critic.
        view: what the two read.
        sample: observations to know shapes by.
        steps: in a batch.
        columns: of actions.
        settings: of the algorithm.
        device: where it learns.
        processes: that share the gradients.
    """

    def __init__(
        self,
        actor: MLPModel,
        critic: MLPModel,
        view: SeatView,
        sample: TensorDict,
        steps: int,
        columns: int,
        settings: PPOSettings,
        device: str,
        processes: Processes,
    ) -> None:
        self.view = view
        self.settings = settings
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

    def begin(self, progress: float) -> None:
        """See :meth:`Learner.begin`."""
        settings = self.settings
        self.ppo.entropy_coef = _between(
            settings.entropy_coef, settings.final_entropy_coef, progress
        )
        rate = _between(settings.learning_rate, settings.final_learning_rate, progress)
        self.ppo.learning_rate = rate
        for group in self.ppo.optimizer.param_groups:
            group["lr"] = rate
        self.ppo.train_mode()
        self.ppo.actor.reset()  # whole episodes begin, so nothing is to be remembered

    def act(self, observations: TensorDict) -> torch.Tensor:
        """See :meth:`Learner.act`."""
        actions: torch.Tensor = self.ppo.act(self.view(observations))
        return actions

    def record(self, rewards: torch.Tensor, dones: torch.Tensor, extras: Extras) -> None:
        """See :meth:`Learner.record`.

        An episode that ended by its time alone goes on for the learner: V of what was seen last
        is added to its last reward. (rsl_rl itself would take V of the state before.) What was
        seen last comes before anybody's next turn, so a vehicle AI's V has no next a^H there.
        """
        rewards = rewards * self.settings.reward_scale
        if "final_teams" in extras:
            teams, late = extras["final_teams"], extras["time_outs"][extras["final_teams"]]
            if late.any():
                last = self.view(extras["final_observation"])
                values = self.ppo.critic(last).squeeze(-1)
                rewards[teams[late]] += self.settings.gamma * values[late]
        self.ppo.process_env_step(None, rewards, dones, {})

    def learn(self, observations: TensorDict) -> dict[str, float]:
        """See :meth:`Learner.learn`."""
        with torch.inference_mode():
            self.ppo.compute_returns(self.view(observations))
        losses: dict[str, float] = self.ppo.update()
        return losses | {"learning_rate": self.ppo.learning_rate}

    def explore(self, observations: TensorDict) -> torch.Tensor:
        """Actions that are not recorded, shape (N, columns)."""
        actions: torch.Tensor = self.ppo.actor(self.view(observations), stochastic_output=True)
        return actions

    def tensors(self) -> dict[str, torch.Tensor]:
        """Everything that it has learned, optimiser included, by flat names."""
        saved = self.ppo.save()
        tensors = {
            f"{model}.{name}": value
            for model in ("actor", "critic")
            for name, value in saved[f"{model}_state_dict"].items()
        }
        return tensors | flat_moments(saved["optimizer_state_dict"])

    def load(self, tensors: Mapping[str, torch.Tensor]) -> None:
        """Go back to what :meth:`tensors` gave.

        Raises:
            RuntimeError: they are of other networks.
        """
        models: dict[str, dict[str, torch.Tensor]] = {"actor": {}, "critic": {}}
        for full_name, value in tensors.items():
            kind, name = full_name.split(".", 1)
            if kind != OPTIMIZER:
                models[kind][name] = value
        optimizer = with_moments(self.ppo.optimizer.state_dict(), tensors)
        self.ppo.load(
            {f"{name}_state_dict": values for name, values in models.items()}
            | {"optimizer_state_dict": optimizer},
            None,
            strict=True,
        )


class TwoLearners:
    """The driver and the vehicle AI learn at the same time, each by a PPO of its own.

    Each collects from own turn to own turn: its reward is what the whole step gave it.

    Args:
        driver, vehicle_ai: who learns.
        intent_shown: shows a^H_t to the vehicle AI; None if both act at once.
    """

    def __init__(
        self, driver: PPOLearner, vehicle_ai: PPOLearner, intent_shown: IntentShown | None
    ) -> None:
        self.driver = driver
        self.vehicle_ai = vehicle_ai
        self._intent_shown = intent_shown

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
        """See :meth:`Learner.record`; ``rewards`` are not read, but what each agent gets."""
        self.driver.record(extras["rewards"][DRIVER], dones, extras)
        self.vehicle_ai.record(extras["rewards"][VEHICLE_AI], dones, extras)

    def learn(self, observations: TensorDict) -> dict[str, float]:
        """See :meth:`Learner.learn`."""
        with torch.inference_mode():  # what the vehicle AI would see in its next turn
            following = self._show(observations, self.driver.explore(observations))
        losses = self.driver.learn(observations)
        of_ai = self.vehicle_ai.learn(following)
        return losses | {f"vehicle_ai_{name}": value for name, value in of_ai.items()}

    def _show(self, observations: TensorDict, intents: torch.Tensor) -> TensorDict:
        return self._intent_shown(observations, intents) if self._intent_shown else observations


def _between(start: float, end: float, progress: float) -> float:
    return start + (end - start) * progress
