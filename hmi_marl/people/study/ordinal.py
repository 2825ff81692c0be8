"""Cumulative-link model of ratings: a check that takes the seven points as ordered words only.

The log odds of a rating above each of the six thresholds are shifted by the same amount for a
condition (proportional odds). It is fitted by statsmodels' ``OrderedModel`` without random effects;
standard errors allow for repeated raters and for repeated clips (two-way clustered, after Cameron,
Gelbach and Miller), since an ordinal model with crossed random effects is not in statsmodels.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class OrdinalFit:
    """Log odds of conditions, against the first one."""

    shifts: NDArray[np.float64]
    """Shape (C,), the first is 0."""
    of_raters: NDArray[np.float64]
    """Covariance of the shifts, clustered by rater, shape (C, C)."""
    of_clips: NDArray[np.float64]
    of_both: NDArray[np.float64]
    """By single ratings, which both others count."""

    def contrast(self, more: int, less: int) -> tuple[float, float]:
        """Return the log odds ratio of two conditions, and its standard error."""
        direction = np.zeros(len(self.shifts))
        direction[more], direction[less] = 1.0, -1.0
        rater, clip, both = (
            float(direction @ covariance @ direction)
            for covariance in (self.of_raters, self.of_clips, self.of_both)
        )
        variance = max(rater + clip - both, rater, clip)  # the sum can fall short by chance
        return float(direction @ self.shifts), float(np.sqrt(max(variance, 0.0)))


def fit_ordinal(
    rater: NDArray[np.int64],
    clip: NDArray[np.int64],
    rating: NDArray[np.int64],
    condition: NDArray[np.int64],
) -> OrdinalFit | None:
    """Fit the model to N ratings.

    Args:
        rater: number of the rater, shape (N,).
        clip: number of the clip, shape (N,).
        rating: 1 to 7, shape (N,).
        condition: number of the condition of each rating, shape (N,); 0 to C - 1 all occur.

    Returns:
        None where it has no finite solution, such as when all ratings are the same.
    """
    from statsmodels.miscmodels.ordinal_model import OrderedModel

    conditions = int(condition.max()) + 1
    if len(np.unique(rating)) < 2:
        return None
    exogenous = np.eye(conditions)[condition][:, 1:]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model = OrderedModel(rating, exogenous, distr="logit")
        try:
            found = model.fit(method="bfgs", maxiter=500, disp=False)
            bread = np.linalg.inv(-model.hessian(found.params))
            scores = np.asarray(model.score_obs(found.params))
        except (ValueError, np.linalg.LinAlgError):
            return None
    if not (np.isfinite(bread).all() and np.isfinite(found.params).all()):
        return None
    if not found.mle_retvals["converged"] or np.abs(found.params[: conditions - 1]).max() > 20:
        return None
    groups: Sequence[NDArray[np.int64]] = (rater, clip, np.arange(len(rating)))
    covariances = []
    for each in groups:
        number = np.unique(each, return_inverse=True)[1].reshape(-1)
        sums = np.zeros((int(number.max()) + 1, scores.shape[1]))
        np.add.at(sums, number, scores)
        factor = len(sums) / (len(sums) - 1)
        own = factor * bread @ (sums.T @ sums) @ bread
        whole = np.zeros((conditions, conditions))
        whole[1:, 1:] = own[: conditions - 1, : conditions - 1]
        covariances.append(whole)
    shifts = np.concatenate([[0.0], found.params[: conditions - 1]])
    return OrdinalFit(shifts, *covariances)
