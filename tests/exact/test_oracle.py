import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from standing_world import standing_teams

from hmi_marl.envs import attention
from hmi_marl.envs.attention import Attention
from hmi_marl.envs.drivers import DRIVERS, PAPER_DRIVERS, Driver, Traits
from hmi_marl.envs.rewards import RewardWeights, attention_terms
from hmi_marl.envs.streams import Stream, uniform
from hmi_marl.exact import oracle
from hmi_marl.exact.hidden_attention import solve_belief

WHEN_DISTRACTED = np.arange(2.0).reshape(1, 2, 1, 1)


def histories(horizon):
    """Every sequence of d_1 .. d_T."""
    return itertools.product((0, 1), repeat=horizon)


def brute_force(driver, window, horizon):
    """Attention return of every deterministic alert policy, from the paper's rules in plain code.

    A policy says for each history of d so far whether to alert; i and c follow from its alerts.
    """
    beta, alpha, eta = driver.traits[:3]
    seen = [h for length in range(horizon) for h in itertools.product((0, 1), repeat=length)]
    for choices in itertools.product((0, 1), repeat=len(seen)):
        policy = dict(zip(seen, choices, strict=True))
        total = distraction = 0.0
        for history in histories(horizon):
            probability, gain, lost, d, i, c = 1.0, 0.0, 0.0, 0, 0, 0
            for t, new_d in enumerate(history):
                alert = policy[history[:t]]
                if alert:
                    i, c = 1, 0
                elif i:
                    i, c = int(c < window - 1), (c + 1) % window
                p = max(0, beta - eta * i) if d == 0 else 1 - min(1, alpha + eta * i)
                probability *= p if new_d else 1 - p
                lost += -10 * new_d
                gain += 10 * (not alert and d == 0) + 30 * (alert and d == 1 and new_d == 0)
                d = new_d
            total += probability * (gain + lost)
            distraction += probability * lost
        yield total, distraction


@pytest.mark.parametrize("window", [1, 2, 3])
@pytest.mark.parametrize("name", ["lisa", "bart", "homer", "average"])
def test_the_optimum_equals_brute_force_over_all_policies(name, window):
    driver, horizon = DRIVERS[name], 3
    totals, distractions = zip(*brute_force(driver, window, horizon), strict=True)
    solution = oracle.solve_alerts(driver, window, horizon)
    assert solution.total_return == pytest.approx(max(totals), abs=1e-9)
    assert solution.values[0, 0, 0, 0] == pytest.approx(max(totals), abs=1e-9)
    least, most = oracle.reachable(driver, window, horizon)
    by_steps = oracle.reachable_by_steps(driver, window, horizon + 3)
    assert by_steps[horizon].tolist() == [least, most]
    assert by_steps[0].tolist() == [0.0, 0.0]
    assert least == pytest.approx(min(distractions), abs=1e-9)
    assert most == pytest.approx(max(distractions), abs=1e-9)


@pytest.mark.parametrize("horizon", [94, 95, 100])
@pytest.mark.parametrize("name", DRIVERS)
def test_alerting_when_distracted_is_optimal(name, horizon):
    best = oracle.solve_alerts(name, window=7, horizon=horizon)
    plain = oracle.evaluate(WHEN_DISTRACTED, name, window=7, horizon=horizon)
    assert plain.total_return == pytest.approx(best.total_return, abs=1e-9)
    np.testing.assert_array_equal(best.policy, np.broadcast_to(WHEN_DISTRACTED, best.policy.shape))


def test_the_optimum_has_the_returns_that_the_paper_prints_where_it_can():
    marge = [oracle.solve_alerts("marge", 7, h).distraction_return for h in (94, 100)]
    homer = [oracle.solve_alerts("homer", 7, h).distraction_return for h in (94, 100)]
    assert [round(value) for value in marge] == [-80, -85]
    assert [round(value) for value in homer] == [-119, -126]
    assert round(oracle.reachable("lisa", 7, 95).most) in (-181, -180)
    assert round(oracle.reachable("bart", 7, 95).most) in (-751, -750)


def test_never_alerting_by_hand():
    # d is distracted with probability β from d = 0 and 1 - α from d = 1: for Lisa always 0.2.
    returns = oracle.evaluate(0.0, "lisa", 7, 50)
    assert returns.distraction_return == pytest.approx(-10 * 0.2 * 50)
    assert returns.alerts == 0
    # R_alert: +10 in the first step for sure, then whenever the last d was 0.
    assert returns.total_return == pytest.approx(-100 + 10 + 49 * 0.8 * 10)
    after = returns.return_after([0, 1, 50], ["distraction"])
    assert after.tolist() == pytest.approx([0, -2, -100])
    assert returns.return_after(1) == pytest.approx(-2 + 10)
    assert returns.return_after(50) == pytest.approx(returns.total_return)
    for steps in (-1, 51, [3, 60], 2.5):
        with pytest.raises(ValueError, match="whole numbers from 0 to 50"):
            returns.return_after(steps)


def test_values_and_flow_are_those_of_the_transition_matrix():
    driver, window, horizon = Driver("mona", 0.3, 0.45, 0.2, 2.0), 5, 30
    matrix = attention.transition_matrix(driver, window)
    solution = oracle.solve_alerts(driver, window, horizon)
    occupancy = np.zeros((2, 2, window))
    occupancy[0, 0, 0] = 1.0
    alert, before, now = np.indices((2, 2, 2))
    terms = attention_terms(RewardWeights(), alert=alert, distracted_before=before, distracted=now)
    reward = np.einsum("adicejk,ade->adic", matrix, sum(terms.values()))
    for t in range(horizon):
        choices = reward + np.einsum("adicejk,ejk->adic", matrix, solution.values[t + 1])
        np.testing.assert_allclose(solution.values[t], choices.max(axis=0), rtol=0, atol=1e-9)
        joint = np.stack([1.0 - solution.policy[t], solution.policy[t]]) * occupancy
        assert solution.alert_rate[t] == pytest.approx(joint[1].sum(), abs=1e-12)
        occupancy = np.einsum("adic,adicejk->ejk", joint, matrix)


def test_a_very_long_window_is_as_good_as_one_that_never_ends():
    long, longer = (oracle.solve_alerts("average", window, 100) for window in (100, 10_000))
    assert longer.total_return == pytest.approx(long.total_return, abs=1e-9)
    assert longer.policy.shape == (100, 2, 2, 10_000)


@pytest.mark.parametrize("rule", ["optimal", "when-distracted", 0.0, 1.0, 0.3], ids=str)
@pytest.mark.parametrize(
    "name",
    [
        "bart",
        *(pytest.param(name, marks=pytest.mark.slow) for name in PAPER_DRIVERS if name != "bart"),
    ],
)
def test_simulated_returns_are_within_4_standard_errors_of_the_exact_ones(name, rule):
    window, horizon, count = 7, 100, 20_000
    probability = {
        "optimal": oracle.solve_alerts(name, window, horizon).policy,
        "when-distracted": WHEN_DISTRACTED,
    }.get(rule, np.asarray(rule))
    table = np.broadcast_to(probability, (horizon, 2, 2, window))
    exact = oracle.evaluate(probability, name, window, horizon)
    teams = standing_teams(count, driver=name)
    teams.reset(np.arange(count, dtype=np.uint64))
    rng = np.random.default_rng(0)
    distraction, total, alerts = np.zeros((3, count))
    for t in range(horizon):
        now = teams.attention
        wanted = table[t, now.distracted, now.accepted, now.counter]
        alert = (rng.random(count) < wanted).astype(np.int64)
        teams.intend(np.ones(count, np.int64))
        terms = teams.step(alert).terms
        distraction += terms["distraction"]
        total += terms["distraction"] + terms["alert"] + terms["accept_alert"]
        alerts += alert
    for simulated, expected in (
        (distraction, exact.distraction_return),
        (total, exact.total_return),
        (alerts, exact.alerts),
    ):
        error = simulated.std(ddof=1) / np.sqrt(count)
        assert abs(simulated.mean() - expected) <= 4 * error + 1e-9


traits = st.floats(0, 1)


@settings(max_examples=40, deadline=None)
@given(traits, traits, traits, st.integers(1, 5), st.integers(1, 25), st.integers(0, 2**32 - 1))
def test_no_policy_beats_the_optimum_or_leaves_the_reachable_range(
    beta, alpha, eta, window, horizon, seed
):
    driver = Driver("any", beta, alpha, eta, 1.0)
    policy = np.random.default_rng(seed).random((horizon, 2, 2, window))
    returns = oracle.evaluate(policy, driver, window, horizon)
    assert returns.total_return <= oracle.solve_alerts(driver, window, horizon).total_return + 1e-9
    least, most = oracle.reachable(driver, window, horizon)
    assert least - 1e-9 <= returns.distraction_return <= most + 1e-9
    assert 0 <= returns.alerts <= horizon


def test_weights_change_the_optimum():
    # If accepted alerts earn nothing and silence is golden, alerting Lisa is never worth it.
    weights = RewardWeights(alert=1000.0, accept_alert=0.0)
    assert not oracle.solve_alerts("lisa", 7, 50, weights).policy[:, 0].any()
    free = oracle.solve_alerts("homer", 7, 50, RewardWeights(alert=0.0))
    assert free.alerts > oracle.solve_alerts("homer", 7, 50).alerts


def test_one_step_by_hand():
    solution = oracle.solve_alerts("homer", 7, 1)
    # From d = 0 silence earns 10 - 10 * 0.8 = 2, an alert 0 - 0; from d = 1 an alert earns 30.
    assert solution.total_return == pytest.approx(2.0)
    assert solution.policy[0, 0, 0, 0] == 0
    assert solution.policy[0, 1, 0, 0] == 1


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: oracle.solve_alerts("ned"), "unknown driver 'ned'"),
        (lambda: oracle.solve_alerts("lisa", window=0), "alert_window"),
        (lambda: oracle.solve_alerts("lisa", horizon=0), "horizon"),
        (lambda: oracle.evaluate(1.2, "lisa"), r"lies in \[0, 1\]"),
        (lambda: oracle.evaluate(np.nan, "lisa"), r"lies in \[0, 1\]"),
        (lambda: oracle.evaluate(np.zeros((5, 2)), "lisa"), "its shape is"),
        (lambda: oracle.evaluate(np.zeros(7), "lisa"), "its shape is"),
        (lambda: oracle.evaluate(np.zeros((2, 7)), "lisa"), "its shape is"),
        (lambda: oracle.evaluate(np.zeros((100, 2, 2, 1, 7)), "lisa"), "its shape is"),
        (lambda: oracle.reachable("lisa", horizon=-2), "horizon"),
        (lambda: oracle.solve_alerts("lisa", 10_000, 10**6), "more than 250000000; use a shorter"),
        (lambda: solve_belief("lisa", 10_000, 10**3, RewardWeights()), "use a shorter horizon"),
    ],
)
def test_bad_questions_are_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()
    with pytest.raises(TypeError, match="horizon"):
        oracle.solve_alerts("lisa", horizon=2.5)


@pytest.mark.slow
@pytest.mark.parametrize("name", DRIVERS)
def test_a_million_episodes_of_the_optimum(name):
    count, window, horizon = 1_000_000, 7, 100
    policy = oracle.solve_alerts(name, window, horizon).policy
    traits = Traits.from_array(np.tile(DRIVERS[name].traits, (count, 1)))
    now, seeds = Attention.initial(count), np.arange(count, dtype=np.uint64)
    distraction = np.zeros(count)
    for t in range(horizon):
        alert = policy[t, now.distracted, now.accepted, now.counter].astype(np.int64)
        after = attention.step(now, alert, traits, window, uniform(seeds, Stream.ATTENTION, t))
        distraction += attention_terms(
            RewardWeights(),
            alert=alert,
            distracted_before=now.distracted,
            distracted=after.distracted,
        )["distraction"]
        now = after
    exact = oracle.evaluate(policy, name, window, horizon).distraction_return
    assert abs(distraction.mean() - exact) <= 4 * distraction.std() / np.sqrt(count)
