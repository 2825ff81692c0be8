"""How well a driver's traits can be read from latent vectors.

A vector is the posterior mean of z given a pool of windows, as in
:mod:`hmi_marl.experiments.latent_traits.separability`. Its driver's traits are T numbers; P vectors have traits of
shape (P, T).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from hmi_marl.experiments.latent_traits.separability import Array, Labels, checked_means, same_size
from hmi_marl.extras import needing
from hmi_marl.reporting.statistics import CONFIDENCE, Estimate

_BOOTSTRAPS = 2000
_FOLDS = 5
_LANDMARKS = 100
_PENALTIES = (1e-3, 1e-2, 1e-1, 1.0, 10.0)
_SHARPNESS = (1 / 16, 1 / 4, 1.0, 4.0)  # of the kernel, exp(-s |z - z'|² / Z)
_SCORING = "neg_mean_squared_error"  # defined for a fold of one vector, as R² is not


@dataclass(frozen=True)
class TraitR2:
    """How much of one trait's variance over held-out drivers can be read from z, with intervals."""

    linear: Estimate
    """By ridge regression."""
    smooth: Estimate
    """By kernel ridge regression, whatever smooth shape the trait has over z."""

    def as_json(self) -> dict[str, dict[str, float | None]]:
        """Both, each with its interval."""
        return {"linear": self.linear.as_json(), "smooth": self.smooth.as_json()}


def trait_r2(
    train_means: ArrayLike,
    train_traits: ArrayLike,
    means: ArrayLike,
    traits: ArrayLike,
    names: Sequence[str],
    seed: int = 0,
) -> dict[str, TraitR2]:
    """How well each trait of held-out drivers can be read from z.

    R² = 1 - SSE / SST, where SST is about the held-out mean: 1 is perfect, 0 no better than a
    constant, and less than 0 is worse than one and is told so. NaN where held-out drivers do not
    differ. Intervals are percentiles over resampled held-out drivers.

    Both regressions are on standardised z, their strengths chosen by cross-validation over training
    drivers. The smooth one is kernel ridge with a Gaussian kernel on at most 100 landmarks. With
    100 to 1000 vectors in few dimensions it takes any smooth shape, is solved in closed form
    (nothing to converge), and far from its data falls back to a constant, where polynomials
    explode; nearest neighbours are too coarse and trees too jagged for a smooth trait.

    Args:
        train_means: shape (P', Z).
        train_traits: shape (P', T). Vectors with equal traits are taken as the same driver's.
        means: held-out vectors, shape (P, Z).
        traits: theirs, shape (P, T).
        names: of the T traits.
        seed: of folds, landmarks and resampling.

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
    scores = {}
    for column, name in enumerate(names):
        trait, wanted = known[:, column], truth[:, column]
        read = [model.fit(fitted, trait).predict(vectors) for model in (linear, smooth)]
        scores[name] = TraitR2(*(_r2(wanted, each, held_out, seed) for each in read))
    return scores


def _r2(truth: Array, predicted: Array, drivers: Labels, seed: int) -> Estimate:
    """R² and its interval over resampled drivers; truth and predicted have shape (P,)."""
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
    told = scores[1:][np.isfinite(scores[1:])]
    # Not empty: drivers differ, so that some resamples' do.
    low, high = np.quantile(told, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
    return Estimate(float(scores[0]), float(low), float(high))


def _drivers(traits: Array) -> Labels:
    """A number for each driver, from 0, shape (P,): equal traits are one driver."""
    return np.unique(traits, axis=0, return_inverse=True)[1].reshape(len(traits))


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
