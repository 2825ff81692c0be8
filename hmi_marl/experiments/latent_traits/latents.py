"""z of pools of windows, as all judgements of a trait model take it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hmi_marl.agents.learned.trait_encoder import Latent
from hmi_marl.agents.learned.trait_model import TraitModel
from hmi_marl.demonstrations.dataset import MISSING, Observed


def encode(model: TraitModel, observed: Observed) -> NDArray[np.float64]:
    """Encode every window into sums over its steps, shape (E, features + 1)."""
    return model.encoder.encode(observed.states, observed.actions, observed.alerts, observed.length)


def latents(model: TraitModel, sums: NDArray[np.float64], pools: NDArray[np.int64]) -> Latent:
    """Return q(z | τ) of P pools, given :func:`encode` of E windows and the pools (P, n)."""
    return model.encoder.latent(sums[pools].sum(axis=1))


def mean_latents(
    model: TraitModel, sums: NDArray[np.float64], pools: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Return the mean of z, (P, Z), given :func:`encode` of E windows and their pools (P, n)."""
    return latents(model, sums, pools).mean


def disjoint_pools(driver: NDArray[np.int64], size: int) -> NDArray[np.int64]:
    """Make pools of ``size`` windows of one known driver each, in order, no window in two.

    Windows have drivers (E,), -1 if not known. Returns indices of windows, shape (P, size); windows
    that are left over are left out.
    """
    pools = [np.zeros((0, size), np.int64)]
    for who in np.unique(driver[driver != MISSING]):
        own = np.flatnonzero(driver == who)
        whole = len(own) // size * size
        pools.append(own[:whole].reshape(-1, size))
    return np.concatenate(pools)
