"""What an alert is worth with each candidate is what the exact rule for that candidate says."""

from dataclasses import replace

import numpy as np
import pytest
from evidence_models import HIDDEN, any_alerts, any_intents, seeds, turns
from standing_world import standing_teams

from hmi_marl.agents.adaptive.advantages import Advantages
from hmi_marl.agents.hmis import BeliefAlert
from hmi_marl.envs.drivers import DRIVERS, PAPER_DRIVERS, Driver
from hmi_marl.exact.hidden_attention import GRID, solve_belief

FOUR = [DRIVERS[name] for name in PAPER_DRIVERS]
OTHER = Driver("other", 0.37, 0.41, 0.23, 4.0)


def test_the_advantage_is_that_of_each_candidate():
    drivers, count = [*FOUR, OTHER], 6
    advantages = Advantages(drivers, HIDDEN, 0.35)
    chain = advantages.by_chain(np.eye(len(drivers))).argmax(axis=1)
    assert sorted(chain) == list(range(len(drivers)))
    rules = [BeliefAlert(driver, HIDDEN, 0.35) for driver in drivers]
    tables = [
        solve_belief(d, HIDDEN.alert_window, HIDDEN.horizon, HIDDEN.weights, 0.35).advantage
        for d in drivers
    ]
    teams = standing_teams(count, driver=PAPER_DRIVERS, ai_sees_attention=False, duration=4.0)
    grid, compared = np.linspace(0, 1, GRID), 0
    for trip in range(2):
        teams.reset(seeds(count, 10 * trip))
        advantages.reset(count)
        for rule in rules:
            rule.reset(seeds(count))
        intents, alerts = any_intents(20, count, trip), any_alerts(20, count, seed=trip)
        for t, seen in enumerate(turns(teams, intents, alerts)):
            found = advantages.observe(seen)
            assert found.shape == (count, len(drivers))
            applied = teams.layouts["vehicle_ai"].chosen(seen, "applied_action")
            shows = (applied >= 0) & (applied != intents[t])
            i, c = teams.attention.accepted, teams.attention.counter
            for k, rule in enumerate(rules):
                alert = rule.act(seen)
                for n in range(count):
                    exact = np.interp(
                        rule.belief[n], grid, tables[k][t, int(shows[n]), :, i[n], c[n]]
                    )
                    assert found[n, chain[k]] == pytest.approx(exact, abs=1e-4, rel=1e-4)
                    if abs(exact) > 1e-3:
                        assert (found[n, chain[k]] > 0) == bool(alert[n])
                        compared += 1
    assert compared > 500


def test_candidates_of_one_chain_are_summed():
    bart = DRIVERS["bart"]
    candidates = [DRIVERS["lisa"], bart, replace(bart, name="slow", inflation=7.0)]
    advantages = Advantages(candidates, HIDDEN, 0.35)
    summed = advantages.by_chain(np.array([[0.2, 0.5, 0.3], [1.0, 0.0, 0.0]]))
    np.testing.assert_allclose(summed, [[0.2, 0.8], [1.0, 0.0]])
    teams = standing_teams(2, driver="bart", ai_sees_attention=False, duration=4.0)
    teams.reset(seeds(2))
    advantages.reset(2)
    trip = turns(teams, any_intents(15, 2), np.zeros((15, 2), np.int64))
    found = np.array([advantages.observe(seen) for seen in trip])
    assert found.shape == (15, 2, 2)
    assert (np.sign(found[..., 0]) != np.sign(found[..., 1])).any()  # who drives decides
