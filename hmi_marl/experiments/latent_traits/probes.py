"""Read driver types and traits from latent vectors.

Everything here is a pure function over arrays. A vector is the posterior mean of z given a pool of
windows, P vectors of Z numbers in an array of shape (P, Z); a type is an integer, one for each
vector; traits are T numbers of each vector's driver, shape (P, T).
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hmi_marl.experiments.latent_traits.divergence import estimated_kl
from hmi_marl.experiments.latent_traits.vectors import (
    Array,
    Labels,
    checked_means,
    checked_vectors,
    same_size,
)
from hmi_marl.extras import needing
from hmi_marl.reporting.statistics import CONFIDENCE, Estimate, accuracy

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
    average_kl: Estimate
    """Average KL between types [nats]; ``error`` is that of its logarithm, over held-out vectors.
    See :func:`~hmi_marl.experiments.latent_traits.divergence.estimated_kl`."""


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
        ValueError: as :func:`~hmi_marl.experiments.latent_traits.divergence.kl_matrix`; or
            different types or Z in training and held-out vectors; or groups that do not fit the
            vectors.
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
    kl = estimated_kl(vectors, labels)  # first, since it refuses too few vectors
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


def _checked_groups(groups: ArrayLike, labels: Labels) -> NDArray[Any]:
    array = np.asarray(groups)
    if array.shape != labels.shape:
        raise ValueError(f"groups have shape {labels.shape} as types have, not {array.shape}")
    return array


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
