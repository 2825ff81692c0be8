import numpy as np
import pytest

from hmi_marl.experiments.adaptation.trips import (
    Trips,
    by_second,
    by_turn,
    closed,
    earned_between,
    ratio,
)

# Two drivers, three trips of four steps; the second driver crashes in the first two trips.
REWARDS = np.array(
    [
        [[1, 2, 3, 4], [5, 6, 7, 8], [9, 10, 11, 12]],
        [[1, 2, 0, 0], [3, 0, 0, 0], [4, 5, 6, 7]],
    ],
    np.float64,
)
DRIVING = np.array(
    [[[1, 1, 1, 1]] * 3, [[1, 1, 0, 0], [1, 0, 0, 0], [1, 1, 1, 1]]],
).astype(np.bool_)
TRIPS = Trips(REWARDS, DRIVING)
NAN = np.nan


def test_returns_are_those_of_each_trip():
    assert TRIPS.returns.tolist() == [[10, 26, 42], [3, 3, 22]]


def test_turns_by_turn_leave_out_what_came_after_a_crash():
    expected = [list(range(1, 13)), [1, 2, 3, 4, 5, 6, 7, NAN, NAN, NAN, NAN, NAN]]
    np.testing.assert_array_equal(by_turn(TRIPS, REWARDS), expected)
    other = by_turn(TRIPS, REWARDS + 100 * ~DRIVING)
    np.testing.assert_array_equal(other, expected)


def test_what_is_earned_between_two_turns():
    assert earned_between(TRIPS, 0, 3).tolist() == [6, 6]
    assert earned_between(TRIPS, 2, 8).tolist() == [3 + 4 + 5 + 6 + 7 + 8, 3 + 4 + 5 + 6 + 7]
    assert earned_between(TRIPS, 9, 12).tolist() == [33, 0], "who has not driven so long"


def test_means_by_second_of_those_who_are_still_driving():
    # 7 turns of both; turns 8 to 12 of half of them
    assert by_second(TRIPS, REWARDS, 2).tolist() == [1.5, 3.5, 5.5, 7.5, 9.5, 11.5]
    three = Trips(REWARDS[[0, 1, 1]], DRIVING[[0, 1, 1]])
    assert by_second(three, three.rewards, 2).tolist() == [1.5, 3.5, 5.5], "and whole seconds alone"
    assert by_second(three, three.rewards, 5).tolist() == [3.0]


def test_the_share_of_a_gap_by_hand():
    knowing = np.array([10.0, 20.0, 30.0, 40.0])
    found = closed(knowing, knowing - 8.0, knowing - 2.0, np.arange(4))
    for estimate, expected in ((found.share, 0.75), (found.gap, 8.0), (found.regret, 2.0)):
        assert estimate.mean == pytest.approx(expected)
        assert (estimate.low, estimate.high) == pytest.approx((expected, expected))


def test_knowing_closes_all_of_it_and_the_average_hmi_none():
    rng = np.random.default_rng(0)
    knowing = rng.normal(10.0, 3.0, 200)
    average = rng.normal(5.0, 3.0, 200)
    whole = closed(knowing, average, knowing, np.arange(200)).share
    assert (whole.mean, whole.low, whole.high) == (1.0, 1.0, 1.0)
    none = closed(knowing, average, average, np.arange(200)).share
    assert (none.mean, none.low, none.high) == pytest.approx((0.0, 0.0, 0.0))


def test_a_share_may_exceed_all_and_fall_below_none():
    knowing = np.full(5, 10.0)
    assert closed(knowing, knowing - 4, knowing + 1, np.arange(5)).share.mean == 1.25
    assert closed(knowing, knowing - 4, knowing - 5, np.arange(5)).share.mean == -0.25


@pytest.mark.parametrize("gap", [0.0, -3.0])
def test_no_share_is_told_where_there_is_no_gap(gap):
    knowing = np.random.default_rng(1).normal(size=50)
    noise = np.random.default_rng(2).normal(size=50)
    found = closed(knowing, knowing - gap + noise - noise.mean(), knowing - 1, np.arange(50))
    assert np.isnan([found.share.mean, found.share.low, found.share.high]).all()
    assert found.gap.mean == pytest.approx(gap, abs=1e-9)
    assert found.gap.low <= gap <= found.gap.high
    assert found.regret.mean == pytest.approx(1.0)


def test_intervals_cover_what_they_are_to_cover():
    rng, hits = np.random.default_rng(3), 0
    for seed in range(120):
        knowing = rng.normal(0, 1, 60)
        average = knowing - rng.normal(4, 2, 60)
        own = knowing - rng.normal(1, 2, 60)
        share = closed(knowing, average, own, np.arange(60), seed).share
        hits += share.low <= 0.75 <= share.high
    # of 95 %; four deviations
    assert abs(hits / 120 - 0.95) < 4 * np.sqrt(0.95 * 0.05 / 120)


def test_trips_of_one_driver_are_drawn_together():
    rng = np.random.default_rng(4)
    same = np.repeat(np.arange(20), 8)
    gap = rng.normal(10, 3, 20)[same]
    knowing = np.zeros(160)
    together = closed(knowing, -gap, -gap / 2, same).gap
    apart = closed(knowing, -gap, -gap / 2, np.arange(160)).gap
    assert together.mean == pytest.approx(apart.mean) == pytest.approx(gap.mean())
    widths = [estimate.high - estimate.low for estimate in (together, apart)]
    assert widths[0] / widths[1] == pytest.approx(np.sqrt(8), rel=0.2)
    names = closed(knowing, -gap, -gap / 2, 7 * same + 3)
    assert names.gap == together, "drivers may be named as one likes"


def test_a_driver_with_more_trips_counts_for_more():
    gap = np.array([2.0, 2.0, 2.0, 6.0])
    found = closed(np.zeros(4), -gap, -gap / 4, np.array([0, 0, 0, 1]))
    assert found.gap.mean == pytest.approx(3.0)
    assert found.share.mean == pytest.approx(0.75)


def test_a_ratio_is_of_means_and_by_size():
    found = ratio(np.array([1.0, 3.0]), np.array([-10.0, -10.0]))
    assert found.mean == pytest.approx(0.2)
    assert found.low == pytest.approx(0.1)
    assert found.high == pytest.approx(0.3)
    assert ratio(np.array([1.0, 1.0]), np.array([5.0, 5.0])).mean == pytest.approx(0.2)
    pairs = ratio(np.array([1.0, 4.0, 2.0]), np.array([10.0, 40.0, 20.0]))
    assert (pairs.low, pairs.high) == pytest.approx((0.1, 0.1)), "paired"


def test_a_ratio_to_nothing_is_not_told():
    found = ratio(np.zeros(3), np.zeros(3))
    assert np.isnan([found.mean, found.low, found.high]).all()
    assert {found.as_json()[name] for name in ("mean", "low", "high", "error")} == {None}


def test_the_same_seed_draws_the_same_intervals():
    rng = np.random.default_rng(5)
    knowing, average = rng.normal(3, 1, 30), rng.normal(0, 1, 30)
    own = rng.normal(2, 1, 30)
    one, two, other = (closed(knowing, average, own, np.arange(30), seed) for seed in (0, 0, 1))
    assert one == two
    assert one.share.low != other.share.low
