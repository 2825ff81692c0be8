"""The generator: the trait-conditioned policy learns to drive for the reward, by PPO."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from rsl_rl.models import MLPModel  # type: ignore[import-untyped]
from tensordict import TensorDict

from hmi_marl.agents.learned.trait_model import TraitCard
from hmi_marl.envs.config import TeamConfig
from hmi_marl.training.ppo.learner import PPOLearner
from hmi_marl.training.runs.processes import Processes
from hmi_marl.training.traits.model import log_likelihood, make_policy, make_value
from hmi_marl.training.traits.pools import Batch, Units
from hmi_marl.training.traits.rollouts import Drives, drive
from hmi_marl.training.traits.settings import TraitSettings


class Generator:
    """π(a | s, z), and how it learns.

    Args:
        card: of the model.
        settings: how many drive, and the PPO.
        config: of the teams that gave the demonstrations.
        alert_rate: how often an alert sounds.
        units: of the states.
        device: where it learns.
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
        sample = _observations(
            torch.zeros(settings.num_teams, card.inputs("policy"), device=device)
        )
        self.learner = PPOLearner(
            make_policy(card),
            make_value(card),
            lambda seen: seen,  # type: ignore[arg-type]  # both read it as it is
            sample,
            config.horizon - 1,  # the last step has no next situation, so no f
            1,
            settings.ppo,
            device,
            Processes(),
        )
        self._seen = sample

    @property
    def policy(self) -> MLPModel:
        """π(a | s, z)."""
        return self.learner.ppo.actor

    @property
    def horizon(self) -> int:
        """Steps of a window."""
        return self._config.horizon

    def begin(self, progress: float) -> None:
        """Begin a round; ``progress`` in [0, 1] is how much has been learned."""
        self.learner.begin(progress)

    def drive(self, z: torch.Tensor, seeds: NDArray[np.uint64]) -> tuple[Drives, Batch]:
        """One window each, recorded for learning: pool k of the cars drives with z k, (P, Z)."""
        cars = z.repeat_interleave(self._settings.pool, dim=0)
        learner, step = self.learner, 0
        learner.ppo.storage.clear()
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
        """Learn from what was just driven, for f − log π in each step.

        That is log D − log(1 − D): the maximum-entropy objective of the paper's equation 1.

        Args:
            batch: as :meth:`drive` gave it.
            z: shape (P, Z).
            f: of each step but the last, shape (P, n, T - 1).
        """
        storage = self.learner.ppo.storage
        with torch.no_grad():
            log_pi = log_likelihood(self.policy, batch, z).reshape(batch.actions.shape)[:, :, :-1]
        rewards = (f - log_pi).reshape(-1, f.shape[2]) * self._settings.ppo.reward_scale
        storage.rewards.copy_(rewards.T[..., None])
        losses = self.learner.learn(self._seen)
        return losses | {"return": float((f - log_pi).sum(dim=2).mean())}


def _observations(inputs: torch.Tensor) -> TensorDict:
    return TensorDict({"actor": inputs, "critic": inputs}, batch_size=[len(inputs)])
