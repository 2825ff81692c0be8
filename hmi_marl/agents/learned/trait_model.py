r"""Learned models of latent driver traits, in NumPy alone, so that using them needs no torch.

A :class:`TraitModel` holds the three parts of the paper's latent model, in double precision:

- the context encoder :math:`q(z | τ)`, which reads any number of windows of one driver
  (:mod:`hmi_marl.agents.learned.trait_encoder`);
- the reward :math:`f(s, a, s', z) = g(s, a, z) + γ h(s', z) - h(s, z)`;
- the policy :math:`π(a | s, z)`.

Here s is a situation x_t (:mod:`hmi_marl.agents.learned.situations`), whose observed state is
standardised by the demonstrations, and a the applied action v_t.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from hmi_marl.agents.learned.cards import CardFormat, checked_reads, find_card
from hmi_marl.agents.learned.network import (
    Network,
    NetworkConfig,
    Weights,
    digest_of,
    part_of,
    part_shapes,
)
from hmi_marl.agents.learned.situations import ACTIONS, EXTRA
from hmi_marl.agents.learned.trait_encoder import Encoder, EncoderConfig, Latent, standardise
from hmi_marl.checks import Checked, Count, Share, Units

PARTS = ("reward", "potential", "policy")
"""Networks besides the encoder: g, h and π."""


@dataclass(frozen=True)
class TraitCard(Checked):
    """Description of a trait model, without its weights.

    Raises:
        ValueError: sizes that make no model.
    """

    reads: tuple[tuple[str, int], ...]
    """Names and sizes of the parts of an observed state, in their order."""
    latent: Units = 2
    """Z, size of z."""
    encoder: EncoderConfig = field(default_factory=EncoderConfig)
    """Sizes of the context encoder."""
    pool: Count = 8
    """Windows of one driver that training pools."""
    gamma: Share = 0.98
    """γ of the reward's shaping."""
    reward: NetworkConfig = field(default_factory=lambda: NetworkConfig((32, 32)))
    """Network g."""
    potential: NetworkConfig = field(default_factory=lambda: NetworkConfig((32,)))
    """Network h."""
    policy: NetworkConfig = field(default_factory=lambda: NetworkConfig((32,)))
    """Network π."""
    training: dict[str, Any] = field(default_factory=dict)
    """How it was trained."""

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "reads", checked_reads(self.reads, "a trait model"))
        if any(getattr(self, part).rnn_hidden_dim for part in PARTS):
            raise ValueError("a trait model has no recurrent layer: set rnn_hidden_dim to 0")

    @property
    def state_size(self) -> int:
        """Number of columns of an observed state."""
        return sum(size for _, size in self.reads)

    @property
    def situation_size(self) -> int:
        """Number of columns of a situation."""
        return self.state_size + EXTRA

    def inputs(self, part: str) -> int:
        """Return the input columns of one of ``PARTS``: a situation, the action for g, and z."""
        return self.situation_size + (ACTIONS if part == "reward" else 0) + self.latent

    @property
    def encoder_shapes(self) -> dict[str, tuple[int, ...]]:
        """Names and shapes of the weights that z follows from."""
        units = {"state.centre": (self.state_size,), "state.scale": (self.state_size,)}
        return units | self.encoder.shapes(self.state_size, self.latent)

    @property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Names and shapes of the weights."""
        sizes = {part: (self.inputs(part), ACTIONS if part == "policy" else 1) for part in PARTS}
        return self.encoder_shapes | part_shapes(self, sizes)


FORMAT = CardFormat("hmi-marl traits 4", "trait model", TraitCard)
NAME = "traits.json"
"""File name of the card; the weights are in ``traits.safetensors`` next to it."""


class Windows(Protocol):
    """Windows of driving, E of at most T steps; see :meth:`Encoder.encode`."""

    @property
    def states(self) -> NDArray[np.float32]:
        """Observed states, shape (E, T, D)."""

    @property
    def actions(self) -> NDArray[np.int64]:
        """Applied actions v_t, shape (E, T)."""

    @property
    def alerts(self) -> NDArray[np.int64]:
        """Alerts a^A_t, shape (E, T)."""

    @property
    def length(self) -> NDArray[np.int64]:
        """Steps, shape (E,)."""


class TraitModel:
    """Learned encoder, reward and trait-conditioned policy; weights as in ``card.shapes``.

    Raises:
        ValueError: weights that do not fit the card.
    """

    def __init__(self, card: TraitCard, weights: Weights) -> None:
        FORMAT.check(card, weights)
        self.card = card
        self.weights = weights
        self.encoder = Encoder(card.encoder, weights, card.latent)
        """q(z | τ)."""
        self._networks = {
            part: Network(getattr(card, part), part_of(weights, part)) for part in PARTS
        }

    @property
    def digest(self) -> str:
        """SHA-256 checksum of the encoder's weights, which identifies the space of z."""
        return digest_of(self.weights, self.card.encoder_shapes)

    def standardise(self, x: NDArray[np.float32]) -> NDArray[np.float32]:
        """Standardise the states of situations (..., D + EXTRA) by the demonstrations."""
        return standardise(x, self.weights["state.centre"], self.weights["state.scale"])

    def encode(self, windows: Windows) -> NDArray[np.float64]:
        """Encode each of E windows into sums over its steps; see :meth:`Encoder.encode`."""
        return self.encoder.encode(windows.states, windows.actions, windows.alerts, windows.length)

    def latents(self, sums: NDArray[np.float64], pools: NDArray[np.int64]) -> Latent:
        """Return q(z | τ) of P pools, given :meth:`encode` of E windows and the pools (P, n)."""
        return self.encoder.latent(sums[pools].sum(axis=1))

    def policy(self, x: NDArray[np.float32], z: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return log π(a | s, z), shape (N, 5), in situations (N, D + EXTRA)."""
        return self._networks["policy"].log_probabilities(_with_z(self.standardise(x), z))

    def base_reward(
        self, x: NDArray[np.float32], actions: NDArray[np.int64], z: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return g(s, a, z), shape (N,), the reward without its shaping."""
        done = (actions[:, None] == np.arange(ACTIONS)).astype(np.float32)
        seen = np.concatenate([self.standardise(x), done], axis=1)
        return self._networks["reward"](_with_z(seen, z))[:, 0]

    def reward(
        self,
        x: NDArray[np.float32],
        actions: NDArray[np.int64],
        after: NDArray[np.float32],
        z: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """Return f(s, a, s', z), shape (N,), for steps from situations ``x`` to ``after``."""
        before, later = (
            self._networks["potential"](_with_z(self.standardise(s), z))[:, 0] for s in (x, after)
        )
        return self.base_reward(x, actions, z) + self.card.gamma * later - before


def save_traits(folder: Path, card: TraitCard, weights: Weights) -> Path:
    """Write a trait model into ``folder``; return the path of its card.

    Raises:
        ValueError: weights that do not fit the card.
    """
    return FORMAT.save(folder / NAME, card, weights)


def find_traits(place: str | Path) -> Path:
    """Return the path of a trait model's card; see :func:`load_traits`."""
    return find_card(place, "traits", "trait model", "; learn one with hmi-marl traits train")


def load_traits(place: str | Path) -> TraitModel:
    """Load a trait model from the folder of a run, the ``.json`` itself, or ``trained:NAME``.

    Raises:
        FileNotFoundError, ValueError: see :func:`find_card` and :meth:`CardFormat.read`.
    """
    return TraitModel(*FORMAT.read(find_traits(place)))


def _with_z(x: NDArray[np.float32], z: NDArray[np.float64]) -> NDArray[np.float32]:
    rows = np.broadcast_to(z, (len(x), z.shape[-1])).astype(np.float32)
    return np.concatenate([x, rows], axis=1)
