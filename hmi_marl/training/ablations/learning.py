"""Learn an encoder of some design from strangers, and encode windows by it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from hmi_marl.agents.learned.trait_encoder import Latent
from hmi_marl.demonstrations.dataset import numbers
from hmi_marl.demonstrations.stored import ObservedFile
from hmi_marl.envs.streams import Stream, mix
from hmi_marl.training.ablations.design import EncoderDesign
from hmi_marl.training.ablations.encoders import DesignedEncoder
from hmi_marl.training.runs.run import own_torch_state
from hmi_marl.training.traits.episodes import Episodes, Units
from hmi_marl.training.traits.self_supervision import EncoderLearning
from hmi_marl.training.traits.settings import TraitSettings
from hmi_marl.training.traits.windows import Windows

_CHUNK = 512
"""Windows encoded together; bounds memory."""


@dataclass(frozen=True, eq=False)
class LearnedEncoder:
    """An encoder that has learned."""

    encoder: DesignedEncoder
    units: Units
    """Units of the states that it has learned from."""

    def encode(self, dataset: Path) -> NDArray[np.float64]:
        """Return the sums of every window of a dataset, shape (E, F + 1).

        A file of their situations is made for the time being, in the folder of the dataset.

        Raises:
            FileNotFoundError, ValueError: there is no such dataset, or it is damaged.
        """
        stored = ObservedFile(dataset)
        episodes = Episodes.read(stored, np.ones(len(stored), np.bool_), dataset)
        windows = _unlabelled(replace(episodes, units=self.units))
        every, found = np.arange(len(stored)), []
        with torch.no_grad():
            for first in range(0, len(every), _CHUNK):
                batch = windows.batch(every[None, first : first + _CHUNK])
                found.append(self.encoder.sums(batch)[0].numpy().astype(np.float64))
        return np.concatenate(found)

    def latents(self, sums: NDArray[np.float64], pools: NDArray[np.int64]) -> Latent:
        """Return q(z | τ) of pools, indices (P, n) of windows, given their sums (E, F + 1)."""
        pooled = torch.from_numpy(sums[pools].sum(axis=1).astype(np.float32))
        with torch.no_grad():
            found = self.encoder.posterior(pooled, self.encoder.centre, self.encoder.scale)
        mean, variance = found.mean.numpy(), found.log_variance.exp().numpy()
        return Latent(mean.astype(np.float64), variance.astype(np.float64))


def learn_encoder(
    design: EncoderDesign,
    settings: TraitSettings,
    dataset: Path,
    strangers: int,
    windows: int,
    progress: Callable[[], Any] = tuple,
) -> LearnedEncoder:
    """Learn as the self-supervised setting does before anything drives.

    A file of the situations is made for the time being, in the folder of the dataset.

    Args:
        design: loss, pooling and inputs.
        settings: sizes, rates and seed; what is for adversarial IRL has no effect.
        dataset: folder of strangers' windows.
        strangers: number of drivers to learn from, the first of the dataset.
        windows: number of windows of each, the first ones.
        progress: called after each update.

    Raises:
        FileNotFoundError: there is no such dataset.
        FloatingPointError: learning diverges.
        ValueError: it is damaged, or holds too few drivers or windows.
    """
    stored = ObservedFile(dataset)
    learned = (stored.driver < strangers) & (numbers(stored.driver) < windows)
    if len(np.unique(stored.driver[learned])) < strangers or learned.sum() < strangers * windows:
        raise ValueError(f"{dataset} holds no {strangers} strangers with {windows} windows each")
    episodes = Episodes.read(stored, learned, dataset)
    with own_torch_state(settings.threads):
        torch.manual_seed(int(mix(settings.seed, Stream.LEARNING, 1)))
        encoder = DesignedEncoder(settings.card(episodes.layout), design)
        make_updates(encoder, _unlabelled(episodes), settings, progress)
    return LearnedEncoder(encoder, episodes.units)


def make_updates(
    encoder: DesignedEncoder,
    windows: Windows,
    settings: TraitSettings,
    progress: Callable[[], Any] = tuple,
) -> None:
    """Let an encoder learn, with the draws that a run of trait models makes; see its module."""
    learning = EncoderLearning(encoder, windows, settings, "cpu", encoder.pair_loss)
    count = settings.average_updates
    for k in range(count):
        learning.learn_average(_seeded(settings.seed, 4 * k), k / count)
        progress()
    learning.prepare(np.random.default_rng(int(mix(settings.seed, Stream.LEARNING, 2))))
    count = settings.encoder_updates
    for k in range(count):
        learning.learn_self(_seeded(settings.seed, 4 * k + 1), k / count)
        progress()


def _seeded(seed: int, counter: int) -> np.random.Generator:
    """Seed torch for one update, and return NumPy's generator for it."""
    drawn = int(mix(seed, Stream.LEARNING, 3 + counter))
    torch.manual_seed(drawn)
    return np.random.default_rng(drawn)


def _unlabelled(episodes: Episodes) -> Windows:
    return Windows(episodes, np.full(len(episodes), np.nan))
