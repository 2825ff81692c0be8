r"""The context encoder q(z | τ) of a trait model, in NumPy alone.

Features of every step cover the last ``span`` steps, and their sums over all steps of all windows
are what z follows from:

.. math::
    u_t &= \mathrm{relu}(W_u [b_t, \mathrm{relu}(W_s s_t)]) \\
    w_t &= \mathrm{relu}(\textstyle\sum_{k<K} W_k u_{t-k}) \\
    (μ, \log σ^2) &= \mathrm{head}(\textstyle\sum_t w_t / n, \log n)

with n steps. So windows may have any length, pools any number of windows, and a trip under way is
read step by step (:meth:`Encoder.read`). Rates such as β and α are means over time, which a last
hidden state would have to carry over a hundred steps.

b_t is what shows attention: v_{t-1}, v_t, the steps since the last alert, the same where v_t
repeats v_{t-1}, and how likely v_t and v_{t-1} were for the average driver, π(a | s) learned from
all demonstrations. The observed state s_t, which shows inflation alone, has a layer of its own, so
that its many columns do not drown the few of b_t.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hmi_marl.agents.learned.network import Network, NetworkConfig, Weights, part_of, part_shapes
from hmi_marl.agents.learned.situations import ACTIONS, EXTRA, LONG_AGO, situations
from hmi_marl.checks import Checked, Count, Units

LEAST_LOG = -6.0
"""Least log probability that the encoder reads, so that one surprise does not outweigh a window."""
COUNT_SCALE = 0.2
"""Factor on log n, which lies between 0 and 7."""
_CHUNK = 512
"""Windows encoded together; bounds memory."""


@dataclass(frozen=True)
class EncoderConfig(Checked):
    """Sizes of the context encoder.

    Raises:
        ValueError, TypeError: a size out of its range, or a recurrent network.
    """

    state_features: Units = 32
    """Features of the observed state."""
    step_features: Units = 32
    """Features of a step."""
    span: Count = 10
    """Steps that a feature covers."""
    features: Units = 64
    """Features that are averaged over time."""
    head: NetworkConfig = field(default_factory=lambda: NetworkConfig((128,)))
    """Network from the averages to z."""
    average: NetworkConfig = field(default_factory=lambda: NetworkConfig((64, 64)))
    """Network of the average driver's policy π(a | s)."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("head", "average"):
            if getattr(self, name).rnn_hidden_dim:
                raise ValueError(f"{name} has no recurrent layer: set {name}.rnn_hidden_dim to 0")

    def shapes(self, state_size: int, latent: int) -> dict[str, tuple[int, ...]]:
        """Names and shapes of the weights, for states of so many columns and z of size Z."""
        shapes: dict[str, tuple[int, ...]] = {
            "state_layer.weight": (self.state_features, state_size),
            "state_layer.bias": (self.state_features,),
            "step_layer.weight": (self.step_features, BEHAVIOUR + self.state_features),
            "step_layer.bias": (self.step_features,),
            "span_layer.weight": (self.span, self.features, self.step_features),
            "span_layer.bias": (self.features,),
        }
        networks = {
            "head": (self.features + 1, 2 * latent),
            "average": (state_size + EXTRA, ACTIONS),
        }
        shapes |= part_shapes(self, networks)
        return {f"encoder.{name}": shape for name, shape in shapes.items()}


BEHAVIOUR = EXTRA + ACTIONS + LONG_AGO + 1 + 2
"""Columns of b_t."""


class Latent(NamedTuple):
    """q(z | τ) of P pools, a Gaussian with independent components: μ and σ², shape (P, Z)."""

    mean: NDArray[np.float64]
    variance: NDArray[np.float64]


class EncoderState(NamedTuple):
    """What the encoder keeps of N windows under way."""

    recent: NDArray[np.float64]
    """Features u of the last steps, the newest first, shape (N, span - 1, step_features)."""
    sums: NDArray[np.float64]
    """Sums over the steps, as :meth:`Encoder.encode` returns them, shape (N, features + 1)."""


class Encoder:
    """The encoder with its weights, named as in :meth:`EncoderConfig.shapes`."""

    def __init__(self, config: EncoderConfig, weights: Weights, latent: int) -> None:
        own = part_of(weights, "encoder")
        self.config, self._latent = config, latent
        self._weights = {name: values.astype(np.float64) for name, values in own.items()}
        by_step = self._weights["span_layer.weight"].swapaxes(1, 2)  # (span, step_features, F)
        self._span = by_step.reshape(-1, config.features)
        self._head = Network(config.head, part_of(own, "head"))
        self._average = Network(config.average, part_of(own, "average"))
        self._centre, self._scale = weights["state.centre"], weights["state.scale"]

    def begin(self, count: int) -> EncoderState:
        """Return the state at the start of ``count`` windows."""
        config = self.config
        recent = np.zeros((count, config.span - 1, config.step_features))
        return EncoderState(recent, np.zeros((count, config.features + 1)))

    def read(
        self, state: EncoderState, x: NDArray[np.float32], actions: NDArray[np.int64]
    ) -> EncoderState:
        """Return the state after a step: situations (N, D + EXTRA), actions v_t (N,)."""
        w = self._weights
        now = self._step_features(x, actions)
        covered = np.concatenate([now[:, None], state.recent], axis=1)
        features = covered.reshape(len(covered), -1) @ self._span
        features = np.maximum(features + w["span_layer.bias"], 0.0)
        taken = np.ones((len(features), 1))
        sums = state.sums + np.concatenate([features, taken], axis=1)
        return EncoderState(covered[:, :-1], sums)

    def _step_features(
        self, x: NDArray[np.float32], actions: NDArray[np.int64]
    ) -> NDArray[np.float64]:
        w = self._weights
        x = standardise(x, self._centre, self._scale)
        seen = x[:, :-EXTRA].astype(np.float64)
        state = np.maximum(seen @ w["state_layer.weight"].T + w["state_layer.bias"], 0.0)
        read = [behaviour(x, actions, self._average.log_probabilities(x)), state]
        features = np.concatenate(read, axis=1) @ w["step_layer.weight"].T + w["step_layer.bias"]
        return np.maximum(features, 0.0)

    def encode(
        self,
        states: NDArray[np.float32],
        actions: NDArray[np.int64],
        alerts: NDArray[np.int64],
        length: NDArray[np.int64],
    ) -> NDArray[np.float64]:
        """Return sums over the steps of each of E windows, shape (E, features + 1).

        The last column is the number of steps. Pools are made by adding the rows of their windows.

        Args:
            states: s_t before step t, shape (E, T, D).
            actions: applied actions v_t, shape (E, T).
            alerts: a^A_t, shape (E, T).
            length: steps of each window, shape (E,); later ones are ignored.

        Raises:
            ValueError: states of another size than in the card.
        """
        size = len(self._centre)
        if states.shape[2] != size:
            raise ValueError(
                f"this trait model reads states of {size} columns, but got {states.shape[2]}; use "
                "the scene that it was trained on"
            )
        chunks = []
        for part in (slice(k, k + _CHUNK) for k in range(0, len(states), _CHUNK)):
            x = situations(states[part], actions[part], alerts[part])
            now = self.begin(len(x))
            sums = now.sums
            for t in range(x.shape[1]):
                now = self.read(now, x[:, t], actions[part, t])
                sums = np.where((t < length[part])[:, None], now.sums, sums)
            chunks.append(sums)
        return np.concatenate(chunks)

    def latent(self, sums: NDArray[np.float64]) -> Latent:
        """Return q(z | τ) for sums over the steps of all windows of a pool, (P, features + 1).

        Raises:
            ValueError: a pool without a step.
        """
        steps = sums[:, -1:]
        if (steps < 1).any():
            raise ValueError("z follows from at least one step, but a pool has none")
        read = np.concatenate([sums[:, :-1] / steps, COUNT_SCALE * np.log(steps)], axis=1)
        out = self._head(read)
        return Latent(out[:, : self._latent], np.exp(out[:, self._latent :]))


def behaviour(
    x: NDArray[np.float32], actions: NDArray[np.int64], log_average: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return b_t, shape (N, BEHAVIOUR), for situations (N, D + EXTRA) and actions v_t (N,).

    It holds v_{t-1} and the steps since the last alert, both one-hot as in the situation; v_t,
    one-hot; the steps since the last alert once more where v_t repeats v_{t-1}; and log π(v_t | s)
    and log π(v_{t-1} | s) of the average driver, shape (N, 5), 0 where there is no such action.
    """
    extra = x[:, -EXTRA:]
    before, since = extra[:, :ACTIONS], extra[:, ACTIONS:]
    done = (actions[:, None] == np.arange(ACTIONS)).astype(np.float64)
    repeated = (before * done).sum(axis=1, keepdims=True)
    likely = np.maximum(log_average, LEAST_LOG)
    of_both = [(likely * which).sum(axis=1, keepdims=True) for which in (done, before)]
    return np.concatenate([extra, done, repeated * since, *of_both], axis=1, dtype=np.float64)


def standardise(
    x: NDArray[np.float32], centre: NDArray[np.floating], scale: NDArray[np.floating]
) -> NDArray[np.float32]:
    """Replace the states s of situations (..., D + EXTRA) by (s - centre) / scale, both (D,)."""
    out = x.astype(np.float32, copy=True)
    out[..., : len(centre)] -= centre.astype(np.float32)
    out[..., : len(centre)] /= scale.astype(np.float32)
    return out
