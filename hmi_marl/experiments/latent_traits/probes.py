"""Read driver types and traits from latent vectors, and measure how far types lie apart.

Everything here is a pure function over arrays. A vector is the posterior mean of z given a pool of
windows, P vectors of Z numbers in an array of shape (P, Z); a type is an integer, one for each
vector; traits are T numbers of each vector's driver, shape (P, T).

**Average KL** (under the paper's figure of embeddings). Each type's vectors are summed up by a
Gaussian N(μ, Σ) with full, unbiased covariance, and

    KL(N0 || N1) = ½ [tr(Σ1⁻¹ Σ0) + (μ1 - μ0)ᵀ Σ1⁻¹ (μ1 - μ0) - Z + ln(det Σ1 / det Σ0)]

is averaged over all ordered pairs of different types. It does not depend on the units or the axes
of z, grows without bound as clusters tighten, and is too high for few vectors, since an inverted
sample covariance is: compare it only between equal numbers of vectors.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hmi_marl.extras import needing
from hmi_marl.reporting.statistics import CONFIDENCE, Estimate, accuracy

Array = NDArray[np.float64]
Labels = NDArray[np.int64]

SMALLEST_SPREAD = 1e-6
"""Least spread of a type's cluster in any direction, in standard deviations of all vectors. A
thinner cluster (in float32 hardly different from a plane) is singular; it is thickened by this.
"""
_BOOTSTRAPS = 2000
_FOLDS = 5
_LANDMARKS = 100
_PENALTIES = (1e-3, 1e-2, 1e-1, 1.0, 10.0)
_SHARPNESS = (1 / 16, 1 / 4, 1.0, 4.0)  # of the kernel, exp(-s |z - z'|² / Z)
_DECAY, _EPOCHS = 0.1, 400
"""Weight decay and passes of the small network, so that it does not learn drivers by heart."""
_SCORING = "neg_mean_squared_error"  # defined for a fold of one vector, as R² is not


@dataclass(frozen=True)
class Separability:
    """Separation of driver types in latent vectors; everything but training is on held-out ones."""

    linear_probe: Estimate
    """Accuracy of multinomial logistic regression."""
    nearest_centroid: Estimate
    """Accuracy of the nearest of the types' training means."""
    chance: float
    """Accuracy of always naming the most frequent held-out type: 1 / types where all are equal."""
    silhouette: float
    """Silhouette of the true types, -1 to 1: (b - a) / max(a, b) averaged over vectors, where a and
    b are the mean distances to a vector's own type and to the nearest other one."""
    adjusted_rand: float
    """Agreement of k-means clusters, as many as types, with the types: 1 full, 0 by chance."""
    average_kl: float
    """See :func:`average_kl` [nats]."""


def gaussian_kl(mean0: ArrayLike, cov0: ArrayLike, mean1: ArrayLike, cov1: ArrayLike) -> float:
    """Return KL(N0 || N1) [nats] of means (Z,), covariances (Z, Z); the module has the equation.

    Raises:
        ValueError: shapes that differ, or a covariance that is not symmetric positive definite.
    """
    middle0, middle1 = np.asarray(mean0, np.float64), np.asarray(mean1, np.float64)
    if middle0.ndim != 1 or middle0.shape != middle1.shape:
        raise ValueError(f"means have one shape (Z,), not {middle0.shape} and {middle1.shape}")
    root0, root1 = (_cholesky(cov, len(middle0)) for cov in (cov0, cov1))
    spread = np.linalg.solve(root1, root0)
    shift = np.linalg.solve(root1, middle1 - middle0)
    log_det = 2.0 * float(np.log(np.diag(root1) / np.diag(root0)).sum())
    kl = 0.5 * (float((spread**2).sum() + (shift**2).sum()) - len(middle0) + log_det)
    return max(kl, 0.0)  # rounding may take it below


def _cholesky(cov: ArrayLike, size: int) -> Array:
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
    vectors, labels = checked_vectors(means, types)
    kinds, counts = np.unique(labels, return_counts=True)
    least = vectors.shape[1] + 2
    if counts.min() < least:
        raise ValueError(
            f"a Gaussian in {vectors.shape[1]} dimensions takes {least} vectors of each type or "
            f"more, but type {kinds[counts.argmin()]} has {counts.min()}"
        )
    # The KL does not depend on units, and in these the smallest spread has a meaning.
    spread = vectors.std(axis=0)
    used = np.ptp(vectors, axis=0) > 0.0
    scaled = (vectors[:, used] - vectors[:, used].mean(axis=0)) / spread[used]
    if scaled.shape[1] == 0:
        return np.zeros((len(kinds), len(kinds)))
    gaussians = [_gaussian(scaled[labels == kind]) for kind in kinds]
    return np.array([[gaussian_kl(*own, *other) for other in gaussians] for own in gaussians])


def _gaussian(vectors: Array) -> tuple[Array, Array]:
    cov = np.cov(vectors, rowvar=False).reshape(vectors.shape[1], -1)
    if np.linalg.eigvalsh(cov)[0] < SMALLEST_SPREAD**2:
        cov = cov + SMALLEST_SPREAD**2 * np.eye(len(cov))
    return vectors.mean(axis=0), cov


def average_kl(means: ArrayLike, types: ArrayLike) -> float:
    """Average :func:`kl_matrix` over all ordered pairs of different types [nats]."""
    matrix = kl_matrix(means, types)
    return float(matrix[~np.eye(len(matrix), dtype=bool)].mean())


def separability(
    train_means: ArrayLike,
    train_types: ArrayLike,
    means: ArrayLike,
    types: ArrayLike,
    groups: ArrayLike | None = None,
    seed: int = 0,
) -> Separability:
    """Measure how well held-out vectors (P, Z) separate driver types.

    The linear probe standardises by the training vectors. All other measures take distances in z
    as they are, since its prior N(0, I) gives them a scale.

    Args:
        train_means, train_types: shapes (P', Z) and (P',).
        means, types: held-out vectors, shape (P, Z), and their types, integers, shape (P,).
        groups: labels of any kind, shape (P,), equal for held-out vectors that are not independent
            (of the same episodes). The Wilson intervals then count groups, not vectors, as trials:
            as wide as if the members of a group always agreed. None: all are independent.
        seed: seed of k-means.

    Raises:
        ValueError: as :func:`kl_matrix`; or different types or Z in training and held-out vectors;
            or groups that do not fit the vectors.
        ModuleNotFoundError: scikit-learn is not installed.
    """
    with needing("judging latent vectors"):
        from sklearn.cluster import KMeans
        from sklearn.exceptions import ConvergenceWarning
        from sklearn.linear_model import LogisticRegression
        from sklearn.metrics import adjusted_rand_score, silhouette_score
        from sklearn.preprocessing import StandardScaler

    fitted, known = checked_vectors(train_means, train_types, "training vectors")
    vectors, labels = checked_vectors(means, types)
    same_size(fitted, vectors)
    kinds, counts = np.unique(labels, return_counts=True)
    if not np.array_equal(np.unique(known), kinds):
        raise ValueError(
            f"trained on the types {np.unique(known).tolist()}, but held out are {kinds.tolist()}"
        )
    trials = len(labels) if groups is None else len(np.unique(_checked_groups(groups, labels)))
    kl = average_kl(vectors, labels)  # first, since it refuses too few vectors
    scaler = StandardScaler().fit(fitted)
    probe = LogisticRegression(max_iter=10_000).fit(scaler.transform(fitted), known)
    centroids = np.stack([fitted[known == kind].mean(axis=0) for kind in kinds])
    nearest = np.linalg.norm(vectors[:, None] - centroids, axis=-1).argmin(axis=1)
    with warnings.catch_warnings():
        # Vectors may have collapsed to fewer points than types; the index then shows it.
        warnings.simplefilter("ignore", ConvergenceWarning)
        clusters = KMeans(len(kinds), n_init=10, random_state=seed).fit_predict(vectors)
    return Separability(
        linear_probe=accuracy(probe.predict(scaler.transform(vectors)) == labels, trials),
        nearest_centroid=accuracy(kinds[nearest] == labels, trials),
        chance=float(counts.max() / len(labels)),
        silhouette=float(silhouette_score(vectors, labels)),
        adjusted_rand=float(adjusted_rand_score(labels, clusters)),
        average_kl=kl,
    )


@dataclass(frozen=True)
class TraitR2:
    """Share of a trait's variance over held-out drivers that z explains, with intervals."""

    linear: Estimate
    """R² of ridge regression."""
    smooth: Estimate
    """R² of kernel ridge regression, which fits any smooth function of z."""
    network: Estimate
    """R² of a small network."""


def trait_r2(
    train_means: ArrayLike,
    train_traits: ArrayLike,
    means: ArrayLike,
    traits: ArrayLike,
    names: Sequence[str],
    seed: int = 0,
    predicted: Array | None = None,
) -> dict[str, TraitR2]:
    """Measure how well each trait of held-out drivers can be read from z.

    R² = 1 - SSE / SST, where SST is about the held-out mean: 1 is perfect, 0 no better than a
    constant, less than 0 worse than a constant. NaN where held-out drivers do not differ. Intervals
    are percentiles over resampled held-out drivers.

    Both regressions are on standardised z, their strengths chosen by cross-validation over training
    drivers. The smooth one is kernel ridge with a Gaussian kernel on at most 100 landmarks. With
    100 to 1000 vectors in few dimensions it takes any smooth shape, is solved in closed form
    (nothing to converge), and far from its data falls back to a constant, where polynomials
    explode; nearest neighbours are too coarse and trees too jagged for a smooth trait.

    Args:
        train_means, train_traits: shapes (P', Z) and (P', T); equal traits: the same driver.
        means, traits: held-out vectors, shape (P, Z), and their traits, shape (P, T).
        names: names of the T traits.
        seed: seed of folds, landmarks and resampling.
        predicted: :func:`predict_traits` of the same, if it is there already.

    Raises:
        ValueError: arrays that are not finite or do not fit each other, or fewer than two drivers
            to learn from.
        ModuleNotFoundError: scikit-learn is not installed.
    """
    with needing("judging latent vectors"):
        from sklearn.kernel_approximation import Nystroem
        from sklearn.linear_model import Ridge
        from sklearn.model_selection import GridSearchCV, GroupKFold
        from sklearn.pipeline import Pipeline
        from sklearn.preprocessing import StandardScaler

    fitted, known = _checked_traits(train_means, train_traits, names, "training vectors")
    vectors, truth = _checked_traits(means, traits, names, "vectors")
    same_size(fitted, vectors)
    own, held_out = _drivers(known), _drivers(truth)
    if own.max() == 0:
        raise ValueError("traits are learned from two drivers or more")
    folds = GroupKFold(min(_FOLDS, own.max() + 1), shuffle=True, random_state=seed)
    splits = list(folds.split(fitted, groups=own))
    landmarks = min(_LANDMARKS, *(len(rows) for rows, _ in splits))
    steps = [("scale", StandardScaler()), ("ridge", Ridge())]
    kernel = ("kernel", Nystroem(n_components=landmarks, random_state=seed))
    penalties = {"ridge__alpha": _PENALTIES}
    sharpness = {"kernel__gamma": [value / fitted.shape[1] for value in _SHARPNESS]}
    models = (
        (Pipeline(steps), penalties),
        (Pipeline([steps[0], kernel, steps[1]]), penalties | sharpness),
    )
    linear, smooth = (
        GridSearchCV(model, grid, cv=splits, scoring=_SCORING) for model, grid in models
    )
    network = predict_traits(fitted, known, vectors, seed) if predicted is None else predicted
    scores = {}
    for column, name in enumerate(names):
        trait, wanted = known[:, column], truth[:, column]
        read = [model.fit(fitted, trait).predict(vectors) for model in (linear, smooth)]
        read.append(network[:, column])
        scores[name] = TraitR2(*(_r2(wanted, each, held_out, seed) for each in read))
    return scores


def predict_traits(train_means: Array, train_traits: Array, means: Array, seed: int = 0) -> Array:
    """Read all traits from z (P, Z) by one network with 32 hidden units, shape (P, T).

    Args:
        train_means, train_traits: what it learns from, shapes (P', Z) and (P', T).
        means: vectors to read, shape (P, Z).
        seed: seed of its first weights and of its batches.

    Raises:
        ModuleNotFoundError: scikit-learn is not installed.
    """
    with needing("judging latent vectors"):
        from sklearn.compose import TransformedTargetRegressor
        from sklearn.exceptions import ConvergenceWarning
        from sklearn.neural_network import MLPRegressor
        from sklearn.pipeline import make_pipeline
        from sklearn.preprocessing import StandardScaler

    network = MLPRegressor(
        hidden_layer_sizes=(32,), alpha=_DECAY, max_iter=_EPOCHS, random_state=seed
    )
    model = TransformedTargetRegressor(
        make_pipeline(StandardScaler(), network), transformer=StandardScaler()
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)  # stopped early on purpose
        # One trait has to come as one axis.
        model.fit(train_means, train_traits if train_traits.shape[1] > 1 else train_traits[:, 0])
    return np.asarray(model.predict(means), np.float64).reshape(len(means), -1)


def _r2(truth: Array, predicted: Array, drivers: Labels, seed: int) -> Estimate:
    """Return R² and its interval over resampled drivers; arguments have shape (P,)."""
    if np.ptp(truth) == 0.0:
        return Estimate(math.nan, math.nan, math.nan)
    count = int(drivers.max()) + 1
    centred = truth - truth.mean()
    sums = [
        np.bincount(drivers, weights, count)
        for weights in (np.ones_like(truth), centred, centred**2, (truth - predicted) ** 2)
    ]
    rng = np.random.default_rng(seed)
    resampled = rng.multinomial(count, np.full(count, 1 / count), _BOOTSTRAPS)
    drawn = np.concatenate([np.ones((1, count)), resampled])  # the first row: as they are
    vectors, first, second, errors = (drawn @ each for each in sums)
    total = second - first**2 / vectors
    # Resamples of one driver alone have no variance, but for rounding.
    total[total <= 1e-12 * vectors * np.abs(centred).max() ** 2] = math.nan
    scores = 1.0 - errors / total
    known = scores[1:][np.isfinite(scores[1:])]  # not empty, since drivers differ
    low, high = np.quantile(known, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
    return Estimate(float(scores[0]), float(low), float(high), float(known.std()), count)


def _drivers(traits: Array) -> Labels:
    """Number the drivers from 0, shape (P,): equal traits are one driver."""
    return np.unique(traits, axis=0, return_inverse=True)[1].reshape(len(traits))


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


def _checked_groups(groups: ArrayLike, labels: Labels) -> NDArray[Any]:
    array = np.asarray(groups)
    if array.shape != labels.shape:
        raise ValueError(f"groups have shape {labels.shape} as types have, not {array.shape}")
    return array


def same_size(fitted: Array, vectors: Array) -> None:
    """Raise ``ValueError`` unless training and held-out vectors have one Z."""
    if fitted.shape[1] != vectors.shape[1]:
        raise ValueError(
            f"training vectors have {fitted.shape[1]} dimensions, held-out ones {vectors.shape[1]}"
        )


def _checked_traits(
    means: ArrayLike, traits: ArrayLike, names: Sequence[str], what: str
) -> tuple[Array, Array]:
    vectors, values = checked_means(means, what), np.asarray(traits, np.float64)
    if values.shape != (len(vectors), len(names)):
        wanted = len(vectors), len(names)
        raise ValueError(f"traits of {what} have shape {wanted}, not {values.shape}")
    if not np.isfinite(values).all():
        raise ValueError(f"traits of {what} are finite")
    return vectors, values
