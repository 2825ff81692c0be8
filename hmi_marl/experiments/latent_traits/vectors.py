"""Checks of latent vectors, shape (P, Z), and of their types, shape (P,)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Labels = NDArray[np.int64]


def checked_vectors(
    means: ArrayLike, types: ArrayLike, what: str = "vectors"
) -> tuple[Array, Labels]:
    """Return vectors, shape (P, Z), and their types, shape (P,), as arrays.

    Raises:
        ValueError: not these shapes, numbers that are not finite, types that are no integers, or
            fewer than two types.
    """
    vectors, labels = checked_means(means, what), np.asarray(types)
    if labels.shape != (len(vectors),):
        raise ValueError(f"{len(vectors)} {what} have {len(vectors)} types, not {labels.shape}")
    if not np.issubdtype(labels.dtype, np.integer):
        raise ValueError(f"types of {what} are integers, not {labels.dtype}")
    if len(np.unique(labels)) < 2:
        raise ValueError(f"{what} of one type cannot be separated; give two types or more")
    return vectors, labels.astype(np.int64)


def checked_means(means: ArrayLike, what: str) -> Array:
    """Return vectors as an array of shape (P, Z).

    Raises:
        ValueError: not this shape, none at all, or numbers that are not finite.
    """
    vectors = np.asarray(means, np.float64)
    if vectors.ndim != 2 or vectors.size == 0:
        raise ValueError(f"{what} have shape (P, Z), not {vectors.shape}")
    if not np.isfinite(vectors).all():
        raise ValueError(f"{what} are finite, but {(~np.isfinite(vectors)).sum()} numbers are not")
    return vectors


def same_size(fitted: Array, vectors: Array) -> None:
    """Raise ``ValueError`` unless training and held-out vectors have one Z."""
    if fitted.shape[1] != vectors.shape[1]:
        raise ValueError(
            f"training vectors have {fitted.shape[1]} dimensions, held-out ones {vectors.shape[1]}"
        )
