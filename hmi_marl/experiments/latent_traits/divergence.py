"""Measure how far driver types lie apart in latent vectors, by the KL between their Gaussians.

**Average KL** (under the paper's figure of embeddings). Each type's vectors, shape (P, Z), are
summed up by a Gaussian N(μ, Σ) with full, unbiased covariance, and

    KL(N0 || N1) = ½ [tr(Σ1⁻¹ Σ0) + (μ1 - μ0)ᵀ Σ1⁻¹ (μ1 - μ0) - Z + ln(det Σ1 / det Σ0)]

is averaged over all ordered pairs of different types. It does not depend on the units or the axes
of z, grows without bound as clusters tighten, and is too high for few vectors, since an inverted
sample covariance is: compare it only between equal numbers of vectors.

**Standard error**, of the logarithm, by the jackknife: each vector is left out once. Types are
samples of their own, so their sums of squares add up: for n vectors of type k, of which leaving out
the i-th gives the logarithm :math:`θ_i` with mean :math:`θ`,

    error² = Σ_k (n - 1) / n Σ_i (θ_i - θ)²
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from hmi_marl.experiments import criteria
from hmi_marl.experiments.latent_traits.vectors import Array, checked_vectors
from hmi_marl.reporting import statistics
from hmi_marl.reporting.statistics import Estimate

SMALLEST_SPREAD = 1e-6
"""Least spread of a type's cluster in any direction, in standard deviations of all vectors. A
thinner cluster (in float32 hardly different from a plane) is singular; it is thickened by this.
"""


def gaussian_kl(mean0: ArrayLike, cov0: ArrayLike, mean1: ArrayLike, cov1: ArrayLike) -> float:
    """Return KL(N0 || N1) [nats] of means (Z,), covariances (Z, Z); the module has the equation.

    Raises:
        ValueError: shapes that differ, or a covariance that is not symmetric positive definite.
    """
    middle0, middle1 = np.asarray(mean0, np.float64), np.asarray(mean1, np.float64)
    if middle0.ndim != 1 or middle0.shape != middle1.shape:
        raise ValueError(f"means have one shape (Z,), not {middle0.shape} and {middle1.shape}")
    root0, root1 = (_checked_root(cov, len(middle0)) for cov in (cov0, cov1))
    return float(_kl(middle0, root0, middle1, root1))


def _kl(mean0: Array, root0: Array, mean1: Array, root1: Array) -> Array:
    """KL of Gaussians by means (..., Z) and Cholesky roots of covariances (..., Z, Z)."""
    spread = np.linalg.solve(root1, root0)
    shift = np.linalg.solve(root1, (mean1 - mean0)[..., None])
    axes = [np.diagonal(root, axis1=-2, axis2=-1) for root in (root0, root1)]
    log_det = 2.0 * np.log(axes[1] / axes[0]).sum(axis=-1)
    squares = (spread**2).sum(axis=(-2, -1)) + (shift**2).sum(axis=(-2, -1))
    kl = 0.5 * (squares - mean0.shape[-1] + log_det)
    return np.asarray(np.maximum(kl, 0.0))  # rounding may take it below


def _checked_root(cov: ArrayLike, size: int) -> Array:
    matrix = np.asarray(cov, np.float64)
    if matrix.shape != (size, size):
        raise ValueError(f"a covariance has shape {(size, size)}, not {matrix.shape}")
    try:
        if not np.allclose(matrix, matrix.T, rtol=1e-9, atol=0.0):
            raise np.linalg.LinAlgError
        return np.asarray(np.linalg.cholesky(matrix), np.float64)
    except np.linalg.LinAlgError:
        text = f"a covariance is symmetric positive definite, not {matrix.tolist()}"
        raise ValueError(text) from None


def kl_matrix(means: ArrayLike, types: ArrayLike) -> Array:
    """Return KL(row || column) [nats] between the Gaussians of C types, rising, shape (C, C).

    Axes of z on which all vectors agree hold no information and are left out. Where a cluster is
    singular (:data:`SMALLEST_SPREAD`), SMALLEST_SPREAD² of each axis' variance over all vectors is
    added to the diagonal of its covariance; the KL is then large, and depends on that number.

    Raises:
        ValueError: vectors (P, Z) that are not finite or do not fit the types (P,), fewer than two
            types, or a type with fewer than Z + 2 vectors.
    """
    return _matrix(*_gaussians(_clusters(means, types)))


def kl_without_one(means: ArrayLike, types: ArrayLike) -> list[Array]:
    """Return :func:`kl_matrix` without one vector, for each vector of C types, (n, C, C) each.

    Units stay those of all vectors.

    Raises:
        ValueError: as :func:`kl_matrix`.
    """
    clusters = _clusters(means, types)
    middles, roots = _gaussians(clusters)
    whole = _matrix(middles, roots)
    found = []
    for kind, cluster in enumerate(clusters):
        count, apart = len(cluster), cluster - middles[kind]
        squares = apart[:, :, None] * apart[:, None, :]
        left = (count - 1) * _covariance(cluster) - squares * (count / (count - 1))
        middle, root = middles[kind] - apart / (count - 1), _root(left / (count - 2))
        one, others = (middle[:, None], root[:, None]), (middles, roots)
        matrices = np.repeat(whole[None], count, axis=0)
        matrices[:, kind], matrices[:, :, kind] = _kl(*one, *others), _kl(*others, *one)
        matrices[:, kind, kind] = 0.0
        found.append(matrices)
    return found


def _clusters(means: ArrayLike, types: ArrayLike) -> list[Array]:
    """Check vectors, and sort them by type, in units in which the smallest spread has a meaning.

    The KL does not depend on units.
    """
    vectors, labels = checked_vectors(means, types)
    kinds, counts = np.unique(labels, return_counts=True)
    least = vectors.shape[1] + 2
    if counts.min() < least:
        raise ValueError(
            f"a Gaussian in {vectors.shape[1]} dimensions takes {least} vectors of each type or "
            f"more, but type {kinds[counts.argmin()]} has {counts.min()}"
        )
    used = vectors[:, np.ptp(vectors, axis=0) > 0.0]
    scaled = (used - used.mean(axis=0)) / used.std(axis=0)
    return [scaled[labels == kind] for kind in kinds]


def _gaussians(clusters: list[Array]) -> tuple[Array, Array]:
    """Means (C, Z) and Cholesky roots of covariances (C, Z, Z)."""
    middles = np.stack([cluster.mean(axis=0) for cluster in clusters])
    return middles, np.stack([_root(_covariance(cluster)) for cluster in clusters])


def _matrix(middles: Array, roots: Array) -> Array:
    matrix = _kl(middles[:, None], roots[:, None], middles, roots)
    np.fill_diagonal(matrix, 0.0)  # but for rounding
    return matrix


def _covariance(vectors: Array) -> Array:
    apart = vectors - vectors.mean(axis=0)
    return apart.T @ apart / (len(vectors) - 1)


def _root(cov: Array) -> Array:
    """Cholesky roots of covariances (..., Z, Z), thickened where they are singular."""
    thin = np.any(np.linalg.eigvalsh(cov) < SMALLEST_SPREAD**2, axis=-1, keepdims=True)
    thicker = np.where(thin, SMALLEST_SPREAD**2, 0.0)[..., None]
    thickened = cov + thicker * np.eye(cov.shape[-1])
    return np.asarray(np.linalg.cholesky(thickened), np.float64)


def average_kl(means: ArrayLike, types: ArrayLike) -> float:
    """Average :func:`kl_matrix` over all ordered pairs of different types [nats]."""
    return float(_average(kl_matrix(means, types)))


def _average(matrices: Array) -> Array:
    """Average what is off the diagonal of matrices (..., C, C), shape (...,)."""
    off = ~np.eye(matrices.shape[-1], dtype=bool)
    return np.asarray(matrices[..., off].mean(axis=-1))


def log_error(means: ArrayLike, types: ArrayLike, of: Callable[[Array], Array]) -> float:
    """Return the standard error of the logarithm of a number from KL, by the jackknife.

    Args:
        means, types: vectors (P, Z) and their types (P,).
        of: makes the numbers, shape (n,), from matrices of KL (n, C, C). Those below
            :data:`~hmi_marl.experiments.criteria.SMALLEST_KL` count as that.

    Raises:
        ValueError: as :func:`kl_matrix`.
    """
    variance = 0.0
    for matrices in kl_without_one(means, types):
        logs = np.log(np.maximum(of(matrices), criteria.SMALLEST_KL))
        variance += (len(logs) - 1) * float(logs.var())
    return math.sqrt(variance)


def estimated_kl(means: ArrayLike, types: ArrayLike) -> Estimate:
    """Return :func:`average_kl` with an interval over the vectors, by Student's t of its logarithm.

    ``error`` is that of the logarithm (:func:`log_error`), ``count`` the number of vectors.

    Raises:
        ValueError: as :func:`kl_matrix`.
    """
    error = log_error(means, types, _average)
    return statistics.by_logarithm(average_kl(means, types), error, len(np.asarray(types)))


def kl_ratio_of(ones: Sequence[Estimate], others: Sequence[Estimate]) -> Estimate:
    """Geometric mean of ratios of KL over training seeds, paired by seed; the longer list is cut.

    The luck of the vectors, which are of the same windows in all trainings, is that of both KL as
    if they were independent, and does not average out over seeds
    (:func:`~hmi_marl.reporting.statistics.geometric_mean_of_same`).

    Args:
        ones, others: one of each seed, as :func:`estimated_kl` makes them. KL below
            :data:`~hmi_marl.experiments.criteria.SMALLEST_KL` count as that.
    """
    pairs = zip(ones, others, strict=False)
    return statistics.geometric_mean_of_same(
        [statistics.quotient(_positive(one), _positive(other)) for one, other in pairs]
    )


def _positive(kl: Estimate) -> Estimate:
    return replace(kl, mean=max(kl.mean, criteria.SMALLEST_KL))
