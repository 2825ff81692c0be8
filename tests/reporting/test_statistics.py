import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hmi_marl.reporting.statistics import (
    Estimate,
    accuracy,
    average,
    by_logarithm,
    cut,
    difference_of_shares,
    geometric_mean_of_same,
    geometric_ratio,
    interval_with_luck,
    mean,
    mean_of_same,
    mean_share,
    number,
    quotient,
    ratio,
    share,
    wilson_interval,
)

NUMBERS = st.lists(st.floats(-1e3, 1e3), min_size=2, max_size=20)
COUNTS = st.integers(1, 300).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n)))


def test_t_interval_of_two_values_worked_by_hand() -> None:
    # standard error 1, one degree of freedom: t = 12.7062
    estimate = mean([2.0, 4.0])
    assert estimate.mean == 3.0
    assert estimate.low == pytest.approx(3.0 - 12.7062, abs=1e-4)
    assert estimate.high == pytest.approx(3.0 + 12.7062, abs=1e-4)


def test_t_interval_of_five_values_worked_by_hand() -> None:
    # standard deviation sqrt(2.5), four degrees of freedom: t = 2.776445
    estimate = mean([1, 2, 3, 4, 5])
    half = 2.776445 * math.sqrt(2.5 / 5)
    assert estimate.mean == 3.0
    assert estimate.low == pytest.approx(3.0 - half, abs=1e-5)
    assert estimate.high == pytest.approx(3.0 + half, abs=1e-5)


def test_an_interval_ends_at_the_lowest_value_that_is_possible() -> None:
    cut, whole = mean([2.0, 4.0], lowest=0.0), mean([2.0, 4.0])
    assert (cut.mean, cut.low, cut.high) == (whole.mean, 0.0, whole.high)
    assert mean([20.0, 21.0], lowest=0.0) == mean([20.0, 21.0])
    assert math.isnan(mean([2.0], lowest=0.0).low), "still not known"


def test_equal_values_have_an_interval_of_no_width() -> None:
    assert mean([7.0, 7.0, 7.0]) == Estimate(7.0, 7.0, 7.0)


def test_one_value_has_a_mean_but_no_interval() -> None:
    estimate = mean([5.0])
    assert estimate.mean == 5.0
    assert math.isnan(estimate.low)
    assert math.isnan(estimate.high)


def test_no_values_have_no_mean() -> None:
    estimate = mean([])
    assert all(map(math.isnan, (estimate.mean, estimate.low, estimate.high, estimate.error)))
    assert estimate.count == 0


@pytest.mark.parametrize("odd", [math.inf, -math.inf, math.nan])
def test_values_that_are_not_finite_are_left_out(odd: float) -> None:
    assert mean([odd, 2.0, odd, 4.0]) == mean([2.0, 4.0])


def test_only_infinite_values_have_no_mean() -> None:
    assert math.isnan(mean([math.inf, math.inf]).mean)


@pytest.mark.parametrize(
    ("successes", "trials", "low", "high"),
    [
        # z^2 = 3.841459: none of n gives z^2 / (n + z^2), and all of n mirrors it
        (0, 10, 0.0, 3.841459 / 13.841459),
        (10, 10, 10 / 13.841459, 1.0),
        (0, 1, 0.0, 3.841459 / 4.841459),
        (1, 1, 1 / 4.841459, 1.0),
        # half of ten: 0.5 -+ z sqrt(0.25 / 10 + z^2 / 400) / (1 + z^2 / 10)
        (5, 10, 0.236594, 0.763406),
    ],
)
def test_wilson_intervals_worked_by_hand(
    successes: int, trials: int, low: float, high: float
) -> None:
    estimate = share(successes, trials)
    assert estimate.mean == successes / trials
    assert estimate.low == pytest.approx(low, abs=1e-5)
    assert estimate.high == pytest.approx(high, abs=1e-5)


@pytest.mark.parametrize(("successes", "trials"), [(0, 0), (3, 2), (-1, 5), (0, -1)])
def test_shares_that_are_none_are_refused(successes: int, trials: int) -> None:
    with pytest.raises(ValueError, match=f"{successes} successes in {trials} trials"):
        share(successes, trials)


def test_an_accuracy_has_the_interval_of_independent_trials() -> None:
    right = np.arange(8) < 6
    assert accuracy(right, 8) == share(6, 8)
    # Six of eight in four trials: three of them.
    assert accuracy(right, 4) == share(3, 4)
    # In three trials 2.25: its ends are those of two and of three.
    found = accuracy(right, 3)
    assert (found.mean, found.low, found.high) == (0.75, share(2, 3).low, share(3, 3).high)


def test_json_says_none_where_nothing_is_known() -> None:
    nothing = {"low": None, "high": None, "error": None, "luck": 0.0, "luck_count": 0}
    assert mean([5.0]).as_json() == {"mean": 5.0, "count": 1, **nothing}
    assert mean([]).as_json() == {"mean": None, "count": 0, **nothing}
    known = Estimate(1.0, 0.5, 1.5, 0.25, 9)
    content = {"mean": 1.0, "low": 0.5, "high": 1.5, "error": 0.25, "count": 9}
    assert known.as_json() == content | {"luck": 0.0, "luck_count": 0}
    again = Estimate.from_json(content)
    assert (again, again.error, again.count) == (known, 0.25, 9)
    assert math.isnan(Estimate.from_json(mean([]).as_json()).mean)


def test_every_estimate_knows_its_standard_error_and_its_units() -> None:
    found = mean([1, 2, 3, 4, 5])
    assert (found.error, found.count) == (pytest.approx(math.sqrt(0.5)), 5)
    turned = -mean([2.0, 5.0])
    assert (turned.mean, turned.error, turned.count) == (-3.5, pytest.approx(1.5), 2)
    assert (turned.low, turned.high) == (-mean([2.0, 5.0]).high, -mean([2.0, 5.0]).low)
    # deviations 1 - 2 and 3 - 2 of two episodes of one step each
    of_steps = ratio([1.0, 3.0], [1.0, 1.0])
    assert (of_steps.error, of_steps.count) == (pytest.approx(1.0), 2)
    assert average([found, found]).error == pytest.approx(math.sqrt(0.5) / math.sqrt(2))
    assert (share(3, 4).count, accuracy(np.ones(8, np.bool_), 4).count) == (4, 4)


def test_shares_over_seeds_keep_the_luck_of_their_trials() -> None:
    same = mean_share([share(100, 100)] * 5)  # no spread over seeds
    low, high = wilson_interval(1.0, 100, math.erf(math.sqrt(0.5)))
    assert (same.mean, same.error, same.count) == (1.0, pytest.approx((high - low) / 2), 5)
    assert same.low < 1.0 == same.high
    spread = mean_share([share(50, 100), share(70, 100)])
    assert spread.error == pytest.approx(math.hypot(0.1, math.sqrt(0.24 / 101)), rel=0.02)
    assert math.isnan(mean_share([share(9, 10)]).low)


def test_differences_of_shares_keep_the_luck_of_the_trials_of_both() -> None:
    ones, others = [share(100, 100)] * 5, [share(90, 100)] * 5  # no spread over seeds
    found = difference_of_shares(ones, others)
    luck = math.hypot(mean_share(ones).error, mean_share(others).error)
    assert (found.mean, found.count) == (pytest.approx(0.1), 5)
    assert (found.error, found.luck, found.luck_count) == (pytest.approx(luck), found.error, 100)
    assert found.low < 0.1 - 1.9 * luck
    spread = difference_of_shares([share(50, 100), share(70, 100)], [share(50, 100)] * 2)
    assert spread.error == pytest.approx(math.hypot(0.1, spread.luck))
    assert math.isnan(difference_of_shares([share(9, 10)], others).low)


def test_a_ratio_of_positive_values_by_its_logarithms() -> None:
    found = geometric_ratio([2.0, 8.0, math.inf], [1.0, 1.0, 1.0])
    assert (found.mean, found.count) == (pytest.approx(4.0), 2)
    assert found.error == pytest.approx(math.log(2.0))
    assert found.low == pytest.approx(math.exp(math.log(4) - 12.7062 * math.log(2)), rel=1e-4)


def test_numbers_by_their_logarithms_worked_by_hand() -> None:
    # Student's t of 9 degrees of freedom: 2.26216
    one, other = by_logarithm(6.0, 0.3, 10), by_logarithm(2.0, 0.4, 20)
    assert (one.mean, one.error, one.count) == (6.0, 0.3, 10)
    assert one.low == pytest.approx(6.0 * math.exp(-2.26216 * 0.3), rel=1e-5)
    assert one.high == pytest.approx(6.0 * math.exp(2.26216 * 0.3), rel=1e-5)
    both = quotient(one, other)
    assert (both.mean, both.error, both.count) == pytest.approx((3.0, 0.5, 10))
    # logarithms 0 and 2: mean 1, standard error 1, t = 12.7062; and 0.5 of ten units
    seeds = [by_logarithm(1.0, 0.4, 10), by_logarithm(math.exp(2.0), 0.6, 12)]
    over = geometric_mean_of_same(seeds)
    assert (over.mean, over.count) == (pytest.approx(math.e), 2)
    assert (over.error, over.luck) == pytest.approx((math.hypot(1.0, 0.5), 0.5))
    assert over.luck_count == 10
    half = math.hypot(12.7062, 2.26216 * 0.5)
    assert [math.log(over.low), math.log(over.high)] == pytest.approx(
        [1 - half, 1 + half], abs=1e-4
    )
    assert math.isnan(geometric_mean_of_same(seeds[:1]).low)
    assert by_logarithm(1.0, 1e6, 2).low == 0.0
    assert math.isfinite(by_logarithm(1.0, 1e6, 2).high)


def test_ends_that_an_interval_cannot_pass() -> None:
    assert cut(-0.1, 1.1) == (0.0, 1.0)
    assert cut(0.2, 0.7) == (0.2, 0.7)
    assert cut(-3.0, 3.0, lowest=-math.inf) == (-3.0, 1.0)
    assert all(math.isnan(end) for end in cut(math.nan, math.nan))


@settings(deadline=None, database=None)
@given(NUMBERS, st.floats(-100, 100), st.floats(0.1, 10))
def test_the_interval_moves_and_stretches_with_the_values(
    values: list[float], shift: float, factor: float
) -> None:
    plain, moved = mean(values), mean(np.array(values) * factor + shift)
    for end in ("mean", "low", "high"):
        wanted = getattr(plain, end) * factor + shift
        assert getattr(moved, end) == pytest.approx(wanted, rel=1e-6, abs=1e-6)


@settings(deadline=None, database=None)
@given(NUMBERS)
def test_more_of_the_same_values_narrow_the_interval(values: list[float]) -> None:
    once, often = mean(values), mean(values * 4)
    assert once.low <= once.mean <= once.high
    assert often.mean == pytest.approx(once.mean, abs=1e-9)
    assert often.high - often.low <= once.high - once.low + 1e-9


@settings(deadline=None, database=None)
@given(COUNTS)
def test_a_share_and_what_it_leaves_mirror_each_other(counts: tuple[int, int]) -> None:
    successes, trials = counts
    estimate, rest = share(successes, trials), share(trials - successes, trials)
    assert 0.0 <= estimate.low <= estimate.mean <= estimate.high <= 1.0
    assert estimate.high - estimate.low > 0.0
    assert rest.low == pytest.approx(1.0 - estimate.high, abs=1e-9)
    assert rest.high == pytest.approx(1.0 - estimate.low, abs=1e-9)


def test_an_estimate_agrees_within_its_interval_or_a_share_of_the_other() -> None:
    assert Estimate(-110, -120, -100).agrees(-119, share=0.0)
    assert Estimate(-101.9, -102, -101.8).agrees(-100, share=0.02)
    assert not Estimate(-102.1, -102.2, -102.05).agrees(-100, share=0.02)


def test_estimates_are_written_as_far_as_they_are_known() -> None:
    assert Estimate(1.25, -0.01, 2.0).shown() == "1.2 [0.0, 2.0]"
    assert Estimate(12.0, 11.0, 13.0).shown("+.0f") == "+12 [+11, +13]"
    assert mean([5.0]).shown(".2f") == "5.00"
    assert mean([]).shown() == "-"
    assert Estimate(0.125, 0.1, 0.2).percent() == "12.5 [10.0, 20.0]"
    assert [number(value, ".2f") for value in (None, math.inf, 0.5)] == ["-", "-", "0.50"]


def test_a_ratio_of_two_episodes_worked_by_hand() -> None:
    # R = 4/6; deviations a - R n are -1/3 and 1/3, over the mean count 3: standard error 1/9
    estimate = ratio([1.0, 3.0], [2, 4])
    assert estimate.mean == pytest.approx(2 / 3)
    assert estimate.low == pytest.approx(2 / 3 - 12.7062 / 9, abs=1e-4)
    assert estimate.high == pytest.approx(2 / 3 + 12.7062 / 9, abs=1e-4)
    assert ratio([1.0, 3.0], [2, 4], 0.0, 1.0) == Estimate(estimate.mean, 0.0, 1.0)


def test_a_ratio_of_equal_counts_is_a_mean() -> None:
    one, other = ratio([1.0, 2.0, 6.0], [4, 4, 4]), mean([0.25, 0.5, 1.5])
    assert vars(one) == pytest.approx(vars(other))


def test_a_ratio_without_counts_is_not_known() -> None:
    assert math.isnan(ratio([0.0], [0]).mean)
    assert math.isnan(ratio([0.0], [0]).low)
    one = ratio([1.0, 0.0], [4, 0])
    assert one.mean == 0.25
    assert math.isnan(one.low)
    assert ratio([1.0, 0.0, 3.0], [2, 0, 4]) == ratio([1.0, 3.0], [2, 4])


@pytest.mark.slow
def test_the_interval_of_a_ratio_covers_the_truth_in_19_of_20_samples() -> None:
    # 2000 samples of 40 episodes whose steps are all alike: the interval is over episodes
    rng, trials = np.random.default_rng(0), 2000
    covered = 0
    for _ in range(trials):
        counts = rng.integers(20, 100, 40)
        estimate = ratio(counts * (rng.random(40) < 0.4), counts)
        covered += estimate.low <= 0.4 <= estimate.high
    assert abs(covered / trials - 0.95) < 4 * math.sqrt(0.95 * 0.05 / trials) + 0.01


def test_an_average_of_estimates_worked_by_hand() -> None:
    one, other = Estimate(1.0, -2.0, 4.0), Estimate(2.0, -2.0, 6.0)
    assert average([one, other]) == Estimate(1.5, 1.5 - 2.5, 1.5 + 2.5)  # (3, 4, 5) over 2
    assert average([one]) == one
    assert math.isnan(average([]).mean)
    assert math.isnan(average([one, Estimate(2.0, math.nan, math.nan)]).low)


def test_the_luck_of_the_same_units_does_not_average_out_over_seeds() -> None:
    one = Estimate(0.5, 0.304, 0.696)  # a standard error of 0.1
    same = mean_of_same([one] * 5)  # no spread over seeds
    assert same.mean == 0.5
    assert same.error == pytest.approx(0.1, abs=1e-4)
    assert (same.high - same.mean) / same.error == pytest.approx(2.776, abs=1e-3)
    assert math.isnan(mean_of_same([one]).low)


def test_luck_that_many_units_show_has_their_degrees_of_freedom() -> None:
    one = Estimate(0.5, 0.304, 0.696, 0.1, 2001)
    same = mean_of_same([one] * 5)
    assert (same.high - same.mean) / same.error == pytest.approx(1.961, abs=1e-3)
    apart = mean_of_same([replace(one, mean=one.mean + far) for far in (-9.0, 0.0, 9.0)])
    over = mean([-8.5, 0.5, 9.5])
    assert apart.high == pytest.approx(over.high, rel=1e-3), "seeds that differ much are all"
    assert apart.high > over.high
    half = math.hypot(over.high - over.mean, 1.961 * 0.1)  # squares of half intervals add up
    assert apart.high - apart.mean == pytest.approx(half, abs=1e-4)
    read = Estimate.from_json(apart.as_json())
    assert (read.luck, read.luck_count) == (apart.luck, 2001)
    assert (-apart).luck == apart.luck
    assert mean([1.0, 2.0]).as_json()["luck"] == 0.0


@pytest.mark.parametrize("luck", [1e300, -1e300, 5e-324])
@pytest.mark.parametrize("error", [0.0, 1e300, 5e-324])
def test_luck_of_any_size_has_an_interval(luck: float, error: float) -> None:
    low, high = interval_with_luck(0.0, error, 5, luck, 100)
    assert low <= 0.0 <= high


@pytest.mark.parametrize("confidence", [0.95, 0.998])
@pytest.mark.parametrize("between", [0.0, 0.5, 1.0, 2.0, 4.0, 8.0])
def test_intervals_over_seeds_that_share_luck_hold_the_truth(
    between: float, confidence: float
) -> None:
    """Of 4000 simulated experiments; the shared luck has a standard deviation of 1."""
    rng, missed = np.random.default_rng(int(10 * between)), 0
    for _ in range(4000):
        means = rng.normal() + between * rng.normal(size=5)
        found = mean_of_same([Estimate(m, m - 1.96, m + 1.96, 1.0, 2000) for m in means])
        over = found.error, found.count, found.luck, found.luck_count
        low, high = interval_with_luck(found.mean, *over, confidence)
        missed += not low <= 0.0 <= high
    allowed = 4000 * (1.0 - confidence)
    assert missed <= allowed + 3.5 * math.sqrt(allowed)
