"""Statistics over runs: hand-worked numbers, what is known of them, and scipy's own."""

import math

import numpy as np
import pytest
from scipy import stats

from hmi_marl.reporting.many_runs import (
    holm,
    interquartile_mean,
    over_runs,
    paired_differences,
    performance_profile,
    probability_of_improvement,
    shared_error,
)

SCORES = np.random.default_rng(3).normal(size=(10, 4))


def test_the_interquartile_mean_leaves_out_a_quarter_at_either_end():
    assert interquartile_mean(np.array([[0.0, 1.0], [2.0, 100.0]])) == pytest.approx(1.5)
    assert interquartile_mean(np.array([[-1e9, 4.0, 6.0, 1e9]])) == pytest.approx(5.0)


def test_the_interval_is_a_bootstrap_over_whole_runs():
    found = over_runs(SCORES, lambda part: part.mean(axis=(-2, -1)))
    tail = stats.norm.sf(stats.t.ppf(0.975, 9) * math.sqrt(10 / 9))  # 10 runs
    whole = stats.bootstrap(
        (SCORES.mean(axis=1),),
        np.mean,
        method="percentile",
        n_resamples=20_000,
        confidence_level=1 - 2 * tail,
        rng=1,
    ).confidence_interval
    assert found.mean == pytest.approx(SCORES.mean())
    assert found.low == pytest.approx(whole.low, abs=0.03)
    assert found.high == pytest.approx(whole.high, abs=0.03)


def test_drivers_of_equal_runs_leave_no_uncertainty():
    equal = np.tile([1.0, 5.0, 9.0], (6, 1))  # drivers differ, runs do not
    found = over_runs(equal)
    assert (found.low, found.mean, found.high) == (5.0, 5.0, 5.0)


@pytest.mark.parametrize(("runs", "least"), [(5, 0.85), (10, 0.90), (20, 0.90)])
def test_the_interval_covers_the_truth_about_as_often_as_it_says(runs, least):
    rng = np.random.default_rng(0)
    held = 0
    for _ in range(200):
        run = rng.normal(size=(runs, 1)) + rng.normal(scale=0.1, size=(runs, 3))
        found = over_runs(run, lambda part: part.mean(axis=(-2, -1)))
        held += found.low <= 0.0 <= found.high
    assert least <= held / 200 <= 0.995


def test_three_runs_reach_from_the_least_to_the_greatest():
    found = over_runs([[1.0], [2.0], [6.0]], lambda part: part.mean(axis=(-2, -1)))
    assert (found.low, found.mean, found.high) == pytest.approx((1.0, 3.0, 6.0), abs=0.05)


def test_the_same_scores_give_the_same_interval():
    assert over_runs(SCORES) == over_runs(SCORES.copy())


def test_one_run_has_no_interval():
    found = over_runs([[1.0, 2.0]])
    assert found.mean == 1.5
    assert math.isnan(found.low)


def test_the_probability_of_improvement_counts_pairs_and_halves_ties():
    found = probability_of_improvement([[1.0], [3.0]], [[2.0], [3.0]])
    assert found.mean == pytest.approx((0 + 0 + 1 + 0.5) / 4)
    assert probability_of_improvement(SCORES + 10, SCORES).mean == 1.0
    assert probability_of_improvement(SCORES, SCORES).mean == pytest.approx(0.5)
    u = stats.mannwhitneyu(SCORES[:, 0], SCORES[:7, 1]).statistic
    found = probability_of_improvement(SCORES[:, :1], SCORES[:7, 1:2])
    assert found.mean == pytest.approx(u / 70)
    assert found.low < found.mean < found.high


def test_a_profile_is_the_share_above_each_threshold():
    profile = performance_profile([[0.0, 1.0], [2.0, 3.0]], [-1.0, 0.5, 5.0])
    assert profile.share.tolist() == [1.0, 0.75, 0.0]
    assert (profile.low <= profile.share).all()
    assert (profile.share <= profile.high).all()


def test_differences_are_paired_and_corrected_for_their_number():
    first, second = SCORES[:, 0] + 1.0, SCORES[:, 0] + 0.1 * SCORES[:, 1]
    (alone,) = paired_differences([(first, second)])
    test = stats.ttest_rel(first, second)
    assert alone.p == pytest.approx(test.pvalue)
    assert alone.estimate.low == pytest.approx(test.confidence_interval().low)
    assert alone.differs
    (among,) = paired_differences([(first, second)], comparisons=10)
    assert among.p == pytest.approx(10 * test.pvalue)
    wide = test.confidence_interval(0.995)
    assert (among.estimate.low, among.estimate.high) == pytest.approx((wide.low, wide.high))


def test_only_seeds_that_both_have_are_paired():
    (found,) = paired_differences([([1.0, 2.0, 9.0], [0.0, 0.0])])
    assert (found.pairs, found.estimate.mean) == (2, 1.5)


def test_a_single_pair_decides_nothing():
    (found,) = paired_differences([([1.0], [0.0])])
    assert found.differs is None
    assert found.estimate.mean == 1.0


def test_equal_differences_are_certain_and_none_is_no_difference():
    certain, none = paired_differences([([2.0, 3.0], [1.0, 2.0]), ([1.0, 2.0], [1.0, 2.0])])
    assert certain.differs
    assert none.differs is False


def test_holms_method_by_hand():
    assert holm([0.01, 0.04, 0.03]) == pytest.approx([0.03, 0.06, 0.06])
    assert holm([0.4, 0.9]) == pytest.approx([0.8, 0.9])
    corrected = holm([0.01, math.nan], comparisons=2)
    assert corrected[0] == pytest.approx(0.02)
    assert math.isnan(corrected[1])


@pytest.mark.parametrize("scores", [[1.0, 2.0], [[]], [[math.nan]], [[math.inf, 1.0]]])
def test_scores_that_are_none_are_refused(scores):
    with pytest.raises(ValueError, match="scores"):
        over_runs(scores)


def test_more_pairs_than_comparisons_are_refused():
    with pytest.raises(ValueError, match="2 pairs are more than 1"):
        paired_differences([([1.0], [0.0])] * 2, comparisons=1)


def test_kinds_of_runs_share_their_drivers():
    with pytest.raises(ValueError, match="4 and with 2 drivers"):
        probability_of_improvement(SCORES, SCORES[:, :2])


def test_errors_that_all_runs_share_count_for_drivers_in_the_middle() -> None:
    scores = np.tile([0.1, 0.5, 0.6, 1.0], (5, 1)) + 0.001 * np.arange(5)[:, None]
    alike = shared_error(scores, [0.01] * 4)
    assert alike == pytest.approx(0.01 / math.sqrt(2), rel=0.05)  # of two drivers, not of four
    every = shared_error(scores, [0.01] * 4, lambda part: part.mean(axis=(-2, -1)))
    assert every == pytest.approx(0.005, rel=0.05)
    assert shared_error(scores, [0.01, 0.0, 0.0, 0.01]) == pytest.approx(0.0, abs=1e-12)
    assert shared_error(scores, [0.0] * 4) == 0.0
    assert math.isnan(shared_error(scores, [0.01, 0.01, 0.01, math.nan]))
