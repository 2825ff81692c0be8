"""Simulated raters, with differences that are planted; always marked as simulated.

A simulated rater's rating of a clip is the condition's mean, plus normal draws of the rater, of the
rater with this driver, of the clip and of the moment, rounded and cut to 1 to 7; see
:class:`~hmi_marl.people.study.settings.Plan`. Careless raters fail the attention check.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hmi_marl.people.study.folder import Study
from hmi_marl.people.study.order import CHECK, order
from hmi_marl.people.study.ratings import SIMULATED, StudyAnswer, question_of
from hmi_marl.people.study.settings import POINTS, RATINGS, Contrast, Plan, StudySettings


@dataclass(frozen=True)
class Shown:
    """What R raters see, attention checks apart.

    Shapes (R, M): M clips of each rater, in their order.
    """

    condition: NDArray[np.int64]
    clip: NDArray[np.int64]
    """Number of the clip in the study."""


def shown_to(raters: int, settings: StudySettings) -> Shown:
    """Return what raters 0 to R - 1 of a study see."""
    conditions, clips = len(settings.conditions), settings.clips
    rows = [
        [place for place in order(number, conditions, clips, settings.shown, settings.seed)
         if place != CHECK]
        for number in range(raters)
    ]  # fmt: skip
    condition = np.array([[place.condition for place in row] for row in rows], np.int64)
    within = np.array([[place.clip for place in row] for row in rows], np.int64)
    return Shown(condition, condition * clips + within)


def planted_means(settings: StudySettings, plan: Plan) -> NDArray[np.float64]:
    """Return means before rounding, by which every intended difference is ``plan.effect`` at least.

    Conditions are put in the fewest levels that the contrasts of a rating allow, one effect apart.

    Returns:
        Shape (C, 4), columns as in ``RATINGS``.

    Raises:
        ValueError: contrasts contradict each other.
    """
    names = [each.name for each in settings.conditions]
    means = np.empty((len(names), len(RATINGS)))
    for column, rating in enumerate(RATINGS):
        own = [contrast for contrast in settings.intended if contrast.rating == rating]
        level = dict.fromkeys(names, 0)
        for _ in names:
            for contrast in own:
                level[contrast.more] = max(level[contrast.more], level[contrast.less] + 1)
        for contrast in own:
            if level[contrast.more] <= level[contrast.less]:
                raise ValueError(f"contrasts contradict each other: {contrast.name}")
        levels = np.array([level[name] for name in names], np.float64)
        means[:, column] = plan.middle + plan.effect * (levels - levels.max() / 2)
    return means


def true_difference(
    contrast: Contrast, settings: StudySettings, plan: Plan, means: NDArray[np.float64]
) -> float:
    """Return the difference of expected ratings after rounding, over clips and raters [points]."""
    from scipy import stats

    names = [each.name for each in settings.conditions]
    column = RATINGS.index(contrast.rating)
    spread = np.sqrt(plan.rater**2 + plan.clip**2 + plan.rater_driver**2 + plan.residual**2)
    edges = np.arange(1, POINTS) + 0.5
    own = means[[names.index(contrast.more), names.index(contrast.less)], column]
    expected = stats.norm.sf((edges - own[:, None]) / spread).sum(axis=1)
    return float(expected[0] - expected[1])


def simulate(
    shown: Shown, means: NDArray[np.float64], plan: Plan, clips: int, rng: np.random.Generator
) -> NDArray[np.int64]:
    """Draw the ratings of careful raters.

    Args:
        shown: what R raters see.
        means: of C conditions, shape (C, 4).
        plan: spreads.
        clips: of each condition.
        rng: draws everything, the clips' effects included.

    Returns:
        Shape (R, M, 4), 1 to 7.
    """
    raters, (conditions, ratings) = len(shown.clip), means.shape
    rater = plan.rater * rng.standard_normal((raters, 1, ratings))
    both = plan.rater_driver * rng.standard_normal((raters, conditions, ratings))
    clip = plan.clip * rng.standard_normal((conditions * clips, ratings))
    noise = plan.residual * rng.standard_normal((*shown.clip.shape, ratings))
    seen = np.take_along_axis(both, shown.condition[:, :, None], axis=1)
    latent = means[shown.condition] + rater + seen + clip[shown.clip] + noise
    return np.clip(np.rint(latent), 1, POINTS).astype(np.int64)


def simulated_answers(
    study: Study, raters: int, plan: Plan, seed: int = 0
) -> Sequence[StudyAnswer]:
    """Draw a whole study's answers, attention checks included, of raters named simulated-N."""
    rng = np.random.default_rng([seed, raters])
    settings = study.settings
    shown = shown_to(raters, settings)
    means = planted_means(settings, plan)
    values = simulate(shown, means, plan, settings.clips, rng)
    careless = rng.random(raters) < plan.careless
    wild = rng.integers(1, POINTS + 1, size=values.shape)
    found = []
    for number in range(raters):
        name = f"{SIMULATED}{number + 1}"
        answer = dict.fromkeys(RATINGS, study.check.answer)
        if careless[number]:
            answer["safe"] = answer["safe"] % POINTS + 1
        rows = wild[number] if careless[number] else values[number]
        pages = zip(shown.clip[number].tolist(), rows.tolist(), strict=True)
        found += [
            StudyAnswer(
                name,
                name,
                question_of(study.id, study.clips[clip].name),
                dict(zip(RATINGS, row, strict=True)),
            )
            for clip, row in pages
        ]
        found.append(StudyAnswer(name, name, question_of(study.id, study.check.name), answer))
    return found
