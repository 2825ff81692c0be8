import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from standing_world import standing_teams

from hmi_marl.agents import BeliefAlert
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import DRIVERS, PAPER_DRIVERS, Driver
from hmi_marl.envs.rewards import RewardWeights
from hmi_marl.exact import oracle
from hmi_marl.exact.hidden_attention import locate, predict, rule_return, solve_belief

PAPER = RewardWeights()


def posterior(driver, accepted, intended, applied):
    """p(d_t = 1 | everything seen), by enumerating every hidden sequence d_0 .. d_t.

    The driving rule: v_0 = a^H_0, later v_t = v_{t-1} if d_t = 1, else a^H_t.
    """
    beta, alpha, eta = driver.traits[:3]
    weight = np.zeros(2)
    for hidden in itertools.product((0, 1), repeat=len(intended)):
        probability, d = 1.0, 0
        for t, new_d in enumerate(hidden):
            help_given = eta * accepted[t]
            p = max(0.0, beta - help_given) if d == 0 else 1 - min(1.0, alpha + help_given)
            probability *= p if new_d else 1 - p
            would_apply = applied[t - 1] if new_d and t > 0 else intended[t]
            probability *= would_apply == applied[t]
            d = new_d
        weight[d] += probability
    return weight[1] / weight.sum()


@pytest.mark.parametrize("name", PAPER_DRIVERS)
def test_the_filter_equals_the_posterior_over_all_hidden_sequences(name):
    config = TeamConfig(driver=name, duration=2.0, ai_sees_attention=False)
    for seed in range(12):
        teams = standing_teams(1, driver=name, duration=2.0, ai_sees_attention=False)
        hmi = BeliefAlert(name, config)
        seeds = np.array([seed], np.uint64)
        teams.reset(seeds)
        hmi.reset(seeds)
        rng = np.random.default_rng(seed)
        accepted, intended, applied = [], [], []
        for t in range(10):
            wants = int(rng.choice([1, 1, 3]))
            teams.intend([wants])
            alert = hmi.act(teams.observe("vehicle_ai"))
            if t:
                expected = posterior(DRIVERS[name], accepted, intended, applied)
                assert hmi.belief[0] == pytest.approx(expected, abs=1e-12)
            teams.step(alert)
            accepted.append(int(teams.attention.accepted[0]))
            intended.append(wants)
            applied.append(int(teams.applied[0]))


def test_predict_by_hand():
    bart = DRIVERS["bart"]
    assert predict(0.5, 0, bart) == pytest.approx(0.5 * 0.8 + 0.5 * 0.8)
    assert predict(0.25, 1, bart) == pytest.approx(0.25 * 0.79 + 0.75 * 0.79)


@pytest.mark.parametrize("name", DRIVERS)
def test_if_every_step_but_the_first_reveals_attention_is_seen_from_the_third_on(name):
    # The second alert is given without knowing d_0, so all four pairs of first alerts are tried;
    # from the third on the last d is always known, and the oracle's values hold.
    driver, window, horizon = DRIVERS[name], 7, 100
    values = oracle.solve_alerts(driver, window, horizon).values
    best = -np.inf
    for first, second in itertools.product((0, 1), repeat=2):
        p_0 = max(0.0, driver.beta - driver.eta * first)
        value = 10 * (not first) - 10 * p_0
        i, c = (1, 0) if second else (int(first), int(first))
        help_given = driver.eta * i
        recovers = min(1.0, driver.alpha + help_given)
        p_1 = p_0 * (1 - recovers) + (1 - p_0) * max(0.0, driver.beta - help_given)
        value += 30 * p_0 * recovers if second else 10 * (1 - p_0)
        value += -10 * p_1 + p_1 * values[2, 1, i, c] + (1 - p_1) * values[2, 0, i, c]
        best = max(best, value)
    solution = solve_belief(driver, window, horizon, PAPER, revealing=1.0)
    assert solution.total_return == pytest.approx(best, abs=1e-6)
    assert solution.total_return <= values[0, 0, 0, 0] + 1e-9


@pytest.mark.parametrize("name", ["bart", "homer", "lisa"])
def test_if_no_step_reveals_the_rule_is_the_best_fixed_sequence(name):
    driver, window, horizon = DRIVERS[name], 2, 8
    best = -np.inf
    for alerts in itertools.product((0, 1), repeat=horizon):
        value, b, i, c = 0.0, 0.0, 0, 0
        for alert in alerts:
            if alert:
                i, c = 1, 0
            elif i:
                i, c = int(c < window - 1), (c + 1) % window
            recovers = min(1.0, driver.alpha + driver.eta * i)
            value += 30 * b * recovers if alert else 10 * (1 - b)
            b = b * (1 - recovers) + (1 - b) * max(0.0, driver.beta - driver.eta * i)
            value -= 10 * b
        best = max(best, value)
    solution = solve_belief(driver, window, horizon, PAPER, revealing=0.0)
    assert solution.total_return == pytest.approx(best, abs=0.02)  # the grid's error


@pytest.mark.parametrize("sequential", [True, False])
@pytest.mark.parametrize("name", PAPER_DRIVERS)
def test_the_rule_earns_in_play_what_it_promises(name, sequential):
    count, horizon, revealing = 4000, 100, 0.3
    teams = standing_teams(count, driver=name, ai_sees_attention=False)
    hmi = BeliefAlert(name, teams.config, revealing, sequential=sequential)
    seeds = np.arange(count, dtype=np.uint64)
    teams.reset(seeds)
    hmi.reset(seeds)
    rng = np.random.default_rng(1)
    earned = np.zeros(count)
    for t in range(horizon):
        differs = (rng.random(count) < revealing) & (t > 0)
        last = np.maximum(teams.applied, 0)
        intended = np.where(differs, (last + 1) % 5, last)
        if not sequential:
            alert = hmi.act(teams.observe("vehicle_ai"))
        teams.intend(intended)
        if sequential:
            alert = hmi.act(teams.observe("vehicle_ai"))
        terms = teams.step(alert).terms
        earned += terms["distraction"] + terms["alert"] + terms["accept_alert"]
    promised = solve_belief(DRIVERS[name], 7, horizon, PAPER, revealing, sequential).total_return
    assert abs(earned.mean() - promised) < 4 * earned.std() / np.sqrt(count)


def test_knowing_the_driver_is_worth_what_the_exact_analysis_says():
    # Attention return with 70 % uninformative steps: Bart about -224, Lisa about 751.
    values = {
        name: solve_belief(DRIVERS[name], 7, 100, PAPER).total_return for name in PAPER_DRIVERS
    }
    assert values["bart"] == pytest.approx(-224, abs=3)
    assert values["lisa"] == pytest.approx(751, abs=3)


def test_seeing_the_intent_never_harms_and_is_worth_something_to_marge():
    for name in PAPER_DRIVERS:
        with_intent, without = (
            solve_belief(DRIVERS[name], 7, 100, PAPER, 0.3, sees).total_return
            for sees in (True, False)
        )
        assert with_intent >= without - 1e-9
        if name == "marge":
            assert with_intent > without + 1


def test_a_partial_reset_forgets_those_teams_alone():
    teams = standing_teams(2, driver="bart", ai_sees_attention=False)
    hmi = BeliefAlert("bart", teams.config)
    seeds = np.arange(2, dtype=np.uint64)
    teams.reset(seeds)
    hmi.reset(seeds)
    for _ in range(3):
        teams.intend([1, 1])
        teams.step(hmi.act(teams.observe("vehicle_ai")))
    assert np.all(hmi.belief > 0)
    kept = hmi.belief[0]
    hmi.reset(seeds, np.array([False, True]))
    assert hmi.belief.tolist() == [kept, 0.0]


def test_a_share_out_of_range_is_refused():
    with pytest.raises(ValueError, match="revealing"):
        solve_belief(DRIVERS["bart"], 7, 10, PAPER, revealing=1.5)


# What a rule earns with another driver.


def tree(rule, driver, t=0, d=0, i=0, c=0, b=0.0):
    """Expected return of a rule from step t on, by following every d and every kind of step."""
    if t == rule.horizon:
        return 0.0
    total, share = 0.0, rule.revealing if t > 0 else 0.0
    for reveals, chance in ((True, share), (False, 1.0 - share)):
        if chance == 0.0:
            continue
        arguments = (np.array([x]) for x in (t, reveals, b, i, c))
        alert = int(rule.alert(*arguments)[0])
        if alert:
            now = 1, 0
        elif i:
            now = int(c < rule.window - 1), (c + 1) % rule.window
        else:
            now = 0, 0
        eta = driver.eta * now[0]
        p = 1.0 - min(1.0, driver.alpha + eta) if d else max(0.0, driver.beta - eta)
        mine = rule.driver.eta * now[0]
        stays, becomes = 1.0 - min(1.0, rule.driver.alpha + mine), max(0.0, rule.driver.beta - mine)
        for new, weight in ((1, p), (0, 1.0 - p)):
            if weight == 0.0:
                continue
            reward = -10.0 * new
            if alert:
                reward += 30.0 * (d == 1 and new == 0)
            else:
                reward += 10.0 * (d == 0)
            assumed = float(new) if reveals else b * stays + (1.0 - b) * becomes
            total += chance * weight * (reward + tree(rule, driver, t + 1, new, *now, assumed))
    return total


unit = st.floats(0, 1)
anybody = st.builds(Driver, st.just("any"), unit, unit, unit, st.just(1.0))


@settings(max_examples=25)
@given(model=anybody, driver=anybody, revealing=st.sampled_from([0.0, 0.3, 1.0]))
def test_what_a_rule_earns_is_that_of_all_that_can_happen(model, driver, revealing):
    rule = solve_belief(model, 2, 5, PAPER, revealing)
    assert rule_return(rule, driver, PAPER) == pytest.approx(tree(rule, driver), abs=1e-9)


@pytest.mark.parametrize("revealing", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("name", DRIVERS)
def test_with_the_driver_that_it_assumes_a_rule_earns_what_it_promises(name, revealing):
    rule = solve_belief(DRIVERS[name], 7, 40, PAPER, revealing)
    assert rule_return(rule, name, PAPER) == pytest.approx(rule.total_return, abs=1e-9)


@settings(max_examples=15)
@given(driver=anybody, revealing=st.sampled_from([0.1, 0.5]))
def test_a_promise_is_kept_but_for_the_grid_and_no_other_rule_earns_more(driver, revealing):
    # between grid points values are taken too high, since they are convex in the belief: mostly by
    # less than 0.05, by 0.14 where the two actions are nearly worth the same over a whole stretch
    rule = solve_belief(driver, 3, 15, PAPER, revealing)
    own = rule_return(rule, driver, PAPER)
    assert rule.total_return - 0.5 < own <= rule.total_return + 1e-9
    other = solve_belief(DRIVERS["average"], 3, 15, PAPER, revealing)
    assert rule_return(other, driver, PAPER) <= rule.total_return + 1e-9


def test_other_rewards_and_names_are_taken():
    rule = solve_belief(DRIVERS["bart"], 3, 10, PAPER)
    free = RewardWeights(distraction=0.0, alert=0.0, accept_alert=0.0)
    assert rule_return(rule, "lisa", free) == 0.0
    only = RewardWeights(distraction=-1.0, alert=0.0, accept_alert=0.0)
    never_distracted = Driver("never", 0.0, 1.0, 0.0, 1.0)
    assert rule_return(rule, never_distracted, only) == 0.0
    always = Driver("always", 1.0, 0.0, 0.0, 1.0)
    assert rule_return(rule, always, only) == pytest.approx(-10.0)


def test_it_is_what_the_rule_earns_in_play():
    count, horizon, revealing = 3000, 60, 0.3
    teams = standing_teams(count, driver="lisa", ai_sees_attention=False, duration=12.0)
    hmi = BeliefAlert("bart", teams.config, revealing)
    seeds = np.arange(count, dtype=np.uint64)
    for each in (teams, hmi):
        each.reset(seeds)
    rng, earned = np.random.default_rng(2), np.zeros(count)
    for t in range(horizon):
        last = np.maximum(teams.applied, 0)
        differs = (rng.random(count) < revealing) & (t > 0)
        teams.intend(np.where(differs, (last + 1) % 5, last))
        terms = teams.step(hmi.act(teams.observe("vehicle_ai"))).terms
        earned += terms["distraction"] + terms["alert"] + terms["accept_alert"]
    rule = solve_belief(DRIVERS["bart"], 7, horizon, PAPER, revealing)
    expected = rule_return(rule, "lisa", PAPER)
    assert abs(earned.mean() - expected) < 4 * earned.std() / np.sqrt(count)
    own = solve_belief(DRIVERS["lisa"], 7, horizon, PAPER, revealing).total_return
    assert expected < own - 20, "bart's rule is not lisa's"


def test_values_between_grid_points_are_those_of_a_line():
    low, fraction = locate(np.array([0.0, 0.005, 0.0062, 0.5, 1.0]))
    assert low.tolist() == [0, 1, 1, 100, 199]
    np.testing.assert_allclose(fraction, [0.0, 0.0, 0.24, 0.0, 1.0], atol=1e-9)


# Alerts that others gave.


def test_it_goes_by_the_alerts_that_were_given():
    teams = standing_teams(2, driver="bart", ai_sees_attention=False)
    hmi = BeliefAlert("homer", teams.config)
    seeds = np.arange(2, dtype=np.uint64)
    for each in (teams, hmi):
        each.reset(seeds)
    for t in range(12):
        teams.intend([1, 1])
        hmi.act(teams.observe("vehicle_ai"))
        if t:
            # nothing shows d: the belief is predicted along the alerts of whoever gave them
            assert hmi.belief[0] == pytest.approx(0.8), "no help at all"
            assert hmi.belief[1] == 0.0, "homer is always helped"
        teams.step([0, 1])


def test_being_asked_twice_in_a_turn_changes_nothing():
    teams = standing_teams(3, driver="bart", ai_sees_attention=False)
    once, twice = (BeliefAlert("bart", teams.config) for _ in range(2))
    seeds = np.arange(3, dtype=np.uint64)
    for each in (teams, once, twice):
        each.reset(seeds)
    rng = np.random.default_rng(0)
    for _ in range(30):
        teams.intend(rng.integers(0, 5, 3))
        seen = teams.observe("vehicle_ai")
        alerts = once.act(seen)
        for _ in range(2):
            np.testing.assert_array_equal(twice.act(seen), alerts)
        teams.step(alerts)
    np.testing.assert_array_equal(twice.belief, once.belief)
