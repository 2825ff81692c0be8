import numpy as np
import pytest
from standing_world import standing_teams

from hmi_marl.agents import (
    AlertWhenDistracted,
    OptimalAlert,
    RandomAlert,
    make_driver_policy,
    make_hmi,
)
from hmi_marl.agents.hmis import strongest_alert
from hmi_marl.envs.alerts import PLAIN, Alerts, Fatigue
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import DRIVERS
from hmi_marl.envs.rewards import RewardWeights
from hmi_marl.envs.seats import Policy
from hmi_marl.exact import oracle
from hmi_marl.exact.identify import identify


def play(name, count=400, seeds=None, **settings):
    """(teams, alerts of shape (T, N)) of one episode with the HMI of this name."""
    teams = standing_teams(count, **settings)
    hmi = make_hmi(name, teams.config)
    assert isinstance(hmi, Policy)
    seeds = np.arange(count, dtype=np.uint64) if seeds is None else seeds
    teams.reset(seeds)
    hmi.reset(seeds)
    states, alerts = [], []
    while not teams.over.all():
        teams.intend(np.ones(count, np.int64))
        states.append((teams.attention, teams.steps.copy()))
        alert = hmi.act(teams.observe("vehicle_ai"))
        alerts.append(alert)
        teams.step(alert)
    return states, np.array(alerts)


def test_never_and_always():
    assert not play("never", duration=2.0)[1].any()
    assert play("always", duration=2.0)[1].all()


def test_random_alerts_at_its_rate_and_by_seed_alone():
    _, alerts = play("random:0.3", count=500)
    share = alerts.mean()
    assert abs(share - 0.3) < 4 * np.sqrt(0.3 * 0.7 / alerts.size)
    _, alone = play("random:0.3", count=1, seeds=np.array([17], np.uint64))
    assert alone[:, 0].tolist() == alerts[:, 17].tolist()


def test_when_distracted_alerts_exactly_then():
    states, alerts = play("when-distracted", driver="bart", duration=6.0)
    for (attention, _), alert in zip(states, alerts, strict=True):
        assert np.array_equal(alert, attention.distracted)


@pytest.mark.parametrize("weights", [RewardWeights(), RewardWeights(alert=60.0, accept_alert=5.0)])
@pytest.mark.parametrize("window", [1, 7, 12])
def test_the_optimal_hmi_plays_the_solved_policy_in_every_state(weights, window):
    settings = {"driver": "average", "alert_window": window, "weights": weights}
    states, alerts = play("optimal", duration=10.0, **settings)
    policy = oracle.solve_alerts("average", window, 50, weights).policy
    for (now, step), alert in zip(states, alerts, strict=True):
        wanted = policy[step, now.distracted, now.accepted, now.counter]
        assert np.array_equal(alert, wanted)
    if (
        weights.alert == 60.0 and window > 1
    ):  # one in which the best rule is not just "when distracted"
        assert not np.array_equal(
            policy, np.broadcast_to(np.arange(2).reshape(1, 2, 1, 1), policy.shape)
        )


def test_rules_give_the_oracle_their_probabilities():
    config = TeamConfig(driver="homer")
    for hmi in (RandomAlert(0.25), AlertWhenDistracted(config), OptimalAlert("bart", config)):
        returns = oracle.evaluate(hmi.alert_probability(), "homer", 7, 100)
        assert 0 < returns.alerts < 100
    assert oracle.evaluate(RandomAlert(0.25).alert_probability(), "homer").alerts == 25.0


@pytest.mark.parametrize("rate", [-0.1, 1.1, float("nan")])
def test_a_rate_out_of_range_is_refused(rate):
    with pytest.raises(ValueError, match=r"rate lies in \[0, 1\]"):
        RandomAlert(rate)


def test_what_needs_attention_says_so_when_it_is_hidden():
    hidden = TeamConfig(driver="homer", ai_sees_attention=False)
    for make in (lambda: AlertWhenDistracted(hidden), lambda: OptimalAlert("bart", hidden)):
        with pytest.raises(ValueError, match=r"ai_sees_attention=False hides.*'belief'"):
            make()


def test_the_optimum_may_be_for_any_driver_model():
    mona = DRIVERS["marge"]
    assert OptimalAlert(mona, TeamConfig()).model is mona


GRADES = (0.25, 0.5, 0.75, 1.0)
WEARY = Fatigue(levels=20, per_alert=5, effect=1.0)


@pytest.mark.parametrize("fatigue", [None, WEARY], ids=["fresh", "weary"])
@pytest.mark.parametrize("driver", ["homer", "average", "bart"])
def test_the_optimal_hmi_plays_the_solved_policy_of_graded_alerts(driver, fatigue):
    settings = {"driver": driver, "alert_strengths": GRADES, "fatigue": fatigue}
    states, alerts = play("optimal", count=1000, duration=10.0, **settings)
    policy = oracle.solve_alerts(driver, 7, 50, strengths=GRADES, fatigue=fatigue).policy
    for (now, step), alert in zip(states, alerts, strict=True):
        level = (now.fatigue,) if fatigue else ()
        wanted = policy[step, now.distracted, now.accepted, now.counter, *level]
        assert np.array_equal(alert, wanted)
    assert len(np.unique(alerts)) >= 3  # silence, and alerts of several strengths


def test_plain_rules_give_the_strongest_alert():
    settings = {"driver": "bart", "alert_strengths": GRADES, "fatigue": WEARY, "duration": 4.0}
    assert not play("never", **settings)[1].any()
    assert (play("always", **settings)[1] == 4).all()
    _, alerts = play("random:0.3", **settings)
    assert set(np.unique(alerts)) == {0, 4}
    assert abs((alerts > 0).mean() - 0.3) < 4 * np.sqrt(0.3 * 0.7 / alerts.size)
    states, alerts = play("when-distracted", **settings)
    for (attention, _), alert in zip(states, alerts, strict=True):
        assert np.array_equal(alert, 4 * attention.distracted)


def test_rules_of_graded_alerts_give_the_oracle_their_probabilities():
    config = TeamConfig(driver="homer", alert_strengths=GRADES, fatigue=WEARY)
    given = {"strengths": GRADES, "fatigue": WEARY}
    best = oracle.solve_alerts("homer", **given)
    for name, total, alerts in (
        ("random:0.25", None, 25.0),
        ("when-distracted", None, None),
        ("optimal", best.total_return, best.alerts),
    ):
        rule = make_hmi(name, config).alert_probability()
        returns = oracle.evaluate(rule, "homer", **given)
        assert returns.total_return <= best.total_return + 1e-9
        if total is not None:
            assert returns.total_return == pytest.approx(total)
        if alerts is not None:
            assert returns.alerts == pytest.approx(alerts)
        if name != "optimal":
            assert returns.rate_by_strength[:-1].sum() == 0


def test_the_shapes_of_a_rule_of_one_strength_are_those_of_the_paper():
    assert strongest_alert(PLAIN, 0.0, 1.0).tolist() == [[[[0.0]], [[1.0]]]]
    assert strongest_alert(Alerts(GRADES), 0.0, 1.0).shape == (4, 1, 2, 1, 1)
    assert strongest_alert(Alerts(GRADES, WEARY), 0.5).shape == (4, 1, 1, 1, 1, 1)


@pytest.mark.parametrize("settings", [{"alert_strengths": (0.5,)}, {"fatigue": WEARY}], ids=str)
def test_what_knows_one_bit_alone_refuses_other_alerts_at_the_door(settings):
    config = TeamConfig(driver="homer", **settings)
    hidden = TeamConfig(driver="homer", ai_sees_attention=False, **settings)
    message = "is for alerts of one strength, 1, without fatigue"
    for name, team in (("belief", config), ("optimal", hidden)):
        with pytest.raises(ValueError, match=message):
            make_hmi(name, team)
    driver = make_driver_policy("random", config)
    driver.probabilities = lambda seen: np.full((len(seen), 5), 0.2)
    with pytest.raises(ValueError, match=message):
        identify(
            config, driver, ["lisa"], np.zeros(0, np.int64), *np.zeros((2, 0, 1), np.int64), []
        )
