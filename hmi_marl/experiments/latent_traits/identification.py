"""What a trait model's latent space tells about the driver, beside the exact Bayes ceiling.

Everything is judged on windows that nothing was learned from. The probe and the centroids are
fitted on windows that the model did learn from, with the true names, in every setting alike.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hmi_marl.agents.learned.trait_model import TraitModel
from hmi_marl.demonstrations.dataset import MISSING, Demonstrations, Observed, Truth, held_out
from hmi_marl.envs.drivers import TRAIT_NAMES
from hmi_marl.exact.identify import Identification
from hmi_marl.experiments.latent_traits.ceiling import LIKES_HELP, Ceilings, ceilings
from hmi_marl.experiments.latent_traits.regression import TraitR2, trait_r2
from hmi_marl.experiments.latent_traits.separability import Separability, separability
from hmi_marl.experiments.latent_traits.settings import FEWEST_STRANGERS

WINDOWS = (1, 2, 4, 8, 16)
"""Windows seen of a driver."""


@dataclass(frozen=True)
class Hidden:
    """Windows as the encoder reads them, before they are pooled."""

    states: NDArray[np.float64]
    """Its hidden states at the end of each, shape (E, H)."""
    driver: NDArray[np.int64]
    """Who drove, shape (E,)."""

    @classmethod
    def of(cls, model: TraitModel, observed: Observed) -> Hidden:
        """Read every window."""
        o = observed
        return cls(model.encode(o.states, o.actions, o.alerts, o.length), o.driver)

    def pooled(self, pools: NDArray[np.int64]) -> NDArray[np.float64]:
        """Average hidden states of pools of windows: indices (P, n) to (P, H)."""
        return self.states[pools].mean(axis=1)


def disjoint_pools(driver: NDArray[np.int64], size: int) -> NDArray[np.int64]:
    """Pools of ``size`` windows of one known driver each, in their order, no window in two.

    Args:
        driver: of each window, shape (E,); -1 if not known.
        size: of the pools; windows that are left over are left out.

    Returns:
        Indices of windows, shape (P, size).
    """
    pools = [np.zeros((0, size), np.int64)]
    for who in np.unique(driver[driver != MISSING]):
        theirs = np.flatnonzero(driver == who)
        whole = len(theirs) // size * size
        pools.append(theirs[:whole].reshape(-1, size))
    return np.concatenate(pools)


@dataclass(frozen=True)
class Identified:
    """How well drivers are told apart from so many windows."""

    windows: int
    pools: int
    """Held-out pools that it was tried on."""
    types: Separability
    """Who drives."""
    preferences: Separability | None
    """Whether they like help; None if that is not known of them."""
    ceilings: Ceilings | None
    """What the exact Bayes classifier reaches on the same pools."""

    def as_json(self) -> dict[str, Any]:
        """JSON content."""
        return {
            "windows": self.windows,
            "pools": self.pools,
            "types": self.types.as_json(),
            "preferences": None if self.preferences is None else self.preferences.as_json(),
            "ceilings": None if self.ceilings is None else self.ceilings.as_json(),
        }


@dataclass(frozen=True)
class Embedding:
    """Held-out pools in latent space."""

    means: NDArray[np.float64]
    """Shape (P, Z)."""
    types: NDArray[np.int64]
    """Indices of ``names``, shape (P,)."""
    names: tuple[str, ...]


@dataclass(frozen=True)
class Split:
    """Demonstrations as a model's run took them."""

    learned: Demonstrations
    """Windows that it learned from."""
    unseen: Demonstrations
    """Windows that it did not."""

    @classmethod
    def of(cls, demonstrations: Demonstrations, share: float, most: int) -> Split:
        """Split them as a run does that holds out ``share``.

        Args:
            demonstrations: the dataset.
            share: of each driver's windows, the last ones.
            most: windows of each driver on either side; more are left out.

        Raises:
            ValueError: nothing was held out.
        """
        out = held_out(demonstrations.observed, share)
        if not out.any():
            raise ValueError("no window was held out of training, so there is nothing to judge by")
        parts = (demonstrations.take(~out), demonstrations.take(out))
        return cls(*(part.take(part.observed.number < most) for part in parts))


def pool_sizes(split: Split, pool: int, latent: int) -> tuple[int, ...]:
    """From how many windows drivers are told apart: ``WINDOWS``, and a model's own pool.

    Left out are those of which some driver has too few pools, on either side: a Gaussian in Z
    dimensions takes Z + 2.

    Args:
        split: of the demonstrations.
        pool: windows that a model pools.
        latent: Z, the size of its z.

    Raises:
        ValueError: too few windows for even the model's own pool, or fewer than two drivers.
    """
    names = split.unseen.observed.names
    if len(names) < 2:
        raise ValueError("drivers are told apart: there are two or more who are known by name")
    sides = (split.learned.observed.driver, split.unseen.observed.driver)
    counts = np.minimum(*(np.bincount(of[of != MISSING], minlength=len(names)) for of in sides))
    least = (latent + 2) * pool
    if counts.min() < least:
        raise ValueError(
            f"too few windows to judge by: it takes {least} of each driver that were learned from "
            f"and {least} that were held out (pools of {pool}, {latent + 2} of them for z of size "
            f"{latent}), but of {names[counts.argmin()]} there are {counts.min()}; demonstrate "
            "more, look at more with --windows, or learn with a smaller --pool or a larger "
            "--held-out; a population's drivers belong into a dataset of their own"
        )
    sizes = sorted({*WINDOWS, pool})
    return tuple(size for size in sizes if (latent + 2) * size <= counts.min())


def likes_help(demonstrations: Demonstrations) -> NDArray[np.int64] | None:
    """1 for windows of drivers who like help, 0 for others, (E,); None without the truth."""
    if demonstrations.truth is None:
        return None
    return (demonstrations.truth.traits[:, TRAIT_NAMES.index("eta")] >= LIKES_HELP).astype(np.int64)


def identify_drivers(
    model: TraitModel,
    split: Split,
    identification: Identification | None = None,
    windows: Sequence[int] = WINDOWS,
) -> tuple[list[Identified], Embedding]:
    """Accuracy by windows seen, and held-out pools of the model's own size in latent space.

    Args:
        model: the trait model.
        split: of the demonstrations.
        identification: of ``split.unseen`` by the exact classifier, candidates in the order of
            its names.
        windows: how many are seen; see :func:`pool_sizes`.

    Raises:
        ValueError: too few pools of some driver.
    """
    learned, unseen = (Hidden.of(model, part.observed) for part in (split.learned, split.unseen))
    help_learned, help_unseen = likes_help(split.learned), likes_help(split.unseen)
    rows = []
    for size in windows:
        fitted, judged = (disjoint_pools(hidden.driver, size) for hidden in (learned, unseen))
        z_fitted = model.latent(learned.pooled(fitted)).mean
        z = model.latent(unseen.pooled(judged)).mean
        preferences = None
        if help_learned is not None and help_unseen is not None:
            asked = help_learned[fitted[:, 0]], help_unseen[judged[:, 0]]
            if len(np.unique(asked[1])) > 1:
                preferences = separability(z_fitted, asked[0], z, asked[1])
        types = unseen.driver[judged[:, 0]]
        found = None if identification is None else ceilings(identification, judged, types)
        told = separability(z_fitted, learned.driver[fitted[:, 0]], z, types)
        rows.append(Identified(size, len(judged), told, preferences, found))
    judged = disjoint_pools(unseen.driver, model.card.pool)
    means = model.latent(unseen.pooled(judged)).mean
    names = split.unseen.observed.names
    return rows, Embedding(means, unseen.driver[judged[:, 0]], names)


def strangers(population: Demonstrations, demonstrations: Demonstrations) -> Demonstrations:
    """Windows of the population whose drivers have other traits than any who demonstrated.

    Raises:
        ValueError: there are none.
    """
    if population.truth is None or demonstrations.truth is None:
        return population
    known = {tuple(traits) for traits in demonstrations.truth.traits.tolist()}
    new = np.array([tuple(traits) not in known for traits in population.truth.traits.tolist()])
    if not new.any():
        raise ValueError(
            "everybody in the population has demonstrated: traits of drivers whom a "
            "model has learned from tell nothing; see hmi-marl collect --population"
        )
    return population.take(new)


def population_pools(population: Demonstrations, size: int) -> tuple[Truth, NDArray[np.int64]]:
    """The truth of a population, and pools of its windows to regress traits over.

    Raises:
        ValueError: the truth is not known, or pools of fewer than four drivers can be had.
    """
    if population.truth is None:
        raise ValueError("traits can be regressed only where the truth is known")
    pools = disjoint_pools(population.observed.driver, size)
    drivers = len(np.unique(population.observed.driver[pools[:, 0]]))
    if drivers < FEWEST_STRANGERS:
        raise ValueError(
            f"traits are regressed over {FEWEST_STRANGERS} drivers or more with {size} windows "
            f"each, but the population has {drivers}"
        )
    return population.truth, pools


def regress_traits(
    model: TraitModel, population: Demonstrations, size: int, seed: int = 0
) -> dict[str, TraitR2]:
    """R² of each trait from z, over drivers whom nothing was learned from.

    One half of the drivers fits the regression, the other half is judged.

    Args:
        model: the trait model.
        population: windows of many drivers, with the truth.
        size: windows pooled.
        seed: of the bootstrap.

    Raises:
        ValueError: see :func:`population_pools`.
    """
    truth, pools = population_pools(population, size)
    hidden = Hidden.of(model, population.observed)
    z, who = model.latent(hidden.pooled(pools)).mean, hidden.driver[pools[:, 0]]
    traits = truth.traits[pools[:, 0]]
    fits = np.unique(who, return_inverse=True)[1] % 2 == 0
    return trait_r2(z[fits], traits[fits], z[~fits], traits[~fits], TRAIT_NAMES, seed)
