"""Worth of knowing the driver against brute force that is written from the paper's equations."""

from functools import cache

import numpy as np
import pytest

from hmi_marl.envs.drivers import DRIVERS, PAPER_DRIVERS, Driver
from hmi_marl.envs.rewards import RewardWeights
from hmi_marl.exact import driver_worth, oracle
from hmi_marl.exact.driver_worth import Problem, hidden_returns, seen_returns
from hmi_marl.exact.hidden_attention import rule_return, solve_belief

BONUS_FREE = RewardWeights(accept_alert=0.0)


class BruteForce:
    """One driver's alert problem, by recursion over everything that can happen.

    Nothing of the package is used. d, i and c follow the paper's equations; rewards its table.
    """

    def __init__(self, traits, window, horizon, weights, share=0.0):
        self.beta, self.alpha, self.eta = traits
        self.window, self.horizon, self.share = window, horizon, share
        self.cost, self.silence, self.bonus = (
            -weights.distraction,
            weights.alert,
            weights.accept_alert,
        )

    def next(self, i, c, alert):
        if alert:
            return 1, 0
        if i == 1 and c < self.window - 1:
            return 1, c + 1
        return 0, 0

    def distracted(self, d, i):
        """p(d_t = 1 | d_{t-1} = d, i_t = i)."""
        help_given = self.eta if i else 0.0
        if d:
            return 1.0 - min(1.0, self.alpha + help_given)
        return max(0.0, self.beta - help_given)

    def reward(self, alert, before, now):
        silence = self.silence if before == 0 and not alert else 0.0
        bonus = self.bonus if alert and before == 1 and now == 0 else 0.0
        return silence + bonus - (self.cost if now else 0.0)

    def seen(self, choices):
        """Best expected return if ``choices(t, d, i, c)`` lists the alerts that may be given."""

        @cache
        def value(t, d, i, c):
            if t == self.horizon:
                return 0.0
            return max(action(a, t, d, i, c) for a in choices(t, d, i, c))

        def action(a, t, d, i, c):
            i, c = self.next(i, c, a)
            p = self.distracted(d, i)
            after = [self.reward(a, d, now) + value(t + 1, now, i, c) for now in (0, 1)]
            return (1 - p) * after[0] + p * after[1]

        self.action = action
        return value(0, 0, 0, 0)

    def best_alert(self, t, d, i, c):
        """Alert of the best rule, once ``seen``; silence where both are as good."""
        return int(self.action(1, t, d, i, c) > self.action(0, t, d, i, c) + 1e-12)

    def predict(self, b, i):
        return b * self.distracted(1, i) + (1 - b) * self.distracted(0, i)

    def expected_reward(self, b, i, alert):
        total = 0.0
        for before, weight in ((0, 1 - b), (1, b)):
            p = self.distracted(before, i)
            total += weight * (1 - p) * self.reward(alert, before, 0)
            total += weight * p * self.reward(alert, before, 1)
        return total

    def shares(self, t):
        share = self.share if t else 0.0
        return ((0, 1 - share), (1, share))

    def hidden(self):
        """Best expected return of a rule that sees d in revealing steps alone."""

        @cache
        def value(t, b, i, c):
            if t == self.horizon:
                return 0.0
            return sum(
                weight * max(choice(a, t, shows, b, i, c) for a in (0, 1))
                for shows, weight in self.shares(t)
                if weight
            )

        def choice(a, t, shows, b, i, c):
            i, c = self.next(i, c, a)
            after, reward = self.predict(b, i), self.expected_reward(b, i, a)
            if not shows:
                return reward + value(t + 1, after, i, c)
            return reward + after * value(t + 1, 1.0, i, c) + (1 - after) * value(t + 1, 0.0, i, c)

        self.choice = choice
        return value(0, 0.0, 0, 0)

    def follow(self, other):
        """Expected return with the best rule of ``other``, on the belief of ``other``."""
        other.hidden()

        @cache
        def value(t, assumed, b, i, c):
            if t == self.horizon:
                return 0.0
            total = 0.0
            for shows, weight in self.shares(t):
                if not weight:
                    continue
                here = t, shows, assumed, i, c
                a = int(other.choice(1, *here) > other.choice(0, *here) + 1e-9)
                next_i, next_c = self.next(i, c, a)
                after = self.predict(b, next_i)
                total += weight * self.expected_reward(b, next_i, a)
                if shows:
                    for d, chance in ((0, 1 - after), (1, after)):
                        total += weight * chance * value(t + 1, float(d), float(d), next_i, next_c)
                else:
                    belief = other.predict(assumed, next_i)
                    total += weight * value(t + 1, belief, after, next_i, next_c)
            return total

        return value(0, 0.0, 0.0, 0, 0)


def random_points(count, seed, longest):
    """Random drivers, windows, horizons, weights, shares and assumed drivers."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        own, assumed = rng.random((2, 3)).tolist()
        weights = RewardWeights(
            distraction=-float(rng.uniform(0, 40)),
            alert=float(rng.uniform(0, 40)),
            accept_alert=float(rng.choice([0.0, rng.uniform(0, 60)])),
        )
        problem = Problem(int(rng.integers(1, 6)), int(rng.integers(1, longest + 1)), weights)
        share = float(rng.choice([0.0, rng.random(), rng.random(), 1.0]))
        yield own, assumed, problem, share


def brute(traits, problem, share=0.0):
    return BruteForce(traits, problem.window, problem.horizon, problem.weights, share)


def driver(traits):
    return Driver("assumed", *traits, inflation=1.0)


def test_with_attention_seen_50_random_points_agree_with_brute_force():
    differ = 0
    for own, assumed, problem, _ in random_points(50, seed=1, longest=10):
        force, other = brute(own, problem), brute(assumed, problem)
        other.seen(lambda *_: (0, 1))
        expected = {
            "optimum": force.seen(lambda *_: (0, 1)),
            "when_distracted": force.seen(lambda t, d, i, c: (d,)),
            "average": force.seen(lambda *state, rule=other.best_alert: (rule(*state),)),
            "never": force.seen(lambda *_: (0,)),
            "no_prevention": force.seen(lambda t, d, i, c: (0, 1) if d else (0,)),
            "always_when_distracted": force.seen(lambda t, d, i, c: (1,) if d else (0, 1)),
        }
        found = seen_returns([own], problem, driver(assumed))
        for name, value in expected.items():
            assert getattr(found, name)[0] == pytest.approx(value, abs=1e-9), (name, own, problem)
        differ += expected["optimum"] > expected["average"] + 1e-6
    assert differ > 5, "the points should include some for which the driver matters"


def test_with_attention_hidden_50_random_points_agree_with_brute_force():
    differ = 0
    for own, assumed, problem, share in random_points(50, seed=2, longest=7):
        force = brute(own, problem, share)
        best, followed = force.hidden(), force.follow(brute(assumed, problem, share))
        found = hidden_returns([own], problem, share, driver(assumed))
        assert found.own[0] == pytest.approx(best, abs=1e-9), (own, problem, share)
        assert found.average[0] == pytest.approx(followed, abs=1e-9), (own, problem, share)
        differ += best > followed + 1e-6
    assert differ > 5


def test_over_a_whole_episode_the_oracle_agrees():
    rng = np.random.default_rng(3)
    traits = rng.random((8, 3))
    problem = Problem(window=5, horizon=100, weights=RewardWeights(distraction=-25.0))
    found = seen_returns(traits, problem, "lisa")
    for k, own in enumerate(traits):
        given = driver(own.tolist()), 5, 100, problem.weights
        best = oracle.solve_alerts("lisa", *given[1:]).alert_probability
        assert found.optimum[k] == pytest.approx(oracle.solve_alerts(*given).total_return)
        assert found.average[k] == pytest.approx(oracle.evaluate(best, *given).total_return)


def test_over_a_whole_episode_the_grid_of_beliefs_brackets_the_exact_value():
    # Between grid points a convex value lies below the line, so that the grid promises too much;
    # the rule that it gives earns at most the optimum.
    names = ["lisa", "bart"]
    problem = Problem()
    found = hidden_returns([DRIVERS[name].traits[:3] for name in names], problem, 0.35)
    average = solve_belief("average", 7, 100, problem.weights, 0.35)
    for k, name in enumerate(names):
        own = solve_belief(name, 7, 100, problem.weights, 0.35)
        earned = rule_return(own, name, problem.weights)
        assert earned - 1e-6 <= found.own[k] <= own.total_return + 1e-6
        assert own.total_return - earned < 0.01
        followed = rule_return(average, name, problem.weights)
        assert found.average[k] == pytest.approx(followed, abs=0.01)


def test_what_knowing_the_papers_drivers_is_worth_at_35_percent_revealing_steps():
    traits = [DRIVERS[name].traits[:3] for name in (*PAPER_DRIVERS, "average")]
    found = hidden_returns(traits, Problem(), 0.35)
    assert (found.own - found.average).round(1).tolist() == [22.4, 7.0, 177.7, 0.0, 0.0]
    seen = seen_returns(traits, Problem())
    np.testing.assert_allclose(seen.when_distracted, seen.optimum, atol=1e-9)
    np.testing.assert_allclose(seen.average, seen.optimum, atol=1e-9)


def test_if_alerts_neither_help_nor_pay_none_is_worth_anything():
    # η = 0 and no bonus: an alert can only cost. When distracted it costs nothing either.
    traits = [[0.3, 0.2, 0.0], [0.8, 0.0, 0.0], [1.0, 1.0, 0.0]]
    problem = Problem(weights=BONUS_FREE)
    seen = seen_returns(traits, problem)
    np.testing.assert_allclose(seen.optimum, seen.never, atol=1e-9)
    np.testing.assert_allclose(seen.optimum, seen.when_distracted, atol=1e-9)
    hidden = hidden_returns(traits, problem, 0.35)
    np.testing.assert_allclose(hidden.own, seen.never, atol=1e-9)
    # With the paper's bonus an alert pays though it does not help: 30 α in each step after a
    # distracted one. Two steps, β = 1, α = 0.5: silence earns 10 - 10 and then -5; the alert 15.
    found = seen_returns([[1.0, 0.5, 0.0]], Problem(horizon=2))
    assert found.never[0] == pytest.approx(-5.0)
    assert found.optimum[0] == found.when_distracted[0] == pytest.approx(10.0)


def test_a_driver_who_is_never_distracted_is_left_alone():
    traits = [[0.0, 0.0, 0.4], [0.0, 1.0, 1.0]]
    seen = seen_returns(traits, Problem())
    hidden = hidden_returns(traits, Problem(), 0.35)
    for returns in (seen.optimum, seen.when_distracted, seen.never, hidden.own):
        np.testing.assert_allclose(returns, 1000.0)
    # The filter for the average driver alerts all the same, and each alert costs 10.
    lost = (hidden.own - hidden.average) / 10.0
    assert (lost > 1.0).all()


def test_one_step_by_hand():
    # d_{-1} = 0: an alert costs 10 and spares min(β, η) times what distraction costs.
    weights = RewardWeights(distraction=-30.0)
    found = seen_returns([[0.8, 0.3, 0.5], [0.2, 0.3, 1.0]], Problem(3, 1, weights))
    assert found.never == pytest.approx([10 - 24, 10 - 6])
    assert (found.optimum - found.when_distracted) == pytest.approx([30 * 0.5 - 10, 0.0])
    np.testing.assert_allclose(found.optimum, [30 * -0.3, 10 - 6])
    hidden = hidden_returns([[0.8, 0.3, 0.5], [0.2, 0.3, 1.0]], Problem(3, 1, weights), 1.0)
    np.testing.assert_allclose(hidden.own, found.optimum)


def test_with_a_window_of_one_step_prevention_pays_where_the_closed_form_says():
    """min(β, η) (A + D - R r) > A (β + r), r = min(1, α + η); docs/when-the-driver-matters.md."""
    rng = np.random.default_rng(4)
    traits = rng.random((400, 3))
    beta, alpha, eta = traits.T
    silence, cost, bonus = 5.0, 20.0, 8.0
    weights = RewardWeights(distraction=-cost, alert=silence, accept_alert=bonus)
    r = np.minimum(1.0, alpha + eta)
    margin = np.minimum(beta, eta) * (silence + cost - bonus * r) - silence * (beta + r)
    clear = np.abs(margin) > 0.2  # elsewhere 400 steps are too few to tell
    losses = []
    for horizon in (200, 400):
        found = seen_returns(traits, Problem(1, horizon, weights))
        losses.append(found.optimum - found.when_distracted)
    grows = losses[1] - losses[0] > 1.0  # with the steps, not only at the end of the episode
    assert 50 < grows[clear].sum() < clear.sum() - 50
    np.testing.assert_array_equal(grows[clear], margin[clear] > 0)


def test_knowing_the_driver_never_costs_anything():
    traits = np.random.default_rng(5).random((60, 3))
    for share in (0.0, 0.35, 1.0):
        found = hidden_returns(traits, Problem(horizon=40), share)
        assert (found.own >= found.average - 1e-9).all()
        seen = seen_returns(traits, Problem(horizon=40))
        assert (found.own <= seen.optimum + 1e-9).all()


def test_sizes_of_parts_lines_and_threads_do_not_change_a_bit(monkeypatch):
    traits = np.random.default_rng(6).random((40, 3))
    problem = Problem(horizon=30)
    before = [*seen_returns(traits, problem), *hidden_returns(traits, problem, 0.35)]
    monkeypatch.setattr(driver_worth, "_LINES", 2)  # too few: doubled until they are enough
    monkeypatch.setattr(driver_worth, "_ROOM", 20_000)
    after = [
        *seen_returns(traits, problem, threads=2),
        *hidden_returns(traits, problem, 0.35, threads=2),
    ]
    np.testing.assert_array_equal(before, after)


def test_only_the_ratios_of_the_weights_matter():
    traits = np.random.default_rng(7).random((10, 3))
    doubled = Problem(horizon=30, weights=RewardWeights(distraction=-20, alert=20, accept_alert=60))
    once = [*seen_returns(traits, Problem(horizon=30))]
    once += [*hidden_returns(traits, Problem(horizon=30), 0.5)]
    twice = [*seen_returns(traits, doubled), *hidden_returns(traits, doubled, 0.5)]
    np.testing.assert_allclose(twice, 2 * np.array(once), rtol=1e-12)


@pytest.mark.parametrize(
    ("traits", "message"),
    [
        ([], "shape"),
        ([[0.1, 0.2]], "shape"),
        ([[0.1, 0.2, 1.1]], "lie in"),
        ([[0.1, 0.2, np.nan]], "lie in"),
        ([["a", "b", "c"]], "shape"),
    ],
)
def test_what_is_no_driver_is_refused(traits, message):
    for solve in (seen_returns, lambda *given: hidden_returns(*given, 0.35)):
        with pytest.raises(ValueError, match=message):
            solve(traits, Problem())


def test_what_is_no_problem_is_refused():
    for wrong in ({"window": 0}, {"horizon": 0}, {"horizon": 100_000}):
        with pytest.raises(ValueError, match=r"window|horizon"):
            Problem(**wrong)
    with pytest.raises(ValueError, match="revealing"):
        hidden_returns([[0.1, 0.2, 0.3]], Problem(), 1.5)
    with pytest.raises(ValueError, match="driver"):
        seen_returns([[0.1, 0.2, 0.3]], Problem(), "siren")
