"""Adaptive importance sampling against Gaussians in the unit cube, whose moments are known."""

import math

import numpy as np
import pytest

from hmi_marl.exact.importance import ImportanceSample, Sampling

CENTRE = np.array([0.3, 0.6, 0.5, 0.8])
"""Of the likelihood in each dimension."""


def sample(plan: Sampling, width: float, seed: int) -> ImportanceSample:
    """Draw rounds until they are enough, for a likelihood of this width."""
    found = ImportanceSample(len(CENTRE), plan, seed)
    while not (found.rounds and found.is_enough) and found.rounds < plan.most_rounds:
        u = found.propose()
        found.weigh((-0.5 * ((u - CENTRE) / width) ** 2).sum(axis=-1))
    return found


@pytest.mark.parametrize("width", [0.3, 0.05])
def test_evidence_mean_and_deviation_have_no_bias(width: float) -> None:
    grid = (np.arange(20_000) + 0.5) / 20_000
    likelihood = np.exp(-0.5 * ((grid - CENTRE[:, None]) / width) ** 2)
    mean = (likelihood * grid).sum(axis=1) / likelihood.sum(axis=1)
    spread = (likelihood * (grid - mean[:, None]) ** 2).sum(axis=1) / likelihood.sum(axis=1)
    evidence = likelihood.mean(axis=1).prod()
    ratios, errors, widths = [], [], []
    for seed in range(30):
        found = sample(Sampling(), width, seed)
        weights = np.exp(found.log_weights)
        ratios.append(weights.mean() / evidence)
        own = weights @ found.points / weights.sum()
        errors.append((own - mean) / np.sqrt(spread))
        widths.append(weights @ (found.points - own) ** 2 / weights.sum() / spread)
    half = [4 * np.std(each, axis=0) / math.sqrt(30) for each in (ratios, errors)]
    assert abs(np.mean(ratios) - 1) < half[0] + 0.02  # 0.13 if points count as their own centres
    assert (np.abs(np.mean(errors, axis=0)) < half[1] + 0.01).all()
    assert np.mean(widths) == pytest.approx(1, abs=0.02)  # 0.95 if they do


def test_a_fit_to_one_group_alone_is_finite() -> None:
    plan = Sampling(groups=8, shared=1, rounds=2, most_rounds=4, effective=1)
    found = ImportanceSample(1, plan, 0)
    u = found.propose()
    only = np.full(u.shape[:2], -np.inf)
    only[3] = 0.0
    found.weigh(only)
    found.weigh(np.zeros(found.propose().shape[:2]))
    assert np.isfinite(found.log_weights[found.log_weights > -np.inf]).all()
    assert not np.isnan(found.log_weights).any()
