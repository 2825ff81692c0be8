"""The generator: the trait-conditioned policy, which learns from the learned reward by PPO."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from rsl_rl.models import MLPModel  # type: ignore[import-untyped]
from tensordict import TensorDict

from hmi_marl.agents.learned.trait_model import TraitCard
from hmi_marl.envs.config import TeamConfig
from hmi_marl.training.ppo.learner import PPOLearner
from hmi_marl.training.ppo.models import unchanged
from hmi_marl.training.traits.episodes import Units
from hmi_marl.training.traits.model import log_likelihood, make_policy, make_value
from hmi_marl.training.traits.rollouts import Drives, drive
from hmi_marl.training.traits.settings import TraitSettings
from hmi_marl.training.traits.windows import Batch


class Generator:
    """The policy π(a | s, z) with its driving and its PPO.

    Args:
        settings: number of cars, and settings of PPO.
        config: configuration of the teams that gave the demonstrations.
        alert_rate: share of steps with an alert.
    """

    def __init__(
        self,
        card: TraitCard,
        settings: TraitSettings,
        config: TeamConfig,
        alert_rate: float,
        units: Units,
        device: str,
    ) -> None:
        self._settings, self._config, self._alert_rate = settings, config, alert_rate
        self._units, self._device = units, device
        inputs = torch.zeros(settings.num_teams, card.inputs("policy"), device=device)
        sample = _observations(inputs)
        self.learner = PPOLearner(
            make_policy(card),
            make_value(card),
            unchanged,
            sample,
            config.horizon - 1,  # the last step has no next situation, so no f
            1,
            settings.ppo,
            device,
        )
        self._seen = sample

    @property
    def policy(self) -> MLPModel:
        """π(a | s, z)."""
        return self.learner.actor

    @property
    def horizon(self) -> int:
        """Steps of a window."""
        return self._config.horizon

    def begin(self, progress: float) -> None:
        """Begin a round at ``progress`` in [0, 1] of the schedules."""
        self.learner.begin(progress)

    def drive(self, z: torch.Tensor, seeds: NDArray[np.uint64]) -> tuple[Drives, Batch]:
        """Drive one window with each car, z (P, Z) of its pool and seed (N,); record to learn."""
        cars = z.repeat_interleave(self._settings.pool, dim=0)
        learner, step = self.learner, 0
        learner.discard()
        nothing = torch.zeros(len(cars), device=self._device)

        def act(x: NDArray[np.float32]) -> NDArray[np.int64]:
            nonlocal step
            if step > 0:
                learner.record(nothing, nothing, {})
            step += 1
            standard = torch.from_numpy(self._units.standardise(x)).to(self._device)
            seen = _observations(torch.cat([standard, cars], dim=1))
            if step == self._config.horizon:
                self._seen = seen
                actions = learner.explore(seen)
            else:
                actions = learner.act(seen)
            return actions.squeeze(1).long().cpu().numpy()

        with torch.inference_mode():
            drives = drive(self._config, act, self._alert_rate, seeds, self._settings.threads)
        return drives, self._batch(drives)

    def _batch(self, drives: Drives) -> Batch:
        pools = len(drives.actions) // self._settings.pool
        x = torch.from_numpy(self._units.standardise(drives.situations)).to(self._device)
        actions = torch.from_numpy(drives.actions).to(self._device)
        length = torch.full((pools, self._settings.pool), actions.shape[1], device=self._device)
        return Batch(
            x.reshape(pools, self._settings.pool, *x.shape[1:]),
            actions.reshape(pools, self._settings.pool, -1),
            length,
        )

    def learn(self, batch: Batch, z: torch.Tensor, f: torch.Tensor) -> dict[str, float]:
        """Learn from the windows just driven, with the reward f − log π in each step.

        That is log D − log(1 − D): the maximum-entropy objective of the paper's equation 1.

        Args:
            batch: batch that :meth:`drive` returned.
            z: latent vectors of its pools, shape (P, Z).
            f: learned reward of each step but the last, shape (P, n, T - 1).
        """
        with torch.no_grad():
            log_pi = log_likelihood(self.policy, batch, z).reshape(batch.actions.shape)[:, :, :-1]
        rewards = f - log_pi
        losses = self.learner.learn(self._seen, rewards.reshape(-1, f.shape[2]).T)
        return losses | {"return": float(rewards.sum(dim=2).mean())}


def _observations(inputs: torch.Tensor) -> TensorDict:
    return TensorDict({"actor": inputs, "critic": inputs}, batch_size=[len(inputs)])
