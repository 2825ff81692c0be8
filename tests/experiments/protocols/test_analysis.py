import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hmi_marl.envs.rewards import TERMS
from hmi_marl.experiments.protocols.analysis import (
    Comparison,
    common_curve,
    crash_rate,
    dependence_of,
    dependences,
    find,
    gaming_of,
    over_seeds,
    pooled,
    seed_matrix,
    swap_matrix,
    worst_finding,
)
from hmi_marl.experiments.protocols.experiment import ProtocolComparison
from hmi_marl.experiments.protocols.plan import ALL_DRIVERS, Pair, Sums
from hmi_marl.reporting.statistics import Estimate

SETTINGS = ProtocolComparison(
    protocols=("two-stage", "simultaneous"), seeds=2, drivers=("bart",), num_teams=16
)


def sums(team_return: float = 0.0, episodes: int = 100, crashes: int = 0, **terms: float) -> Sums:
    """``team_return`` per episode, by driving alone; other terms in all."""
    everything = dict.fromkeys(TERMS, 0.0) | {"speed_reward": team_return * episodes} | terms
    return Sums(episodes, crashes, 100 * episodes, 10.0, 0, math.nan, everything)


def comparison(settings: ProtocolComparison = SETTINGS, **changed: Sums) -> Comparison:
    """Every pair alike, but for those whose driver's run is named."""
    played = {}
    for pair in settings.pairs():
        found = changed.get(pair.driver.replace("-", "_"), sums(200.0))
        played[pair] = {ALL_DRIVERS: found, "bart": found}
    return Comparison(settings, played, {})


def rows(steps: list[int], values: list[float]) -> list[dict[str, float]]:
    return [{"steps": s, "team_return": v} for s, v in zip(steps, values, strict=True)]


def test_curves_are_interpolated_on_the_steps_that_they_share() -> None:
    curve = common_curve(
        [rows([100, 200, 300], [0.0, 10.0, 20.0]), rows([150, 250, 350], [4.0, 24.0, 0.0])],
        "team_return",
    )
    np.testing.assert_array_equal(curve.steps, [150, 200, 250, 300])
    # 5 and 4, 10 and 14, 15 and 24, 20 and 12
    np.testing.assert_allclose(curve.mean, [4.5, 12.0, 19.5, 16.0])
    # Student's t with one degree of freedom: 12.706 times half of the difference
    np.testing.assert_allclose(curve.high - curve.mean, 12.7062 * np.array([0.5, 2, 4.5, 4]), 1e-5)
    np.testing.assert_allclose(curve.mean - curve.low, curve.high - curve.mean)


def test_one_curve_alone_is_itself_without_a_band() -> None:
    curve = common_curve([rows([1, 2], [3.0, 5.0])], "team_return")
    np.testing.assert_array_equal(curve.mean, [3.0, 5.0])
    assert np.isnan(curve.low).all()
    assert np.isnan(curve.high).all()


@pytest.mark.parametrize(
    ("runs", "told"),
    [
        ([], "at least one run"),
        ([[]], "at least one row"),
        ([rows([1, 2], [0, 0]), rows([3], [0])], "in common"),
    ],
)
def test_curves_that_cannot_be_put_together_are_refused(runs: list, told: str) -> None:
    with pytest.raises(ValueError, match=told):
        common_curve(runs, "team_return")


def test_partners_that_fit_only_each_other_depend_on_each_other() -> None:
    np.testing.assert_allclose(dependences(np.array([[10.0, 4.0], [2.0, 8.0]])), [6.0, 6.0])
    # only the third is choosy
    matrix = np.array([[5.0, 5.0, 0.0], [5.0, 5.0, 0.0], [0.0, 0.0, 5.0]])
    np.testing.assert_allclose(dependences(matrix), [2.5, 2.5, 5.0])
    assert np.isnan(dependences(np.array([[1.0]]))).all()


numbers = st.lists(st.floats(-1e3, 1e3), min_size=4, max_size=4)


@given(drivers=numbers, hmis=numbers)
def test_partners_that_only_differ_in_skill_do_not_depend(
    drivers: list[float], hmis: list[float]
) -> None:
    matrix = np.add.outer(drivers, hmis)
    np.testing.assert_allclose(dependences(matrix), 0.0, atol=1e-9)


@given(returns=st.lists(numbers, min_size=4, max_size=4))
def test_dependences_are_the_diagonal_less_the_rest_on_the_whole(
    returns: list[list[float]],
) -> None:
    matrix = np.array(returns)
    rest = matrix[~np.eye(4, dtype=bool)]
    expected = np.diag(matrix).mean() - rest.mean()
    assert dependences(matrix).mean() == pytest.approx(expected, abs=1e-9)


def test_dependence_worked_by_hand() -> None:
    told = comparison()
    for pair in told.played:
        if pair.driver != pair.hmi:
            told.played[pair][ALL_DRIVERS] = sums(150.0)  # type: ignore[index]
    two_stage, simultaneous = dependence_of(told)
    assert simultaneous.protocol == "simultaneous"
    for row in (two_stage, simultaneous):
        assert row.own == Estimate(200.0, 200.0, 200.0)
        assert row.driver_with_others.mean == row.hmi_with_others.mean == 150.0
        assert row.on_protocol == row.on_seed == Estimate(50.0, 50.0, 50.0)
        assert row.other_seeds.mean == 150.0


def test_dependence_is_unknown_without_others() -> None:
    settings = replace(SETTINGS, protocols=("joint",), seeds=1)
    (row,) = dependence_of(comparison(settings))
    assert row.own.mean == 200.0
    for unknown in (row.driver_with_others, row.hmi_with_others, row.on_protocol):
        assert math.isnan(unknown.mean)
    assert math.isnan(row.on_seed.mean)
    assert math.isnan(row.other_seeds.mean)


def test_the_matrices_have_drivers_in_rows() -> None:
    told = comparison(two_stage_run1=sums(70.0))
    np.testing.assert_array_equal(
        swap_matrix(told), [[[200, 200], [200, 200]], [[70, 70], [200, 200]]]
    )
    np.testing.assert_array_equal(seed_matrix(told, "two-stage"), [[200, 200], [70, 70]])


def test_means_over_seeds_count_each_seed_once() -> None:
    told = comparison(two_stage_run0=sums(100.0, 10), two_stage_run1=sums(300.0, 1000))
    found = over_seeds(told.played, told.own_pairs("two-stage"), "team_return")
    assert found.mean == 200.0
    assert found.high - found.mean == pytest.approx(12.7062 * 100, rel=1e-5)
    assert pooled(told.played, told.own_pairs("two-stage")).episodes == 1010


def test_counts_have_no_intervals_below_nothing() -> None:
    told = comparison(two_stage_run0=sums(episodes=10, crashes=5))
    pairs = told.own_pairs("two-stage")
    assert over_seeds(told.played, pairs, "crash_rate").low == 0.0
    assert over_seeds(told.played, pairs, "team_return").low < 0.0


def test_a_crash_rate_without_episodes_is_unknown() -> None:
    assert math.isnan(crash_rate(sums(episodes=0)).mean)
    assert crash_rate(sums(episodes=4, crashes=1)).mean == 0.25


@pytest.mark.parametrize(
    ("low", "worth", "finding"),
    [
        (0.13, 1.0, "fine"),
        (0.13, -1.0, "fine"),  # a step may be worth nothing: nobody crashes for it
        (0.15, -1.0, "fine"),  # not by more than the margin
        (0.16, -1.0, "GAMED"),
        (0.16, 0.0, "crashes more"),
        (0.16, 1.0, "crashes more"),
        (math.nan, 1.0, "unknown"),
        (0.16, math.nan, "unknown"),
    ],
)
def test_the_rule_of_gaming(low: float, worth: float, finding: str) -> None:
    assert find(Estimate(0.2, low, 0.3), Estimate(0.05, 0.0, 0.1), worth) == finding


def test_a_driver_who_crashes_to_get_away_games() -> None:
    # 60 of 100 crash; 100 steps each of -3: -2 without the collisions
    crashing = sums(-200.0, crashes=60, collision=-300.0 * 100 + 200.0 * 100)
    told = comparison(simultaneous_run0=crashing, simultaneous_run1=crashing)
    found = {(row.protocol, row.driver): row for row in gaming_of(told)}
    row = found["simultaneous", "bart"]
    assert row.crash_rate.mean == 0.6
    assert row.two_stage_crash_rate.mean == 0.0
    assert row.team_return == -300.0
    assert row.team_return_per_step == -3.0
    assert row.worth_of_a_step == -2.0
    assert row.finding == "GAMED"
    assert found["two-stage", "bart"].finding == "reference"
    assert worst_finding(list(found.values()), "simultaneous") == "GAMED"
    assert worst_finding(list(found.values()), "two-stage") == "reference"


def test_a_driver_who_crashes_but_would_gain_by_going_on_does_not_game() -> None:
    crashing = sums(200.0, crashes=60)
    told = comparison(simultaneous_run0=crashing, simultaneous_run1=crashing)
    assert worst_finding(gaming_of(told), "simultaneous") == "crashes more"


def test_the_worth_of_a_step_is_in_the_reward_that_is_learned_from() -> None:
    # the driver's own terms are worth less than nothing, alerts make up for it
    crashing = sums(-200.0, crashes=60, alert=500.0 * 100)
    changed = {"simultaneous_run0": crashing, "simultaneous_run1": crashing}
    assert worst_finding(gaming_of(comparison(**changed)), "simultaneous") == "crashes more"
    individual = comparison(replace(SETTINGS, reward="individual"), **changed)
    assert worst_finding(gaming_of(individual), "simultaneous") == "GAMED"


def test_the_standing_run_is_told_in_both_settings() -> None:
    told = comparison()
    name = "simultaneous-run0-standing"
    told.played[Pair(name, name)]["bart"] = sums(crashes=10)  # type: ignore[index]
    told.played[Pair(name, name, end_at_crash=False)]["bart"] = sums(-50.0, crashes=20)  # type: ignore[index]
    row = next(r for r in gaming_of(told) if (r.protocol, r.driver) == ("simultaneous", "bart"))
    assert row.crash_rate_if_trained_standing.mean == 0.1
    assert row.crash_rate_standing.mean == 0.2
    assert row.team_return_standing == -50.0
    unchecked = gaming_of(comparison(replace(SETTINGS, crash_check=False)))
    assert all(math.isnan(row.crash_rate_standing.mean) for row in unchecked)


def test_without_two_stage_nothing_is_found() -> None:
    told = gaming_of(comparison(replace(SETTINGS, protocols=("simultaneous",))))
    assert {row.finding for row in told} == {"unknown"}
