"""The likelihood of traits at the true ones: scores of mean zero and of the variance that they say.

For any correct likelihood, the derivative of its logarithm at the true value has mean 0, and its
variance is the mean curvature. Summed over the windows of a person that holds only if windows are
independent given the traits, so that pooled posteriors are calibrated.
"""

import numpy as np
import pytest
from numpy.typing import NDArray

from hmi_marl.demonstrations.recording import CollectSettings, collect
from hmi_marl.exact.trait_likelihood import TraitLikelihood, Windows
from hmi_marl.experiments.latent_traits.ceiling import driver_policy_of

WINDOWS = 8
STEP = 2e-3
"""Of a trait, for derivatives by differences."""
SMOOTH = ("beta", "alpha", "eta")
"""Traits in which the likelihood is smooth."""


def derivatives(people: int, policy: str, seed: int) -> tuple[NDArray[np.float64], ...]:
    """Scores and curvatures of each window at the true traits (E, 3), and the traits (E, 4)."""
    settings = CollectSettings(
        drivers=(), population=people, windows=WINDOWS, driver_policy=policy, seed=seed
    )
    config = settings.team("lisa")
    scores, curvatures, traits = [], [], []
    for part in collect(settings):
        seen, truth = part.observed, part.truth
        assert truth is not None
        true = truth.traits
        count = len(true)
        windows = Windows.checked(
            config, seen.seeds, seen.actions, seen.alerts, seen.length, None, np.arange(count)
        )
        near = np.repeat(true[:, None], 1 + 2 * len(SMOOTH), axis=1)
        for k in range(len(SMOOTH)):
            near[:, 1 + 2 * k, k] += STEP
            near[:, 2 + 2 * k, k] -= STEP
        likelihood = TraitLikelihood(config, driver_policy_of(seen, None, config), windows)
        found = likelihood(np.arange(count), near[:, None])[:, 0]
        more, less = found[:, 1::2], found[:, 2::2]
        scores.append((more - less) / (2 * STEP))
        curvatures.append((2 * found[:, :1] - more - less) / STEP**2)
        traits.append(true)
    return tuple(map(np.concatenate, (scores, curvatures, traits)))


@pytest.mark.slow
@pytest.mark.parametrize("policy", ["trained:driver", "trained:driver-inflation"])
def test_scores_at_the_true_traits_have_mean_zero_and_their_own_variance(policy: str) -> None:
    people = 500
    scores, curvatures, traits = derivatives(people, policy, seed=11)
    rng = np.random.default_rng(0)
    for k in range(len(SMOOTH)):
        true, each, curved = (
            values[:, k].reshape(people, WINDOWS) for values in (traits, scores, curvatures)
        )
        inside = (true[:, 0] > 0.05) & (true[:, 0] < 0.95)
        by_person, information = each.sum(axis=1)[inside], curved.sum(axis=1)[inside]
        count = len(by_person)
        assert abs(by_person.mean()) < 4 * by_person.std() / np.sqrt(count)
        drawn = rng.integers(0, count, (400, count))
        ratios = (by_person[drawn] ** 2).sum(axis=1) / information[drawn].sum(axis=1)
        assert ratios.std() < 0.25
        # 1 + 7 r if windows of a person had scores of correlation r.
        assert abs((by_person**2).sum() / information.sum() - 1) < 4 * ratios.std()
