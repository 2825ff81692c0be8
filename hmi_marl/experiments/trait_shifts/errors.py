"""Errors of estimated traits under a shift, against the same strangers without it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hmi_marl.envs.drivers import TRAIT_NAMES
from hmi_marl.experiments.criteria import KEPT_R2
from hmi_marl.experiments.trait_shifts.scoring import Estimates
from hmi_marl.reporting import statistics
from hmi_marl.reporting.statistics import Estimate

LEVEL = 0.95
"""Probability of the posterior intervals whose coverage is counted."""


@dataclass(frozen=True)
class TraitErrors:
    """Errors of one reader's estimates of one trait, over strangers."""

    r2: Estimate
    """1 - squared error over the variance of the truth."""
    error: Estimate
    """Mean absolute error."""
    bias: Estimate
    """Mean of estimate less truth."""
    kept: Estimate | None
    """R² less ``KEPT_R2`` of that without shift, paired by stranger; None if strangers have other
    values of this trait."""
    coverage: Estimate | None
    """Share of strangers whose trait lies in the posterior's interval of ``LEVEL``; None of z."""


@dataclass(frozen=True)
class ReaderErrors:
    """Errors of one reader under one shift."""

    strangers: int
    traits: Mapping[str, TraitErrors]
    """By trait."""
    enough: float | None
    """Share of strangers whose posterior has a large enough effective sample size; None of z."""


@dataclass(frozen=True)
class ShiftRow:
    """Errors of all readers under one shift."""

    name: str
    what: str
    readers: Mapping[str, ReaderErrors]
    """By reader; one that cannot be computed is left out."""


def reader_errors(found: Estimates, unshifted: Estimates | None) -> ReaderErrors:
    """Compute the errors of a reader.

    Args:
        found: estimates of P strangers.
        unshifted: of the same strangers without shift; None if there are none.
    """
    traits = {}
    for k, name in enumerate(TRAIT_NAMES):
        true, wrong = found.true[:, k], found.read[:, k] - found.true[:, k]
        r2, deviations = explained(true, wrong)
        kept = None
        if unshifted is not None and np.allclose(true, unshifted.true[:, k]):
            before = unshifted.true[:, k]
            base, others = explained(before, unshifted.read[:, k] - before)
            kept = statistics.mean(r2.mean + deviations - KEPT_R2 * (base.mean + others))
        coverage = None
        if found.ranks is not None:
            inside = np.abs(found.ranks[:, k] - 0.5) <= LEVEL / 2
            coverage = statistics.share(int(inside.sum()), len(inside))
        error, bias = statistics.mean(np.abs(wrong)), statistics.mean(wrong)
        traits[name] = TraitErrors(r2, error, bias, kept, coverage)
    return ReaderErrors(len(found.true), traits, found.enough)


def explained(
    true: NDArray[np.float64], wrong: NDArray[np.float64]
) -> tuple[Estimate, NDArray[np.float64]]:
    """Return R² of P strangers' trait and the deviation of each in the linearised ratio, (P,).

    Args:
        true: shape (P,), not all equal.
        wrong: estimate less truth, shape (P,).
    """
    return share_explained(wrong**2, (true - true.mean()) ** 2)


def share_explained(
    squares: NDArray[np.float64], spread: NDArray[np.float64]
) -> tuple[Estimate, NDArray[np.float64]]:
    """Return R² and deviations as :func:`explained` does, from sums over each stranger's pools.

    Args:
        squares: squared errors, shape (P,).
        spread: squared distances of the truth from its mean over all strangers, shape (P,).
    """
    missed = statistics.ratio(squares, spread)
    deviations = -(squares - missed.mean * spread) / spread.mean()
    found = replace(missed, mean=1 - missed.mean, low=1 - missed.high, high=1 - missed.low)
    return found, deviations


def shift_row(
    name: str,
    what: str,
    found: Mapping[str, Estimates],
    unshifted: Mapping[str, Estimates],
    order: Sequence[str],
) -> ShiftRow:
    """Compute the errors of all readers that found something, in this order."""
    readers = {
        each: reader_errors(found[each], unshifted.get(each)) for each in order if each in found
    }
    return ShiftRow(name, what, readers)
