import dataclasses
import json

import numpy as np
import pytest
from scripted_drivers import RevealingDriver
from standing_world import StandingWorld

from hmi_marl.agents import BeliefAlert, make_hmi
from hmi_marl.envs.alerts import Fatigue
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import DRIVERS, PAPER_DRIVERS, Driver, TraitDistributions
from hmi_marl.envs.rewards import DRIVING_TERMS, TERMS
from hmi_marl.envs.scene import Scene
from hmi_marl.exact import oracle
from hmi_marl.exact.hidden_attention import solve_belief
from hmi_marl.experiments.episodes import (
    Episodes,
    evaluation_seeds,
    exact_settings,
    play_episodes,
)
from hmi_marl.experiments.references import (
    GivenUp,
    PairScore,
    ReferenceReturns,
    filter_returns,
    mean_score,
    measure_pair,
    reference_returns,
    score_pair,
    score_tables,
)
from hmi_marl.files import json_value
from hmi_marl.reporting.blocks import as_text

TEAM = TeamConfig(driver="bart", ai_sees_attention=False)
COIN = TeamConfig(driver=Driver("coin", 0.5, 0.0, 1.0, 1.0), duration=0.4, ai_sees_attention=False)
"""Two steps; distracted by the toss of a coin, for good; an alert always helps."""


def made(seeds, lengths, returns=None, driving=0.0, crashed=False) -> Episodes:
    """Episodes with these attention returns, and the same in every driving term."""
    seeds, count = np.array(seeds, np.uint64), len(seeds)
    terms = {name: np.zeros(count) for name in TERMS}
    terms["alert"] = np.zeros(count) if returns is None else np.array(returns, np.float64)
    for k, name in enumerate(DRIVING_TERMS):
        terms[name] = np.broadcast_to(driving, count) * (k + 1.0)
    headways = np.full(count, np.inf)
    nothing = np.zeros(count, np.int64)
    return Episodes(
        seeds=seeds,
        length=np.array(lengths),
        crashed=np.broadcast_to(crashed, count),
        alerts=nothing,
        distracted=nothing,
        min_time_headway=headways,
        median_time_headway=headways,
        returns=terms,
    )


def test_with_attention_seen_the_whole_regret_is_the_hmis():
    team = dataclasses.replace(COIN, ai_sees_attention=True)
    (score,) = score_pair(team, made([0, 1], [2, 2], returns=[20.0, 25.0]), {"coin": 0.3})
    assert score.references.filter is None
    assert score.hiding is None
    assert score.shortfall is None
    assert score.regret.mean == pytest.approx(0.0)  # the optimum is 22.5
    as_text(score_tables([score]))


def test_references_worked_by_hand():
    # Step 0 without an alert: 10 for silence, d_0 = 1 with 0.5, -10 for it: 5 on average.
    # Step 1 without alerts: d_0 = 1 stays, -10; else 10 and again -5. On average -2.5.
    # Step 1, d seen: an alert if d_0 = 1 earns 30; else silence 10 - 5. On average 17.5.
    # Step 1, d hidden: an alert earns 0.5 x 30 = 15, more than silence, -2.5.
    # An alert in step 0 instead: 0, then silence 10, in all 10, which is less than 22.5 and 20.
    lengths = np.array([2, 0, 1, 2])
    for share in (0.0, 1.0):  # step 1 shows d_1, too late
        found = ReferenceReturns.of(COIN, lengths, share)
        np.testing.assert_allclose(found.none, [2.5, 0.0, 5.0, 2.5])
        np.testing.assert_allclose(found.filter, [20.0, 0.0, 5.0, 20.0])
        np.testing.assert_allclose(found.optimum, [22.5, 0.0, 5.0, 22.5])


def test_a_score_and_the_parts_of_a_regret_worked_by_hand():
    episodes = made([0, 1, 2], [2, 1, 2], returns=[12.5, 5.0, 2.5])
    (score,) = score_pair(COIN, episodes, {"coin": 0.3})
    assert score.driver == "coin"
    assert (
        score.references.none,
        score.references.filter,
        score.references.optimum,
    ) == pytest.approx((10 / 3, 15.0, 50 / 3))
    returns = reference_returns(COIN, episodes, {"coin": 0.3})
    assert {name: each.means() for name, each in returns.items()} == {"coin": score.references}
    # Returns above none: 10, 0, 0; the gain: 20, 0, 20.
    assert score.score.mean == pytest.approx(0.25)
    assert score.attention_return.mean == pytest.approx(20 / 3)
    assert score.regret.mean == pytest.approx(10.0)
    assert score.hiding == pytest.approx(5 / 3)
    assert score.shortfall.mean == pytest.approx(25 / 3)
    assert score.regret.mean == pytest.approx(score.hiding + score.shortfall.mean)
    assert score.given_up is None


def test_the_ends_of_the_score_are_the_references():
    exact = ReferenceReturns.of(COIN, np.array([1, 2, 2]), 0.3)
    for returns, expected in ((exact.none, 0.0), (exact.optimum, 1.0)):
        score = PairScore.of("coin", returns, exact, 0.3)
        assert score.score.mean == pytest.approx(expected)
        assert score.score.high - score.score.low == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("name", PAPER_DRIVERS)
def test_whole_episodes_have_the_exact_returns(name, share):
    team = dataclasses.replace(TEAM, driver=name)
    found = ReferenceReturns.of(team, np.full(3, team.horizon), share)
    settings = exact_settings(team)
    best = oracle.solve_alerts(**settings).total_return
    np.testing.assert_allclose(found.optimum, best)
    np.testing.assert_allclose(found.none, oracle.evaluate(0.0, **settings).total_return)
    assert (found.none <= found.filter + 1e-9).all()
    assert (found.filter <= found.optimum + 1e-9).all()


@pytest.mark.parametrize("length", [1, 2, 7, 30, 99])
@pytest.mark.parametrize("name", DRIVERS)
def test_of_episodes_of_one_length_it_is_the_optimum_for_that_length(name, length):
    # The best rule for these drivers is the same for every length.
    team = dataclasses.replace(TEAM, driver=name)
    found = ReferenceReturns.of(team, np.array([length, length]), 0.3)
    best = oracle.solve_alerts(name, team.alert_window, length, team.weights).total_return
    np.testing.assert_allclose(found.optimum, best)
    none = oracle.evaluate(0.0, name, team.alert_window, length, team.weights).total_return
    np.testing.assert_allclose(found.none, none)


def test_no_reference_is_more_than_the_optimum_for_a_known_length():
    # For this driver another rule than "alert exactly when distracted" is best, near the end too.
    odd = Driver("odd", 0.02, 0.03, 0.05, 1.0)
    team = dataclasses.replace(TEAM, driver=odd)
    lengths = np.arange(1, 101, 11)
    found = ReferenceReturns.of(team, lengths, 0.3)
    known = [
        oracle.solve_alerts(odd, team.alert_window, int(length), team.weights).total_return
        for length in lengths
    ]
    assert (found.optimum <= np.array(known) + 1e-9).all()
    assert (found.optimum < np.array(known) - 1.0).any()
    assert found.optimum[-1] == pytest.approx(known[-1])


@pytest.mark.parametrize("sequential", [True, False])
def test_the_filter_earns_its_reference_in_play(sequential):
    count = 1500
    team = dataclasses.replace(TEAM, driver="lisa")
    hmi = BeliefAlert("lisa", team, 0.4, sequential)
    hmi.sequential = sequential
    world = StandingWorld(team.scene, count)
    played = play_episodes(team, RevealingDriver(team, 0.4), hmi, np.arange(count), world)
    exact = ReferenceReturns.of(team, played.length, 0.4, sequential)
    score = PairScore.of("lisa", played.attention_return(), exact, 0.4)
    spread = played.attention_return().std() / np.sqrt(count)
    assert abs(score.shortfall.mean) < 4 * spread
    assert score.hiding > 10 * spread


def every_episode(rule, driver, ends):
    """Probability, length and return of every episode that can happen.

    Each step but the first reveals d with the rule's share; after step t the episode ends with
    probability ``ends(t, d_t)``, and for sure after the last.
    """
    found = []

    def go_on(t, d, i, c, b, probability, earned):
        share = rule.revealing if t > 0 else 0.0
        for reveals, chance in ((True, share), (False, 1.0 - share)):
            arguments = (np.array([value]) for value in (t, reveals, b, i, c))
            if alert := int(rule.alert(*arguments)[0]):
                now = 1, 0
            elif i:
                now = int(c < rule.window - 1), (c + 1) % rule.window
            else:
                now = 0, 0
            p, assumed = (
                [
                    1.0 - min(1.0, who.alpha + who.eta * now[0]),
                    max(0.0, who.beta - who.eta * now[0]),
                ]
                for who in (driver, rule.driver)
            )
            for new, weight in ((1, p[1 - d]), (0, 1.0 - p[1 - d])):
                here = probability * chance * weight
                if here == 0.0:
                    continue
                reward = -10.0 * new
                reward += 30.0 * (d == 1 and new == 0) if alert else 10.0 * (d == 0)
                belief = float(new) if reveals else b * assumed[0] + (1.0 - b) * assumed[1]
                end = ends(t, new) if t < rule.horizon - 1 else 1.0
                if end > 0.0:
                    found.append((here * end, t + 1, earned + reward))
                if end < 1.0:
                    go_on(t + 1, new, *now, belief, here * (1.0 - end), earned + reward)

    go_on(0, 0, 0, 0, 0.0, 1.0, 0.0)
    probability, length, earned = map(np.array, zip(*found, strict=True))
    assert probability.sum() == pytest.approx(1.0)
    return probability, length, earned


SHORT = dataclasses.replace(TEAM, alert_window=2, duration=0.8)
"""Four steps."""


@pytest.mark.parametrize("share", [0.0, 0.4, 1.0])
@pytest.mark.parametrize("model", ["average", "lisa", None])
@pytest.mark.parametrize("name", ["bart", "homer"])
def test_over_lengths_that_are_independent_of_attention_a_filter_has_its_expectation(
    name, model, share
):
    team = dataclasses.replace(SHORT, driver=name)
    rule = solve_belief(model or name, 2, team.horizon, team.weights, share)
    ends = (0.2, 0.0, 0.5)
    played = every_episode(rule, DRIVERS[name], lambda t, d: ends[t])
    probability, length, earned = played
    exact = filter_returns(team, length, share, model=model)
    assert probability @ exact == pytest.approx(probability @ earned, abs=1e-9)
    for steps in (1, 3, 4):  # and those of each length alone
        of = length == steps
        expected = probability[of] @ earned[of] / probability[of].sum()
        assert filter_returns(team, steps, share, model=model) == pytest.approx(expected, abs=1e-9)


def test_over_lengths_that_depend_on_attention_the_expectation_is_another():
    # Episodes that end while the driver is distracted leave those in which the driver is not.
    rule = solve_belief("bart", 2, SHORT.horizon, SHORT.weights, 0.4)
    probability, length, earned = every_episode(rule, DRIVERS["bart"], lambda t, d: 0.5 * d)
    exact = filter_returns(SHORT, length, 0.4)
    assert abs(probability @ exact - probability @ earned) > 0.5


def test_no_alerts_are_over_the_same_lengths_by_brute_force():
    never = solve_belief("bart", 2, SHORT.horizon, SHORT.weights, 0.0)
    silent = dataclasses.replace(never, advantage=-np.ones_like(never.advantage))
    played = every_episode(silent, DRIVERS["bart"], lambda t, d: 0.3)
    probability, length, earned = played
    found = ReferenceReturns.of(SHORT, length, 0.0)
    assert probability @ found.none == pytest.approx(probability @ earned, abs=1e-9)
    assert probability @ found.filter <= probability @ found.optimum


def test_what_a_filter_cannot_have_is_refused():
    for lengths in (-1, 5, 1.5):
        with pytest.raises(ValueError, match="whole numbers from 0 to 4"):
            filter_returns(SHORT, lengths, 0.3)
    graded = dataclasses.replace(SHORT, alert_strengths=(0.5, 1.0))
    with pytest.raises(ValueError, match="the Bayes filter is for alerts of one strength"):
        filter_returns(graded, 4, 0.3)
    with pytest.raises(ValueError, match="not a population"):
        filter_returns(dataclasses.replace(SHORT, driver=TraitDistributions()), 4, 0.3)


def test_graded_alerts_have_no_filter():
    team = dataclasses.replace(TEAM, alert_strengths=(0.5, 1.0), fatigue=Fatigue(10, 2, 0.5))
    (score,) = score_pair(team, made([0, 1], [100, 50], returns=[0.0, 0.0]), {"bart": 0.3})
    assert score.references.filter is score.hiding is score.shortfall is None
    best = oracle.solve_alerts(**exact_settings(team)).return_after([100, 50]).mean()
    assert score.references.optimum == pytest.approx(best)
    assert score.regret.mean == pytest.approx(best)
    assert "-" in as_text(score_tables([score]))


def test_where_alerts_gain_nothing_there_is_no_score():
    deaf = dataclasses.replace(TEAM, driver=Driver("awake", 0.0, 1.0, 0.0, 1.0))
    (score,) = score_pair(deaf, made([0, 1], [100, 100], returns=[1.0, 2.0]), {"awake": 0.0})
    assert np.isnan(score.score.mean)
    assert score.references.optimum == score.references.none == pytest.approx(1000.0)


def test_what_a_driver_gives_up_worked_by_hand():
    # In each of five terms k + 1 times as much: 15 in all.
    natural = made([3, 4, 5], [2, 2, 2], driving=np.array([1.0, 2.0, 3.0]))
    signals = made(
        [3, 4, 5], [2, 2, 1], driving=np.array([1.0, 1.0, 0.0]), crashed=[False, True, True]
    )
    given = GivenUp.of(signals, natural, np.array([True, True, True]))
    assert given.driving.mean == pytest.approx(15 * 4 / 3)
    assert given.by_term["collision"].mean == pytest.approx(4 / 3)
    assert given.by_term["lane_change"].mean == pytest.approx(5 * 4 / 3)
    assert given.crash_rate.mean == pytest.approx(2 / 3)
    some = GivenUp.of(signals, natural, np.array([True, True, False]))
    assert some.driving.mean == pytest.approx(15 * 0.5)
    # paired: the same loss in every episode is known exactly, however much episodes differ
    other = made([3, 4, 5], [2, 2, 2], driving=np.array([0.0, 1.0, 2.0]))
    exact = GivenUp.of(other, natural, np.array([True, True, True]))
    assert exact.driving.low == exact.driving.high == pytest.approx(15.0)


def test_a_natural_driver_on_other_seeds_is_refused():
    with pytest.raises(ValueError, match="same seeds"):
        score_pair(COIN, made([0, 1], [2, 2]), {"coin": 0.3}, made([1, 0], [2, 2]))


def test_each_driver_has_its_own_episodes():
    team = dataclasses.replace(TEAM, driver=["lisa", "homer"], duration=2.0)
    seeds = evaluation_seeds(40)
    lisa = team.population.draw(seeds).alpha == DRIVERS["lisa"].alpha
    assert 0 < lisa.sum() < 40
    returns = np.where(lisa, 50.0, 20.0)
    scores = score_pair(
        team, made(seeds, np.full(40, 10), returns=returns), {"lisa": 0.2, "homer": 0.4}
    )
    assert [score.driver for score in scores] == ["lisa", "homer"]
    assert [score.attention_return.mean for score in scores] == [50.0, 20.0]
    assert [score.revealing for score in scores] == [0.2, 0.4]
    assert mean_score(scores).mean == pytest.approx(np.mean([s.score.mean for s in scores]))
    absent = score_pair(team, made(seeds[lisa], np.full(lisa.sum(), 10)), {"lisa": 0.2, "homer": 0})
    assert [score.driver for score in absent] == ["lisa"]


def test_a_population_and_a_name_for_two_drivers_are_refused():
    anyone = dataclasses.replace(TEAM, driver=TraitDistributions())
    with pytest.raises(ValueError, match="lists the drivers"):
        measure_pair(anyone, "rule", "never", 4)
    twins = dataclasses.replace(
        TEAM, driver=[Driver("twin", 0.1, 0.1, 0.1, 1.0), Driver("twin", 0.2, 0.1, 0.1, 1.0)]
    )
    with pytest.raises(ValueError, match="same name"):
        measure_pair(twins, "rule", "never", 4)


def test_a_pair_by_name_is_measured_and_scored():
    team = TeamConfig(
        driver=["lisa", "bart"], duration=4.0, ai_sees_attention=False, scene=Scene(vehicles=10)
    )
    natural = measure_pair(team, "rule", "belief:average", 80)
    random = measure_pair(team, "random", "belief:average", 80, natural.episodes)
    assert all(score.given_up is None for score in natural.scores)
    for name, score in zip(["lisa", "bart"], random.scores, strict=True):
        assert score.driver == name
        assert score.revealing == random.signalling[name].total.share
        assert score.revealing == pytest.approx(0.8, abs=0.05)
        assert score.given_up.driving.low > 0.0, "random driving is worse"
        parts = sum(estimate.mean for estimate in score.given_up.by_term.values())
        assert parts == pytest.approx(score.given_up.driving.mean)
    shown = score_tables(random.scores)
    assert len(shown) == 1 + len(score_tables(natural.scores)) == 3
    text = as_text(shown)
    for words in ("Regret per episode", "mean", "lane_change", "more crashes"):
        assert words in text
    assert json.dumps(json_value(random.scores))
    # The rule-based driver reveals less.
    for score in natural.scores:
        assert score.revealing < 0.6


def test_the_optimum_with_attention_seen_scores_one():
    count = 1500
    team = dataclasses.replace(TEAM, driver="bart", ai_sees_attention=True)
    hmi, world = make_hmi("optimal", team), StandingWorld(team.scene, count)
    played = play_episodes(team, RevealingDriver(team, 0.2), hmi, np.arange(count), world)
    (score,) = score_pair(team, played, {"bart": 0.2})
    error = (score.score.high - score.score.mean) / 1.96
    assert abs(score.score.mean - 1.0) < 4 * error < 0.1
