r"""Judge a trait model by people of whom it has seen nothing: strangers, and named types.

Strangers are drivers of a continuous population whom the model has not learned from. One half of
them fits the probes that read traits from z, the other half is judged.

Types are named from one labelled pool each, by the likelihood that the posteriors themselves give:
if both estimate one z, :math:`μ_k - μ_l \sim N(0, σ_k^2 + σ_l^2)`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hmi_marl.agents.learned.trait_encoder import Latent
from hmi_marl.agents.learned.trait_model import TraitModel
from hmi_marl.demonstrations.dataset import MISSING, Demonstrations, disjoint_pools
from hmi_marl.envs.drivers import TRAIT_NAMES
from hmi_marl.experiments.latent_traits.probes import TraitR2, predict_traits, trait_r2
from hmi_marl.reporting.statistics import Estimate, accuracy

MIN_STRANGERS = 4
"""Least strangers to read traits of: two fit the probes, and two are judged."""
DRAWS = 20
"""Choices of the labelled pools, over which naming is averaged."""


@dataclass(frozen=True)
class TraitReading:
    """z of the judged strangers' pools, and the traits that are read from it."""

    means: NDArray[np.float64]
    """Posterior means of z, shape (P, Z)."""
    traits: NDArray[np.float64]
    """True traits, shape (P, T); means over a pool if they drift."""
    predicted: NDArray[np.float64]
    """Traits as a small network reads them from z, shape (P, T)."""
    drivers: int
    """Strangers who are judged."""
    r2: dict[str, TraitR2]
    """R² by trait."""


@dataclass(frozen=True)
class Naming:
    """Accuracy of naming types from one labelled pool each."""

    windows: int
    """Windows of an unlabelled pool."""
    named: Estimate
    """Share that is named right, over several choices of the labelled pools."""
    chance: float
    """1 / types."""


def strangers_pools(
    driver: NDArray[np.int64], size: int
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return pools of strangers' windows, (P, size), and which of these fit the probes, (P,).

    ``driver`` is that of each window, shape (E,); -1 if not known.

    Raises:
        ValueError: fewer than four drivers have a pool.
    """
    pools = disjoint_pools(driver, size)
    who = np.unique(driver[pools[:, 0]], return_inverse=True)[1]
    drivers = int(who.max()) + 1 if len(who) else 0
    if drivers < MIN_STRANGERS:
        raise ValueError(
            f"traits are regressed over {MIN_STRANGERS} drivers or more with {size} windows "
            f"each, but the population has {drivers}"
        )
    return pools, who % 2 == 0


def read_traits(
    model: TraitModel, population: Demonstrations, size: int, seed: int = 0
) -> TraitReading:
    """Measure R² of each trait from z, over drivers that the model has not learned from.

    One half of the drivers, with pools of ``size`` windows, fits; the other half is judged.

    Raises:
        ValueError: the truth is not known; or see :func:`strangers_pools`.
    """
    truth = population.truth
    if truth is None:
        raise ValueError("traits can be regressed only where the truth is known")
    pools, fits = strangers_pools(population.observed.driver, size)
    z = model.latents(model.encode(population.observed), pools).mean
    traits = truth.traits_of(pools)
    sides = z[fits], traits[fits], z[~fits]
    predicted = predict_traits(*sides, seed)
    return TraitReading(
        z[~fits],
        traits[~fits],
        predicted,
        len(np.unique(population.observed.driver[pools[~fits, 0]])),
        trait_r2(*sides, traits[~fits], TRAIT_NAMES, seed, predicted),
    )


def name_types(
    model: TraitModel,
    sums: NDArray[np.float64],
    driver: NDArray[np.int64],
    sizes: Sequence[int],
    seed: int = 0,
) -> list[Naming]:
    """Name the types of drivers whose windows are known by one labelled pool of each alone.

    Args:
        model: trait model, whose own pool is the size of the labelled ones.
        sums: :meth:`TraitModel.encode` of E windows.
        driver: type of each window, shape (E,); -1 if not known.
        sizes: windows of the pools that are named.
        seed: draws the labelled pools.

    Raises:
        ValueError: see :func:`name_by`.
    """
    return name_by(lambda pools: model.latents(sums, pools), driver, model.card.pool, sizes, seed)


def name_by(
    latents: Callable[[NDArray[np.int64]], Latent],
    driver: NDArray[np.int64],
    known: int,
    sizes: Sequence[int],
    seed: int = 0,
    scores: Callable[[Latent, Latent], NDArray[np.float64]] | None = None,
) -> list[Naming]:
    """Name types as :func:`name_types` does, by any encoder and any scores.

    Args:
        latents: returns the posteriors of pools, given the indices of their windows, (P, n).
        driver: type of each window, shape (E,); -1 if not known.
        known: windows of the labelled pools.
        sizes: windows of the pools that are named.
        seed: draws the labelled pools.
        scores: returns for P pools and C labelled ones how well they go together, (P, C); by
            default :func:`log_likelihoods`.

    Raises:
        ValueError: fewer than two types, or a type with no pool beside a labelled one.
    """
    types, compare = np.unique(driver[driver != MISSING]), scores or log_likelihoods
    if len(types) < 2:
        raise ValueError("naming types takes two or more who are known by name")
    rng = np.random.default_rng(seed)
    fewest, least = min(int((driver == who).sum()) for who in types), known + max(sizes)
    if fewest < least:
        raise ValueError(
            f"naming types takes {least} windows of each, but of one there are {fewest}; "
            "demonstrate more"
        )
    right: dict[int, list[NDArray[np.bool_]]] = {size: [] for size in sizes}
    for _ in range(DRAWS):
        labelled = np.stack(
            [rng.choice(np.flatnonzero(driver == who), known, replace=False) for who in types]
        )
        rest = driver.copy()
        rest[labelled] = MISSING
        prototypes = latents(labelled)
        for size in sizes:
            pools = disjoint_pools(rest, size)
            named = types[compare(latents(pools), prototypes).argmax(axis=1)]
            right[size].append(named == driver[pools[:, 0]])
    # The draws judge the same windows, so they count once.
    return [
        Naming(size, accuracy(np.concatenate(found), len(found[0])), 1 / len(types))
        for size, found in right.items()
    ]


def log_likelihoods(of: Latent, prototypes: Latent) -> NDArray[np.float64]:
    """Return log N(μ_k - μ_l; 0, σ_k² + σ_l²) of P pools and C prototypes, shape (P, C)."""
    variance = of.variance[:, None] + prototypes.variance[None]
    squares = (of.mean[:, None] - prototypes.mean[None]) ** 2 / variance
    return -0.5 * (squares + np.log(variance) + np.log(2 * np.pi)).sum(axis=2)
