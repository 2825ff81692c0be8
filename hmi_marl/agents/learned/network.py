"""Networks of learned policies for acting, in NumPy alone, so that playing needs no torch.

Training builds the same network in torch (:mod:`hmi_marl.training.ppo.models`) and passes on its
weights. Here they act in double precision, so that an action does not depend on how many teams
share a batch.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from hmi_marl.checks import Checked, Units, UnitsOrZero, Whole
from hmi_marl.files import sha256

Activation = Literal["relu", "elu", "tanh"]
Weights = Mapping[str, NDArray[np.floating]]


_LAYERS = Whole(1, 100)


@dataclass(frozen=True)
class NetworkConfig(Checked):
    """Sizes of one network.

    Raises:
        ValueError, TypeError: no hidden layer or too many, a size out of its range, or an unknown
            activation.
    """

    hidden_dims: tuple[Units, ...] = (64, 64)
    """Units of each hidden layer, up to 100 layers."""
    activation: Activation = "relu"
    """Activation after each hidden layer: relu, elu or tanh."""
    rnn_hidden_dim: UnitsOrZero = 0
    """Units of a recurrent layer (GRU), whose state is an additional input; 0 for none."""

    def __post_init__(self) -> None:
        super().__post_init__()
        _LAYERS("the number of hidden_dims", len(self.hidden_dims))

    def shapes(self, inputs: int, outputs: int) -> dict[str, tuple[int, ...]]:
        """Return names and shapes of the weights for these numbers of inputs and outputs.

        Layers map x to W x + b, W of shape (out, in). The three gates of the GRU, reset, update
        and new, are stacked in this order.
        """
        shapes: dict[str, tuple[int, ...]] = {}
        if self.rnn_hidden_dim:
            gates = 3 * self.rnn_hidden_dim
            shapes["memory.input_weight"] = gates, inputs
            shapes["memory.hidden_weight"] = gates, self.rnn_hidden_dim
            shapes["memory.input_bias"] = (gates,)
            shapes["memory.hidden_bias"] = (gates,)
        sizes = (self.rnn_hidden_dim + inputs, *self.hidden_dims, outputs)
        for layer, (size_in, size_out) in enumerate(pairwise(sizes)):
            shapes[f"layer{layer}.weight"] = size_out, size_in
            shapes[f"layer{layer}.bias"] = (size_out,)
        return shapes


class Network:
    """One network, with the recurrent state of N teams if it is recurrent.

    Weights have the names of :meth:`NetworkConfig.shapes`.
    """

    def __init__(self, config: NetworkConfig, weights: Weights) -> None:
        self.config = config
        self._weights = {name: values.astype(np.float64) for name, values in weights.items()}
        self._memory = np.zeros((0, config.rnn_hidden_dim))

    def forget(self, count: int, which: NDArray[np.bool_] | None = None) -> None:
        """Reset the recurrent state of the marked teams out of ``count``; of all by default."""
        if which is None:
            self._memory = np.zeros((count, self.config.rnn_hidden_dim))
        else:
            self._memory = np.where(which[:, None], 0.0, self._memory)

    def __call__(
        self, inputs: NDArray[np.float32], which: NDArray[np.bool_] | None = None
    ) -> NDArray[np.float64]:
        """Return outputs of shape (N, outputs) and update the recurrent state.

        Args:
            inputs: inputs of N teams, shape (N, inputs).
            which: teams to update the recurrent state of, shape (N,); all by default.

        Raises:
            RuntimeError: a recurrent state of another number of teams.
        """
        x = inputs.astype(np.float64)
        if self.config.rnn_hidden_dim:
            memory = self._remember(x)
            x = np.concatenate([memory, x], axis=1)
            self._memory = (
                memory if which is None else np.where(which[:, None], memory, self._memory)
            )
        last = len(self.config.hidden_dims)
        for layer in range(last + 1):
            x = _product(x, self._weights[f"layer{layer}.weight"])
            x += self._weights[f"layer{layer}.bias"]
            if layer < last:
                x = _ACTIVATIONS[self.config.activation](x)
        return x

    def log_probabilities(self, inputs: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return log probabilities, shape (N, outputs), of logits for inputs (N, inputs).

        Raises:
            FloatingPointError: see :func:`below_zero`.
        """
        return log_softmax(self(inputs))

    def _remember(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        w, old = self._weights, self._memory
        if len(old) != len(x):
            raise RuntimeError(
                "a recurrent policy needs to know when episodes begin: call reset(seeds) for "
                f"{len(x)} teams first"
            )
        seen = _product(x, w["memory.input_weight"]) + w["memory.input_bias"]
        kept = _product(old, w["memory.hidden_weight"]) + w["memory.hidden_bias"]
        reset_in, update_in, new_in = np.split(seen, 3, axis=1)
        reset_old, update_old, new_old = np.split(kept, 3, axis=1)
        update = sigmoid(update_in + update_old)
        new = np.tanh(new_in + sigmoid(reset_in + reset_old) * new_old)
        return (1.0 - update) * new + update * old


_ONE_THREAD = 2**18
"""Multiplications of a matrix product up to which OpenBLAS uses a single thread."""
_FEWEST_ROWS = 16
"""Rows of a part below which cutting a product up costs more than it saves."""


def _product(x: NDArray[np.float64], weight: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return x W^T, shape (N, out), of x of shape (N, in) and W of shape (out, in).

    It is computed in parts of rows that BLAS gives to one thread. Its threads wait for each other
    actively: where other programs take some of the cores, a product of 512 rows takes 50 times as
    long on two threads as on one.
    """
    rows = _ONE_THREAD // weight.size
    if not _FEWEST_ROWS <= rows < len(x):
        return x @ weight.T
    result = np.empty((len(x), len(weight)))
    for first in range(0, len(x), rows):
        part = slice(first, first + rows)
        np.matmul(x[part], weight.T, out=result[part])
    return result


def part_shapes(card: object, sizes: Mapping[str, tuple[int, int]]) -> dict[str, tuple[int, ...]]:
    """Return shapes by ``part.NAME`` of a card's networks, from inputs and outputs of each."""
    return {
        f"{part}.{name}": shape
        for part, (inputs, outputs) in sizes.items()
        for name, shape in getattr(card, part).shapes(inputs, outputs).items()
    }


def part_of(weights: Weights, part: str) -> Weights:
    """Return the weights of one network among several, named ``part.NAME``, by NAME."""
    start = f"{part}."
    return {n.removeprefix(start): values for n, values in weights.items() if n.startswith(start)}


def digest_of(weights: Weights, names: Iterable[str]) -> str:
    """Return the SHA-256 checksum of the weights of these names, in their order."""
    arrays = (np.asarray(weights[name], np.float32, order="C") for name in names)
    return sha256(b"".join(array.tobytes() for array in arrays))


def below_zero(logits: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return logits, shape (N, K), less their maximum in each row.

    Raises:
        FloatingPointError: they are not finite, so no action follows from them.
    """
    highest = logits.max(axis=1, keepdims=True)
    if not np.isfinite(highest).all():
        raise FloatingPointError(
            "the logits of a learned policy are not finite: its learning has diverged, or what it "
            "observes is not finite; train it again with a lower learning rate"
        )
    return logits - highest


def log_softmax(logits: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the logarithms of the probabilities that logits, shape (N, K), stand for.

    Raises:
        FloatingPointError: see :func:`below_zero`.
    """
    below = below_zero(logits)
    return below - np.log(np.exp(below).sum(axis=1, keepdims=True))


def sigmoid(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return 1 / (1 + e^-x) without overflow."""
    return 0.5 + 0.5 * np.tanh(0.5 * x)


_ACTIVATIONS: dict[str, Callable[[NDArray[np.float64]], NDArray[np.float64]]] = {
    "relu": lambda x: np.maximum(x, 0.0, out=x),
    "elu": lambda x: np.where(x > 0, x, np.expm1(np.minimum(x, 0.0))),
    "tanh": lambda x: np.tanh(x, out=x),
}
"""Activations, which may be computed in place."""
