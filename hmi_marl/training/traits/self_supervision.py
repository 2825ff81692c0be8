"""Learning of the encoder before anything drives: the average driver, then who belongs together."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch

from hmi_marl.training.runs.descent import Descent
from hmi_marl.training.traits.encoder import ContextEncoder
from hmi_marl.training.traits.losses import same_driver_loss
from hmi_marl.training.traits.settings import TraitSettings
from hmi_marl.training.traits.windows import Batch, Windows

PairLoss = Callable[[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor], torch.Tensor]
"""Loss of two pools of each driver; arguments as of :func:`same_driver_loss`."""
PREPARING_POOLS = 64
"""Pools from which the encoder takes its units."""
SPLITS = 4
"""Divisions of each driver's windows into two pools, in every update."""


class AverageLearner:
    """Learn the average driver's policy π(a | s) by imitation of all demonstrations."""

    def __init__(self, encoder: ContextEncoder, rate: float) -> None:
        self._encoder = encoder
        self.descent = Descent(encoder.average.parameters(), rate, setting="imitation_rate")

    def learn(self, batch: Batch, progress: float) -> dict[str, float]:
        """Make one update; ``progress`` in [0, 1).

        Returns:
            The mean of −log π(v_t | s), under ``average``.
        """
        there = torch.arange(batch.situations.shape[2], device=batch.length.device)
        real = there < batch.length[..., None]
        every = self._encoder.log_average(batch.situations[real])
        loss = -every.gather(1, batch.actions[real][:, None]).mean()
        return {"average": self.descent.step(loss, progress)}


class SelfSupervision:
    """Learn the encoder from one thing alone: which windows are of one driver, whoever that is."""

    def __init__(
        self,
        encoder: ContextEncoder,
        rate: float,
        weight_decay: float,
        pair_loss: PairLoss = same_driver_loss,
    ) -> None:
        self._encoder, self._pair_loss = encoder, pair_loss
        self.descent = Descent(encoder.learning(), rate, weight_decay, "encoder_rate")

    def learn(self, batch: Batch, progress: float) -> dict[str, float]:
        """Make one update; ``progress`` in [0, 1).

        Args:
            batch: windows of P drivers, an even number 2n of each; every pool of the batch holds
                those of one.
            progress: see :class:`Descent`.

        Returns:
            The loss, and the mean σ of z given n windows.
        """
        loss, sigma = self.loss(batch)
        return {"same_driver": self.descent.step(loss, progress), "sigma": sigma.item()}

    def loss(self, batch: Batch) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the loss, and the mean σ of z given n windows; see :meth:`learn`.

        Windows are divided at random several times, half of the times into one pool of n windows
        and one of fewer, so that z holds for any number of windows and its σ says how many.
        """
        sums = self._encoder.sums(batch)
        drivers, windows, _ = sums.shape
        half = windows // 2
        losses = []
        for number in range(SPLITS):
            order = torch.rand(drivers, windows, device=sums.device).argsort(dim=1)
            mixed = sums.gather(1, order[..., None].expand_as(sums))
            size = half if number % 2 == 0 else int(torch.randint(1, half + 1, ()))
            pools = torch.cat([mixed[:, :size].sum(dim=1), mixed[:, half:].sum(dim=1)])
            units = self._encoder.units(pools)
            both = self._encoder.posterior(pools, *units)
            (mean, other_mean), (log_variance, other) = (part.chunk(2) for part in both)
            losses.append(self._pair_loss(mean, log_variance, other_mean, other))
            if number == 0:
                sigma = (0.5 * both.log_variance.detach()).exp().mean()
        return torch.stack(losses).mean(), sigma


class EncoderLearning:
    """Both of these, from windows that are drawn for every update.

    Args:
        encoder: what learns.
        windows: demonstrations.
        settings: sizes and rates.
        device: device of the learner.
        pair_loss: what the encoder is to make small for the two pools of each driver.
    """

    def __init__(
        self,
        encoder: ContextEncoder,
        windows: Windows,
        settings: TraitSettings,
        device: str,
        pair_loss: PairLoss = same_driver_loss,
    ) -> None:
        self._encoder, self._windows, self._settings = encoder, windows, settings
        self._device = device
        self.average = AverageLearner(encoder, settings.imitation_rate)
        rates = settings.encoder_rate, settings.weight_decay
        self.self_supervision = SelfSupervision(encoder, *rates, pair_loss)

    def learn_average(self, rng: np.random.Generator, progress: float) -> dict[str, float]:
        """Make one update of the average driver's policy; see :class:`AverageLearner`."""
        which = self._windows.draw(rng, self._settings.expert_pools, self._settings.pool)
        return self.average.learn(self._windows.batch(which, self._device), progress)

    def prepare(self, rng: np.random.Generator) -> None:
        """Take the units of the encoder's means, once the average driver is known."""
        which = self._windows.draw(rng, PREPARING_POOLS, self._settings.pool)
        self._encoder.prepare(self._windows.batch(which, self._device))

    def learn_self(self, rng: np.random.Generator, progress: float) -> dict[str, float]:
        """Make one update of the encoder; see :class:`SelfSupervision`."""
        settings = self._settings
        which = self._windows.draw_drivers(rng, settings.drivers_per_update, settings.pool)
        return self.self_supervision.learn(self._windows.batch(which, self._device), progress)
