r"""Learned models of latent driver traits, in NumPy alone, so that using them needs no torch.

A :class:`TraitModel` holds the three parts of the paper's latent model, in double precision:

- the context encoder :math:`q(z | τ)`: an LSTM reads a window of driving, its last hidden states
  are averaged over a pool of windows of one driver, and two linear layers return mean and
  log-variance of z;
- the reward :math:`f(s, a, s', z) = g(s, a, z) + γ h(s', z) - h(s, z)`;
- the policy :math:`π(a | s, z)`.

Here s is a situation x_t, an input before the car acts, and a the applied action v_t. v_t depends
on more than the road: a distracted driver repeats v_{t-1}, and an alert has effects in its own step
and in later ones. So a situation holds the observed state s_t, standardised by the demonstrations,
v_{t-1} and the steps since the last alert, the latter two one-hot. All of it can be observed; it
holds neither d, i, c, a^H, traits nor the inflated lidar.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hmi_marl.agents.learned.cards import CardFormat, checked_reads, find_card, part_shapes
from hmi_marl.agents.learned.network import (
    Network,
    NetworkConfig,
    Weights,
    below_zero,
    part_of,
    sigmoid,
)
from hmi_marl.checks import Checked, Count, Share, Units
from hmi_marl.envs.worlds import VEHICLE_ACTIONS

ACTIONS = len(VEHICLE_ACTIONS)
LONG_AGO = 10
"""Steps after which an alert counts as long ago: 2 s at 5 Hz."""
EXTRA = ACTIONS + LONG_AGO + 1
"""Columns of a situation after the observed state: v_{t-1} and the steps since the last alert."""


@dataclass
class Recent:
    """Memory of N drives for situations: v_{t-1} and the steps since the last alert."""

    count: int
    """N."""
    applied: NDArray[np.int64] = field(init=False)
    """v_{t-1}, shape (N,); -1 before the first step."""
    since_alert: NDArray[np.int64] = field(init=False)
    """Steps since the last alert, shape (N,): 0 if it is given now, ``LONG_AGO`` if none was."""

    def __post_init__(self) -> None:
        self.applied = np.full(self.count, -1)
        self.since_alert = np.full(self.count, LONG_AGO)

    def forget(self, which: NDArray[np.bool_]) -> None:
        """Begin new drives where ``which``, shape (N,), is set."""
        self.applied = np.where(which, -1, self.applied)
        self.since_alert = np.where(which, LONG_AGO, self.since_alert)

    def situation(
        self, states: NDArray[np.float32], alerts: NDArray[np.int64]
    ) -> NDArray[np.float32]:
        """Return x_t, shape (N, D + EXTRA), from s_t, shape (N, D), and a^A_t, shape (N,).

        The alert is remembered; pass the following v_t to :meth:`acted`.
        """
        self.since_alert = np.where(alerts == 1, 0, np.minimum(self.since_alert + 1, LONG_AGO))
        width = states.shape[1]
        x = np.empty((len(states), width + EXTRA), np.float32)
        x[:, :width] = states
        x[:, width : width + ACTIONS] = self.applied[:, None] == np.arange(ACTIONS)
        x[:, width + ACTIONS :] = self.since_alert[:, None] == np.arange(LONG_AGO + 1)
        return x

    def acted(self, applied: NDArray[np.int64]) -> None:
        """Remember the applied actions v_t, shape (N,)."""
        self.applied = applied


def situations(
    states: NDArray[np.float32], actions: NDArray[np.int64], alerts: NDArray[np.int64]
) -> NDArray[np.float32]:
    """Return x_0 to x_{T-1} of E drives, shape (E, T, D + EXTRA).

    Args:
        states: s_t before step t, shape (E, T, D).
        actions: v_t, shape (E, T); -1 after a drive's end.
        alerts: a^A_t, 0 or 1, shape (E, T).
    """
    recent = Recent(len(states))
    x = np.empty((*states.shape[:2], states.shape[2] + EXTRA), np.float32)
    for t in range(states.shape[1]):
        x[:, t] = recent.situation(states[:, t], alerts[:, t])
        recent.acted(actions[:, t])
    return x


PARTS = ("reward", "potential", "policy")
"""Networks besides the encoder: g, h and π."""
_CHUNK = 512
"""Windows encoded together; bounds memory."""


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
    encoder_units: Units = 128
    """H, units of the recurrent layer."""
    pool: Count = 8
    """Windows of one driver that training averages over."""
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
            raise ValueError("only the encoder is recurrent: set encoder_units")

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
    def encoder_inputs(self) -> int:
        """Number of input columns of the encoder; see :func:`encoder_inputs`."""
        return self.situation_size + ACTIONS + LONG_AGO + 1

    @property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Names and shapes of the weights; the encoder's gates: input, forget, cell, output."""
        gates = 4 * self.encoder_units
        shapes: dict[str, tuple[int, ...]] = {
            "state.centre": (self.state_size,),
            "state.scale": (self.state_size,),
            "encoder.input_weight": (gates, self.encoder_inputs),
            "encoder.hidden_weight": (gates, self.encoder_units),
            "encoder.input_bias": (gates,),
            "encoder.hidden_bias": (gates,),
        }
        for head in ("mean", "log_variance"):
            shapes[f"{head}.weight"] = self.latent, self.encoder_units
            shapes[f"{head}.bias"] = (self.latent,)
        sizes = {part: (self.inputs(part), ACTIONS if part == "policy" else 1) for part in PARTS}
        return shapes | part_shapes(self, sizes)


FORMAT = CardFormat("hmi-marl traits 3", "trait model", TraitCard)
NAME = "traits.json"
"""File name of the card; the weights are in ``traits.safetensors`` next to it."""


class Latent(NamedTuple):
    """q(z | τ) of P pools, a Gaussian with independent components: μ and σ², shape (P, Z)."""

    mean: NDArray[np.float64]
    variance: NDArray[np.float64]


class EncoderState(NamedTuple):
    """Hidden and cell state of the encoder's LSTM in N windows, both of shape (N, H)."""

    hidden: NDArray[np.float64]
    cell: NDArray[np.float64]


class TraitModel:
    """Learned encoder, reward and trait-conditioned policy; weights as in ``card.shapes``.

    Raises:
        ValueError: weights that do not fit the card.
    """

    def __init__(self, card: TraitCard, weights: Weights) -> None:
        FORMAT.check(card, weights)
        self.card = card
        self.weights = weights
        self._weights = {name: values.astype(np.float64) for name, values in weights.items()}
        self._networks = {
            part: Network(getattr(card, part), part_of(weights, part)) for part in PARTS
        }

    def begin(self, count: int) -> EncoderState:
        """Return the encoder's state at the start of ``count`` windows."""
        nothing = np.zeros((count, self.card.encoder_units))
        return EncoderState(nothing, nothing)

    def read(
        self, state: EncoderState, x: NDArray[np.float32], actions: NDArray[np.int64]
    ) -> EncoderState:
        """Return the encoder's state after a step: situations (N, D + EXTRA), actions v_t (N,)."""
        w = self._weights
        inputs = encoder_inputs(self.standardise(x), actions)
        gates = inputs @ w["encoder.input_weight"].T + w["encoder.input_bias"]
        gates += state.hidden @ w["encoder.hidden_weight"].T + w["encoder.hidden_bias"]
        let_in, keep, new, show = np.split(gates, 4, axis=1)
        cell = sigmoid(keep) * state.cell + sigmoid(let_in) * np.tanh(new)
        return EncoderState(sigmoid(show) * np.tanh(cell), cell)

    def standardise(self, x: NDArray[np.float32]) -> NDArray[np.float32]:
        """Standardise the states of situations (..., D + EXTRA) by the demonstrations."""
        return standardise(x, self.weights["state.centre"], self.weights["state.scale"])

    def encode(
        self,
        states: NDArray[np.float32],
        actions: NDArray[np.int64],
        alerts: NDArray[np.int64],
        length: NDArray[np.int64],
    ) -> NDArray[np.float64]:
        """Return the encoder's hidden state at the end of each of E windows, shape (E, H).

        Args:
            states: s_t before step t, shape (E, T, D).
            actions: applied actions v_t, shape (E, T).
            alerts: a^A_t, shape (E, T).
            length: steps of each window, shape (E,); later ones are ignored.

        Raises:
            ValueError: states of another size than in the card.
        """
        if states.shape[2] != self.card.state_size:
            raise ValueError(
                f"this trait model reads states of {self.card.state_size} columns, but got "
                f"{states.shape[2]}; use the scene that it was trained on"
            )
        chunks = []
        for part in (slice(k, k + _CHUNK) for k in range(0, len(states), _CHUNK)):
            x = situations(states[part], actions[part], alerts[part])
            now = self.begin(len(x))
            last = now.hidden
            for t in range(x.shape[1]):
                now = self.read(now, x[:, t], actions[part, t])
                last = np.where((t < length[part])[:, None], now.hidden, last)
            chunks.append(last)
        return np.concatenate(chunks)

    def latent(self, pooled: NDArray[np.float64]) -> Latent:
        """Return q(z | τ) for hidden states averaged over a driver's windows, shape (P, H)."""
        w = self._weights
        mean = pooled @ w["mean.weight"].T + w["mean.bias"]
        log_variance = pooled @ w["log_variance.weight"].T + w["log_variance.bias"]
        return Latent(mean, np.exp(log_variance))

    def policy(self, x: NDArray[np.float32], z: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return log π(a | s, z), shape (N, 5), in situations (N, D + EXTRA)."""
        logits = self._networks["policy"](_with_z(self.standardise(x), z))
        logits = below_zero(logits)
        return logits - np.log(np.exp(logits).sum(axis=1, keepdims=True))

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


def load_traits(place: str | Path) -> TraitModel:
    """Load a trait model from the folder of a run, the ``.json`` itself, or ``trained:NAME``.

    Raises:
        FileNotFoundError, ValueError: see :func:`find_card` and :meth:`CardFormat.read`.
    """
    path = find_card(place, "traits", "trait model", "; learn one with hmi-marl traits train")
    return TraitModel(*FORMAT.read(path))


def standardise(
    x: NDArray[np.float32], centre: NDArray[np.floating], scale: NDArray[np.floating]
) -> NDArray[np.float32]:
    """Replace the states s of situations (..., D + EXTRA) by (s - centre) / scale, both (D,)."""
    out = x.astype(np.float32, copy=True)
    out[..., : len(centre)] -= centre.astype(np.float32)
    out[..., : len(centre)] /= scale.astype(np.float32)
    return out


def encoder_inputs(x: NDArray[np.float32], actions: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the encoder's inputs for standardised situations (N, D + EXTRA), actions v_t (N,).

    They are the situation, the action and, for each number of steps since the last alert, whether
    the action repeats the last one, so that averages show how a driver's lapses depend on alerts.
    """
    done = actions[:, None] == np.arange(ACTIONS)
    before, since = x[:, -EXTRA : ACTIONS - EXTRA], x[:, ACTIONS - EXTRA :]
    repeated = (before * done).sum(axis=1, keepdims=True)
    return np.concatenate([x, done, repeated * since], axis=1, dtype=np.float64)


def _with_z(x: NDArray[np.float32], z: NDArray[np.float64]) -> NDArray[np.float32]:
    rows = np.broadcast_to(z, (len(x), z.shape[-1])).astype(np.float32)
    return np.concatenate([x, rows], axis=1)
