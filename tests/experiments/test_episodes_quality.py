import numpy as np
import pytest

from hmi_marl.agents import make_driver_policy, make_hmi
from hmi_marl.envs.alerts import Fatigue
from hmi_marl.envs.attention import Attention
from hmi_marl.envs.config import TeamConfig
from hmi_marl.exact import oracle
from hmi_marl.experiments.episodes import (
    AlertJudge,
    AlertQuality,
    Episodes,
    ExactRules,
    play_episodes,
)

ONE_STEP = TeamConfig(driver="homer", duration=0.2)


def attention(distracted: list[int]) -> Attention:
    zeros = np.zeros(len(distracted), np.int64)
    return Attention(np.array(distracted), zeros, zeros, zeros)


def test_losses_of_one_last_step_by_hand() -> None:
    # Attentive: silence earns 10, and an alert saves Homer, eta = 1, 10 times his 0.8 of becoming
    # distracted, so that it loses 2. Distracted: an alert brings him back for sure, which saves 10
    # times the 0.8 of staying so and is paid for besides.
    judge = AlertJudge(ONE_STEP)
    told = judge.judge(0, attention([0, 0, 1, 1]), np.array([0, 1, 0, 1]))
    assert told.followed.tolist() == [1, 0, 0, 1]
    losses = oracle.alert_losses("homer", horizon=1)[0, :, :, 0, 0]
    np.testing.assert_allclose(told.lost, losses.T.ravel())
    assert told.lost[:2] == pytest.approx([0.0, 2.0])
    assert told.lost[3] == 0.0
    assert told.lost[2] > 8.0


def test_ended_episodes_are_no_longer_judged() -> None:
    one = AlertQuality(np.array([1, 1]), np.array([2.0, 3.0]))
    both = AlertQuality.nothing_yet(2).add(one, np.array([True, False])).add(one, np.ones(2, bool))
    assert both.followed.tolist() == [2, 1]
    assert both.lost.tolist() == [4.0, 3.0]


@pytest.mark.parametrize(
    "settings",
    [
        {"driver": "homer"},
        {"driver": "lisa", "alert_window": 3},
        {"driver": "marge", "alert_strengths": (0.5, 1.0), "fatigue": Fatigue(4, 2, 0.5)},
    ],
)
def test_the_optimum_loses_nothing_and_silence_all_that_it_gains(settings) -> None:
    team = TeamConfig(**settings, duration=20.0, end_at_crash=False)
    rules, judge = ExactRules.of(team), AlertJudge(team)
    assert rules.optimum >= rules.when_distracted > rules.never
    driver = make_driver_policy("rule", team)
    seeds, shares = np.arange(200), {}
    for name in ("optimal", "never"):
        episodes = play_episodes(team, driver, make_hmi(name, team), seeds, "batched", judge)
        assert episodes.alerting is not None
        shares[name] = rules.share_of_gain(float(episodes.alerting.lost.mean()))
    assert shares["optimal"] == pytest.approx(1.0, abs=1e-12)
    assert shares["never"] == pytest.approx(0.0, abs=0.03)  # 200 episodes' luck


def test_expected_losses_are_the_distance_of_exact_returns() -> None:
    """The sum of losses over the exact occupancy of a rule, in a chain of two steps, by hand."""
    losses = oracle.alert_losses("homer", horizon=2)
    always = [losses[0, 1, 0, 0, 0]]
    # After an alert i = 1 and c = 0, and Homer, whom an alert helps by 1, is attentive for sure.
    always.append(losses[1, 1, 0, 1, 0])
    best = oracle.solve_alerts("homer", horizon=2).total_return
    exact = oracle.evaluate(1.0, "homer", horizon=2).total_return
    assert sum(always) == pytest.approx(best - exact)


@pytest.mark.parametrize("driver", ["lisa", "bart"])
def test_losses_are_none_exactly_at_the_optimum(driver: str) -> None:
    given = {"strengths": (0.5, 1.0), "fatigue": Fatigue(4, 2, 0.5)}
    losses = oracle.alert_losses(driver, 5, 20, **given)
    best = oracle.solve_alerts(driver, 5, 20, **given)
    assert losses.shape == (20, 3, 2, 3, 5, 5)
    assert losses.min() == 0.0
    chosen = np.take_along_axis(losses, best.policy[:, None].astype(np.int64), axis=1)
    assert chosen.max() < 1e-9


def test_a_population_has_no_exact_values() -> None:
    with pytest.raises(ValueError, match="name one, not a population"):
        AlertJudge(TeamConfig(driver=["lisa", "homer"]))


def test_a_driver_who_never_drifts_off_leaves_nothing_to_gain() -> None:
    from hmi_marl import Driver

    rules = ExactRules.of(TeamConfig(driver=Driver("saint", 0.0, 1.0, 1.0, 1.0), duration=2.0))
    assert rules.optimum == rules.never
    assert rules.share_of_gain(3.0) is None


def test_playing_does_not_depend_on_the_judge_and_joins_what_it_said() -> None:
    team = TeamConfig(driver="homer", duration=2.0)
    seats = make_driver_policy("rule", team), make_hmi("random", team)
    judged = [play_episodes(team, *seats, seeds, judge=AlertJudge(team)) for seeds in ([3, 4], [5])]
    alone = play_episodes(team, *seats, [3, 4])
    assert alone.alerting is None
    for name in ("length", "alerts", "distracted", "crashed"):
        np.testing.assert_array_equal(getattr(judged[0], name), getattr(alone, name))
    whole = Episodes.join(judged)
    assert whole.alerting is not None
    assert whole.alerting.lost.shape == whole.alerting.followed.shape == (3,)
    assert (whole.alerting.followed <= whole.length).all()
    assert Episodes.join([alone, judged[1]]).alerting is None
