"""The exact optimum with graded alerts and fatigue, against brute force written from the rules."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from standing_world import standing_teams

from hmi_marl.envs.alerts import Alerts, Fatigue
from hmi_marl.envs.drivers import DRIVERS, Driver
from hmi_marl.envs.rewards import RewardWeights
from hmi_marl.exact import oracle

GRADES = (0.25, 0.5, 1.0)
WEARY = Fatigue(levels=4, per_alert=3, effect=0.8)


def one_step(driver, window, strengths, fatigue, state, alert):
    """(i', c', f') and p(d' = 1), in plain code from the rules."""
    d, i, c, f = state
    beta, alpha, eta = driver.traits[:3]
    i, c = (i, c + 1) if i > alert and c < window - 1 else (alert, 0)
    helped = eta * strengths[i - 1] if i else 0.0
    if fatigue:
        helped *= 1 - fatigue.effect * f / fatigue.levels
        rise = math.ceil(fatigue.per_alert * strengths[alert - 1] - 1e-9) if alert else -1
        f = min(fatigue.levels, max(0, f + rise))
    p = 1 - min(1.0, alpha + helped) if d else max(0.0, beta - helped)
    return (i, c, f), p


def earned(d, new_d, alert, strengths):
    """(distraction, all three terms) of one step."""
    s = strengths[alert - 1] if alert else 0.0
    lost = -10.0 * new_d
    return lost, lost + (0 if d else 10 * (1 - s)) + (30 if alert and d and not new_d else 0)


def expectimax(driver, window, horizon, strengths, fatigue):
    """(best total, least distraction, most distraction) over the whole tree of histories.

    In every history of alerts and distraction the choice is free, so this is the best of all
    policies, those with a memory included. Nothing is shared between histories.
    """

    def worth(t, state):
        if t == horizon:
            return 0.0, 0.0, 0.0
        totals, least, most = [], [], []
        for alert in range(len(strengths) + 1):
            known, p = one_step(driver, window, strengths, fatigue, state, alert)
            total = low = high = 0.0
            for new_d, chance in ((0, 1 - p), (1, p)):
                lost, gain = earned(state[0], new_d, alert, strengths)
                later = worth(t + 1, (new_d, *known))
                total += chance * (gain + later[0])
                low += chance * (lost + later[1])
                high += chance * (lost + later[2])
            totals.append(total)
            least.append(low)
            most.append(high)
        return max(totals), min(least), max(most)

    return worth(0, (0, 0, 0, 0))


def drawn(seed):
    """A random driver, window, strengths and fatigue."""
    rng = np.random.default_rng(seed)
    driver = Driver("any", *rng.random(3).tolist(), 1.0)
    strengths = tuple(sorted(rng.choice(np.arange(1, 21) / 20, rng.integers(1, 4), replace=False)))
    fatigue = Fatigue(int(rng.integers(1, 6)), int(rng.integers(1, 5)), float(rng.random()))
    return driver, int(rng.integers(1, 5)), strengths, [fatigue, None][seed % 3 == 0]


@pytest.mark.parametrize("seed", range(12))
def test_the_optimum_equals_expectimax_over_all_histories(seed):
    driver, window, strengths, fatigue = drawn(seed)
    horizon = 5 if len(strengths) < 3 else 4
    total, least, most = expectimax(driver, window, horizon, strengths, fatigue)
    given = {"strengths": strengths, "fatigue": fatigue}
    solution = oracle.solve_alerts(driver, window, horizon, **given)
    assert solution.total_return == pytest.approx(total, abs=1e-9)
    assert solution.values[0].flat[0] == pytest.approx(total, abs=1e-9)
    reachable = oracle.reachable(driver, window, horizon, **given)
    assert reachable == pytest.approx((least, most), abs=1e-9)


def every_policy(horizon, choices):
    """Every deterministic policy: which alert for each history of d so far."""
    seen = [h for length in range(horizon) for h in itertools.product((0, 1), repeat=length)]
    for alerts in itertools.product(range(choices), repeat=len(seen)):
        yield dict(zip(seen, alerts, strict=True))


@pytest.mark.parametrize("fatigue", [None, WEARY], ids=["fresh", "weary"])
@pytest.mark.parametrize("name", ["bart", "homer", "average"])
def test_the_optimum_equals_the_best_of_all_policies_one_by_one(name, fatigue):
    driver, window, horizon, strengths = DRIVERS[name], 2, 3, (0.4, 1.0)
    totals, distractions = [], []
    for policy in every_policy(horizon, len(strengths) + 1):
        total = distraction = 0.0
        for history in itertools.product((0, 1), repeat=horizon):
            chance, gain, lost, state = 1.0, 0.0, 0.0, (0, 0, 0, 0)
            for t, new_d in enumerate(history):
                alert = policy[history[:t]]
                known, p = one_step(driver, window, strengths, fatigue, state, alert)
                chance *= p if new_d else 1 - p
                of_step = earned(state[0], new_d, alert, strengths)
                lost, gain = lost + of_step[0], gain + of_step[1]
                state = (new_d, *known)
            total += chance * gain
            distraction += chance * lost
        totals.append(total)
        distractions.append(distraction)
    assert len(totals) == 3**7
    given = {"strengths": strengths, "fatigue": fatigue}
    best = oracle.solve_alerts(driver, window, horizon, **given)
    assert best.total_return == pytest.approx(max(totals), abs=1e-9)
    least, most = oracle.reachable(driver, window, horizon, **given)
    assert (least, most) == pytest.approx((min(distractions), max(distractions)), abs=1e-9)


def test_one_step_by_hand():
    # β 0.8, α 0.2, η 1. Attentive: silence earns 10 - 10 * 0.8 = 2, strength 0.5 earns
    # 5 - 10 * 0.3 = 2, strength 0.75 earns 2.5 - 10 * 0.05 = 2, and 0.8 would earn 2 - 0 = 2.
    # Where all are as good, silence it is. Two steps: what is in effect also serves the second.
    one = oracle.solve_alerts("homer", 7, 1, strengths=(0.5, 0.75))
    assert one.total_return == pytest.approx(2.0)
    assert one.policy[0, 0, 0, 0] == 0
    # Distracted: strength 0.5 brings them back with 0.7, 0.7 * 30 - 0.3 * 10 = 18; 0.75 with 0.95,
    # 28; silence with 0.2, -8.
    assert one.policy[0, 1, 0, 0] == 2
    assert one.values[0, 1, 0, 0] == pytest.approx(28.0)


def test_two_steps_by_hand():
    # Strength 0.8 keeps Homer attentive for sure and costs 8 of the 10 for silence, once: two
    # steps earn 2 + 10. Silence, then as in one step: 2 and, if not distracted (0.2), 2, if
    # distracted (0.8), an alert that brings them back for sure, 30: 2 + 0.2 * 2 + 0.8 * 30 = 26.4.
    two = oracle.solve_alerts("homer", 7, 2, strengths=(0.8,))
    assert two.values[0, 0, 0, 0] == pytest.approx(26.4)
    # Without anything for an accepted alert, keeping them attentive is best.
    weights = RewardWeights(accept_alert=0.0)
    kept = oracle.solve_alerts("homer", 7, 2, weights, strengths=(0.8,))
    assert kept.total_return == pytest.approx(12.0)
    assert kept.policy[:, 0, [0, 1], 0].tolist() == [[1, 0], [0, 0]]
    assert kept.alerts == pytest.approx(1.0)


def test_fatigue_by_hand():
    # Marge (β 0.2, α 0.8, η 1), alerted twice in a row, level 4 of 4 after the first: the second
    # helps by 1 - 0.8 of η. Nobody is distracted after the first, 0.2 - 0.2 = 0 after the second.
    tired = Fatigue(levels=4, per_alert=4, effect=0.8)
    always = oracle.evaluate(1.0, "marge", 1, 2, fatigue=tired)
    assert always.rewards["distraction"].tolist() == pytest.approx([0.0, 0.0])
    # With effect 0.9 only 0.1 of η is left: distracted with 0.1, which costs 1.
    worn = Fatigue(levels=4, per_alert=4, effect=0.9)
    assert oracle.evaluate(1.0, "marge", 1, 2, fatigue=worn).rewards["distraction"].tolist() == (
        pytest.approx([0.0, -1.0])
    )


def test_the_shapes_are_those_of_the_states():
    graded = oracle.solve_alerts("homer", 7, 30, strengths=GRADES)
    assert graded.policy.shape == (30, 2, 4, 7)
    assert graded.values.shape == (31, 2, 4, 7)
    assert graded.rate_by_strength.shape == (3, 30)
    np.testing.assert_allclose(graded.rate_by_strength.sum(axis=0), graded.alert_rate)
    weary = oracle.solve_alerts("homer", 7, 30, strengths=GRADES, fatigue=WEARY)
    assert weary.policy.shape == (30, 2, 4, 7, 5)
    assert weary.alert_probability.shape == (3, 30, 2, 4, 7, 5)
    for solution, fatigue in ((graded, None), (weary, WEARY)):
        assert set(np.unique(solution.policy)) <= {0, 1, 2, 3}
        assert (solution.alert_probability.sum(axis=0) == (solution.policy > 0)).all()
        returns = oracle.evaluate(
            solution.alert_probability, "homer", 7, 30, strengths=GRADES, fatigue=fatigue
        )
        assert returns.total_return == pytest.approx(solution.total_return, abs=1e-9)


traits = st.floats(0, 1)
sets = st.sets(st.sampled_from([k / 10 for k in range(1, 11)]), min_size=1, max_size=4)
fatigues = st.builds(Fatigue, st.integers(1, 6), st.integers(1, 6), st.floats(0, 1))


@settings(max_examples=40, deadline=None)
@given(traits, traits, traits, st.integers(1, 4), st.integers(1, 20), sets, sets, fatigues)
def test_more_strengths_to_choose_from_never_harm(
    beta, alpha, eta, window, horizon, some, more, fatigue
):
    driver = Driver("any", beta, alpha, eta, 1.0)
    few, many = tuple(sorted(some)), tuple(sorted(some | more))
    for weariness in (None, fatigue):
        fewer = oracle.solve_alerts(driver, window, horizon, strengths=few, fatigue=weariness)
        richer = oracle.solve_alerts(driver, window, horizon, strengths=many, fatigue=weariness)
        assert richer.total_return >= fewer.total_return - 1e-9
        silence = oracle.evaluate(0.0, driver, window, horizon, strengths=few, fatigue=weariness)
        assert fewer.total_return >= silence.total_return - 1e-9


@settings(max_examples=30, deadline=None)
@given(traits, traits, traits, st.integers(1, 4), st.integers(1, 20), sets, fatigues)
def test_fatigue_without_effect_is_none(beta, alpha, eta, window, horizon, strengths, fatigue):
    driver, strengths = Driver("any", beta, alpha, eta, 1.0), tuple(sorted(strengths))
    harmless = Fatigue(fatigue.levels, fatigue.per_alert, effect=0.0)
    fresh = oracle.solve_alerts(driver, window, horizon, strengths=strengths)
    weary = oracle.solve_alerts(driver, window, horizon, strengths=strengths, fatigue=harmless)
    assert weary.total_return == pytest.approx(fresh.total_return, abs=1e-9)
    for level in range(harmless.levels + 1):
        np.testing.assert_allclose(weary.values[..., level], fresh.values, atol=1e-9)


@settings(max_examples=30, deadline=None)
@given(traits, traits, traits, st.integers(1, 5), st.integers(1, 20), sets, fatigues, st.integers())
def test_no_policy_beats_the_optimum_or_leaves_the_reachable_range(
    beta, alpha, eta, window, horizon, strengths, fatigue, seed
):
    driver, strengths = Driver("any", beta, alpha, eta, 1.0), tuple(sorted(strengths))
    given = {"strengths": strengths, "fatigue": fatigue}
    shape = Alerts(**given).shape(window)
    rng = np.random.default_rng(abs(seed))
    policy = rng.dirichlet(np.ones(len(strengths) + 1), (horizon, *shape))[..., 1:]
    returns = oracle.evaluate(np.moveaxis(policy, -1, 0), driver, window, horizon, **given)
    best = oracle.solve_alerts(driver, window, horizon, **given)
    assert returns.total_return <= best.total_return + 1e-9
    least, most = oracle.reachable(driver, window, horizon, **given)
    assert least - 1e-9 <= returns.distraction_return <= most + 1e-9
    assert 0 <= returns.alerts <= horizon


@pytest.mark.parametrize("name", DRIVERS)
def test_one_strength_of_1_is_the_paper(name):
    paper = oracle.solve_alerts(name, 7, 60)
    one = oracle.solve_alerts(name, 7, 60, strengths=(1.0,), fatigue=None)
    assert one.policy.shape == (60, 2, 2, 7)
    np.testing.assert_array_equal(one.policy, paper.policy)
    np.testing.assert_array_equal(one.values, paper.values)
    np.testing.assert_array_equal(one.alert_probability, one.policy)


@pytest.mark.parametrize(
    ("strengths", "fatigue"),
    [(GRADES, None), (GRADES, Fatigue()), ((1.0,), WEARY), ((0.3,), None)],
    ids=str,
)
@pytest.mark.parametrize("name", ["bart", "homer", "average"])
def test_simulated_returns_are_within_4_standard_errors_of_the_exact_ones(name, strengths, fatigue):
    count, horizon = 20_000, 50
    given = {"strengths": strengths, "fatigue": fatigue}
    alerts = Alerts(**given)
    rng = np.random.default_rng(1)
    # A random policy, so that every state comes about.
    chances = rng.dirichlet(np.ones(alerts.choices), (horizon, *alerts.shape(7)))
    exact = oracle.evaluate(np.moveaxis(chances[..., 1:], -1, 0), name, 7, horizon, **given)
    teams = standing_teams(
        count, driver=name, duration=10.0, alert_strengths=strengths, fatigue=fatigue
    )
    teams.reset(np.arange(count, dtype=np.uint64))
    total, distraction, given_alerts = np.zeros((3, count))
    for t in range(horizon):
        now = teams.attention
        state = [now.distracted, now.accepted, now.counter] + [now.fatigue] * bool(fatigue)
        below = np.cumsum(chances[t][tuple(state)], axis=1)[:, :-1]
        alert = (rng.random(count)[:, None] >= below).sum(axis=1)
        teams.intend(np.ones(count, np.int64))
        terms = teams.step(alert).terms
        distraction += terms["distraction"]
        total += terms["distraction"] + terms["alert"] + terms["accept_alert"]
        given_alerts += alert > 0
    for simulated, expected in (
        (total, exact.total_return),
        (distraction, exact.distraction_return),
        (given_alerts, exact.alerts),
    ):
        error = simulated.std(ddof=1) / np.sqrt(count)
        assert abs(simulated.mean() - expected) <= 4 * error


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: oracle.solve_alerts("lisa", strengths=(1.0, 0.5)), "alert_strengths rise"),
        (lambda: oracle.reachable("lisa", strengths=()), "alert_strengths rise"),
        (lambda: oracle.evaluate(0.5, "lisa", strengths=GRADES), "add up to more than 1"),
        (lambda: oracle.evaluate(np.zeros((3, 9, 9)), "lisa", strengths=GRADES), "its shape"),
        (
            lambda: oracle.evaluate(np.zeros((2, 2, 7)), "lisa", fatigue=WEARY),
            r"\(alerts, horizon, 2, alerts \+ 1, window, levels \+ 1\) = \(1, 100, 2, 2, 7, 5\)",
        ),
        (
            lambda: oracle.evaluate(
                oracle.solve_alerts("homer", strengths=GRADES).policy, "homer", strengths=GRADES
            ),
            r"its shape is|\[0, 1\]",
        ),
    ],
)
def test_bad_questions_are_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()
