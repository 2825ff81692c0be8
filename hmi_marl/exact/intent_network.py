"""Driver policies that are feed-forward networks, so that compiled loops can ask them.

A policy with a method ``feedforward()`` that returns a :class:`FeedForward` is computed in compiled
loops; any other one is asked by its method ``probabilities``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hmi_marl.envs.drivers import TRAIT_NAMES
from hmi_marl.envs.observations import Layout
from hmi_marl.exact.identify import StochasticPolicy

_ACTIVATIONS = ("relu", "elu", "tanh")


@dataclass(frozen=True, eq=False)
class FeedForward:
    """Network from columns of the driver's observation to the logits of a^H."""

    columns: NDArray[np.int64]
    """Columns that it reads, in their order, shape (C,)."""
    layers: tuple[tuple[NDArray[np.float64], NDArray[np.float64]], ...]
    """W, shape (out, in), and b, shape (out,), of each layer: x becomes W x + b."""
    activation: str
    """Activation after each layer but the last: relu, elu or tanh."""


class IntentNetwork:
    """Arrays of a network as the compiled loop takes them, with the traits as the last inputs.

    Args:
        network: of the policy.
        layout: of the driver's observation.
    """

    def __init__(self, network: FeedForward, layout: Layout) -> None:
        traits = layout.columns(["traits"]) if "traits" in layout else np.zeros(0, np.int64)
        is_trait = np.isin(network.columns, traits)
        (first, bias), *others = network.layers
        of_traits = np.zeros((len(TRAIT_NAMES), len(bias)))
        of_traits[network.columns[is_trait] - traits[:1]] = first.T[is_trait]
        rows = [first.T[~is_trait], of_traits, bias]
        for weight, bias in others:
            rows += [weight.T, bias]
        self._columns = network.columns[~is_trait]
        inputs = len(self._columns) + len(TRAIT_NAMES)
        self._sizes = np.array([inputs, *(len(bias) for _, bias in network.layers)])
        self._weights = np.concatenate([each.ravel() for each in rows]).astype(np.float64)
        self._activation = _ACTIVATIONS.index(network.activation)

    @property
    def kernel(self) -> Any:
        """The compiled loop."""
        from hmi_marl.exact.trait_kernels import intend_windows  # numba is slow to import

        return intend_windows

    def arrays(self, policy: StochasticPolicy) -> tuple[Any, ...]:
        """Arguments of the loop that describe the policy."""
        greedy = bool(getattr(policy, "greedy", False))
        return self._columns, self._sizes, self._weights, self._activation, greedy

    def room(self, windows: int) -> NDArray[np.float64]:
        """Room for the layers of each window."""
        return np.empty((windows, 3, int(self._sizes.max())))


def network_of(policy: StochasticPolicy, layout: Layout) -> IntentNetwork | None:
    """Return a policy's network, or None if it is no feed-forward network."""
    describe = getattr(policy, "feedforward", None)
    network = describe() if callable(describe) else None
    return None if network is None else IntentNetwork(network, layout)
