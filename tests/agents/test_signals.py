import numpy as np
import pytest
from scripted_drivers import RevealingDriver
from standing_world import CrashingWorld, StandingWorld

from hmi_marl.agents import BeliefAlert, make_hmi
from hmi_marl.agents.rollout import begin, turn
from hmi_marl.agents.signals import SignalWatch
from hmi_marl.envs.config import TeamConfig

MARGE = TeamConfig(driver="marge", duration=6.0, ai_sees_attention=False)


def test_the_belief_is_that_of_the_bayes_filter_hmi():
    seeds = np.arange(50, dtype=np.uint64)
    driver, hmi, watch = (
        RevealingDriver(MARGE, 0.3),
        BeliefAlert("marge", MARGE, 0.3),
        SignalWatch(),
    )
    teams = begin(MARGE, driver, hmi, seeds, StandingWorld(MARGE.scene, 50))
    known = np.zeros(50)
    for _ in range(MARGE.horizon):
        turn(teams, driver, hmi, [watch])
        # the HMI has acted on what was known before this step
        np.testing.assert_allclose(hmi.belief, known, atol=1e-12)
        known = watch.signal.belief
    assert 0 < watch.signal.reveals.sum() < 50


def test_it_marks_the_teams_that_took_the_step():
    seeds = np.arange(20, dtype=np.uint64)
    driver, hmi, watch = RevealingDriver(MARGE, 0.0), make_hmi("never", MARGE), SignalWatch()
    teams = begin(MARGE, driver, hmi, seeds, CrashingWorld(MARGE.scene, 20))
    assert watch.signal is None
    turn(teams, driver, hmi, [watch])
    np.testing.assert_array_equal(watch.active, True)
    for _ in range(8):
        over = teams.over
        turn(teams, driver, hmi, [watch])
        np.testing.assert_array_equal(watch.active, ~over)
    assert 0 < over.sum() < 20


def test_each_team_has_the_traits_of_its_own_driver():
    config = TeamConfig(driver=["lisa", "bart"], duration=1.0, ai_sees_attention=False)
    seeds = np.arange(20, dtype=np.uint64)
    driver, hmi, watch = RevealingDriver(config, 0.0), make_hmi("never", config), SignalWatch()
    teams = begin(config, driver, hmi, seeds, StandingWorld(config.scene, 20))
    turn(teams, driver, hmi, [watch])
    # after one step without an alert p(d = 1) is β
    assert watch.signal.belief == pytest.approx(teams.traits.beta)
    assert len(set(teams.traits.beta)) == 2
