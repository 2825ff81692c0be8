"""Analysis of a rating study: means of drivers, and a verdict on each intended difference."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hmi_marl.checks import Real
from hmi_marl.files import json_value
from hmi_marl.people.study.folder import Study
from hmi_marl.people.study.mixed import Fit, RatingModel
from hmi_marl.people.study.ordinal import OrdinalFit, fit_ordinal
from hmi_marl.people.study.ratings import LeftOut, Ratings
from hmi_marl.people.study.settings import RATINGS, Contrast
from hmi_marl.reporting.statistics import Estimate, t_interval
from hmi_marl.reporting.verdicts import Correction, Part, Verdict, judged_together

_MARGIN = Real(0.0, 3.0, "points")


@dataclass(frozen=True)
class Difference:
    """An intended difference, as raters see it."""

    contrast: Contrast
    points: Estimate
    """Of the linear mixed model, with its own 95 % interval."""
    verdict: Verdict
    """Corrected for all contrasts of the study."""
    log_odds: Estimate | None
    """Of the ordinal model; None where that has no solution."""
    check: Verdict | None
    """The ordinal model's verdict."""


@dataclass(frozen=True)
class Analysis:
    """Results of a study."""

    conditions: tuple[str, ...]
    raters: int
    left_out: LeftOut
    ratings: int
    """Clips rated."""
    simulated: bool
    fits: tuple[Fit, ...]
    """One for each of ``RATINGS``."""
    differences: tuple[Difference, ...]

    def mean(self, rating: int, condition: int) -> Estimate:
        """Mean rating of a condition, with its 95 % interval."""
        fit = self.fits[rating]
        error = float(np.sqrt(fit.covariance[condition, condition]))
        return _estimate(float(fit.means[condition]), error, fit.freedom)

    def as_json(self) -> dict[str, Any]:
        """JSON content."""
        return {
            "simulated": self.simulated,
            "raters": self.raters,
            "left_out": json_value(self.left_out),
            "ratings": self.ratings,
            "means": {
                rating: {
                    name: self.mean(row, place).as_json()
                    for place, name in enumerate(self.conditions)
                }
                for row, rating in enumerate(RATINGS)
            },
            "deviations": {
                rating: {
                    "rater": fit.rater,
                    "rater_driver": fit.rater_condition,
                    "clip": fit.clip,
                    "residual": fit.residual,
                }
                for rating, fit in zip(RATINGS, self.fits, strict=True)
            },
            "contrasts": [
                {
                    "name": each.contrast.name,
                    "points": each.points.as_json(),
                    "log_odds": None if each.log_odds is None else each.log_odds.as_json(),
                    "ordinal_verdict": None if each.check is None else each.check.as_json(),
                }
                for each in self.differences
            ],
            "verdicts": [each.verdict.as_json() for each in self.differences],
        }


def analyse(study: Study, ratings: Ratings, margin: float = 0.0) -> Analysis:
    """Fit the mixed models, and judge all intended differences together.

    Args:
        study: what was shown.
        ratings: of raters who passed the attention check.
        margin: differences up to this size count as none [points].

    Raises:
        ValueError: too few raters, or a driver of whom fewer than two clips were rated.
    """
    margin = _MARGIN("margin", margin)
    names = study.conditions
    if len(ratings.raters) < 2:
        raise ValueError(
            f"{len(ratings.raters)} raters passed the attention check, and the analysis needs two "
            "or more"
        )
    condition = np.repeat(np.arange(len(names)), study.settings.clips)
    fits = fit_all(ratings.rater, ratings.clip, ratings.values, condition, RATINGS)
    verdicts = judge(study.contrasts, names, fits, margin)
    ordinal = {
        rating: fit_ordinal(
            ratings.rater,
            ratings.clip,
            ratings.values[:, RATINGS.index(rating)],
            condition[ratings.clip],
        )
        for rating in dict.fromkeys(each.rating for each in study.contrasts)
    }
    checks = judge_ordinal(study.contrasts, names, ordinal, fits)
    differences = []
    for contrast, verdict, (odds, check) in zip(study.contrasts, verdicts, checks, strict=True):
        part = verdict.parts[0]
        points = _estimate(part.value or 0.0, part.error or 0.0, part.count - 1)
        differences.append(Difference(contrast, points, verdict, odds, check))
    return Analysis(
        names,
        len(ratings.raters),
        ratings.left_out,
        len(ratings.clip),
        ratings.simulated,
        tuple(fits[rating] for rating in RATINGS),
        tuple(differences),
    )


def fit_all(
    rater: NDArray[np.int64],
    clip: NDArray[np.int64],
    values: NDArray[np.int64],
    condition: NDArray[np.int64],
    ratings: Sequence[str],
) -> dict[str, Fit]:
    """Fit the linear mixed model of each rating.

    Args:
        rater: number of the rater, shape (N,).
        clip: number of the clip, shape (N,).
        values: columns as in ``RATINGS``, shape (N, 4).
        condition: of the K clips, shape (K,).
        ratings: those to fit.

    Raises:
        ValueError: too few raters or clips.
    """
    return {
        rating: RatingModel(
            rater, clip, values[:, RATINGS.index(rating)].astype(np.float64), condition
        ).fit
        for rating in ratings
    }


def judge(
    contrasts: Sequence[Contrast],
    names: Sequence[str],
    fits: dict[str, Fit],
    margin: float = 0.0,
) -> list[Verdict]:
    """Judge all contrasts together: Student's t, corrected by Holm's method.

    With a margin the correction is Bonferroni's: Holm's would count a difference that is shown to
    be small as one that is decided, and would test those that happen to be large too generously.
    """
    verdicts = []
    for contrast in contrasts:
        fit = fits[contrast.rating]
        value, error = fit.contrast(names.index(contrast.more), names.index(contrast.less))
        part = Part(
            f"{contrast.rating}: {contrast.more} - {contrast.less} [points]",
            value,
            "t",
            fit.unit,
            fit.freedom + 1,
            error,
            above=0.0,
            margin=margin,
            form="z.2f",
        )
        verdicts.append(Verdict(contrast.claim, (part,)))
    if margin > 0.0:
        correction = Correction(len(verdicts), max(1, len(verdicts)))
        return [replace(verdict, correction=correction) for verdict in verdicts]
    return judged_together(verdicts)


def judge_ordinal(
    contrasts: Sequence[Contrast],
    names: Sequence[str],
    ordinal: dict[str, OrdinalFit | None],
    fits: dict[str, Fit],
) -> list[tuple[Estimate | None, Verdict | None]]:
    """Judge all contrasts by the ordinal model, together; None where it has no solution."""
    estimates: list[Estimate | None] = []
    verdicts: list[Verdict] = []
    for contrast in contrasts:
        model, fit = ordinal[contrast.rating], fits[contrast.rating]
        if model is None:
            estimates.append(None)
            continue
        value, error = model.contrast(names.index(contrast.more), names.index(contrast.less))
        estimates.append(_estimate(value, error, fit.freedom))
        what = f"{contrast.rating}: {contrast.more} - {contrast.less} [log odds]"
        part = Part(what, value, "t", fit.unit, fit.freedom + 1, error, above=0.0, form="z.2f")
        verdicts.append(Verdict(contrast.claim, (part,)))
    judged = iter(judged_together(verdicts))
    return [(each, None if each is None else next(judged)) for each in estimates]


def _estimate(value: float, error: float, freedom: int) -> Estimate:
    low, high = t_interval(value, error, freedom + 1)
    return Estimate(value, low, high, error, freedom + 1)
