import numpy as np
import pytest
from standing_world import standing_teams

from hmi_marl.agents import AlertWhenDistracted, OptimalAlert, RandomAlert, make_hmi, oracle
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import DRIVERS
from hmi_marl.envs.rewards import RewardWeights
from hmi_marl.envs.seats import Policy


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


def test_rules_tell_the_oracle_their_probabilities():
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
