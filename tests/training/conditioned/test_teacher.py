"""The exact rules that an HMI learns from are those of the drivers at the wheel."""

import numpy as np
from evidence_models import HIDDEN, any_alerts, any_intents, seeds, turns
from standing_world import standing_teams

from hmi_marl.agents.hmis import BeliefAlert
from hmi_marl.envs.drivers import DRIVERS, PAPER_DRIVERS, Driver
from hmi_marl.exact.hidden_attention import GRID, solve_belief
from hmi_marl.training.conditioned.teacher import Teacher

FOUR = [DRIVERS[name] for name in PAPER_DRIVERS]
OTHER = Driver("other", 0.37, 0.41, 0.23, 4.0)


def test_the_advantage_is_that_of_each_teams_own_driver():
    drivers = [*FOUR, OTHER, FOUR[2]]
    count = len(drivers)
    teacher = Teacher(drivers, HIDDEN, 0.35)
    rules = [BeliefAlert(driver, HIDDEN, 0.35) for driver in drivers]
    tables = [
        solve_belief(d, HIDDEN.alert_window, HIDDEN.horizon, HIDDEN.weights, 0.35).advantage
        for d in drivers
    ]
    teams = standing_teams(count, driver=PAPER_DRIVERS, ai_sees_attention=False, duration=4.0)
    grid, compared = np.linspace(0, 1, GRID), 0
    for trip in range(2):
        teams.reset(seeds(count, 10 * trip))
        teacher.reset()
        for rule in rules:
            rule.reset(seeds(count))
        intents, alerts = any_intents(20, count, trip), any_alerts(20, count, seed=trip)
        for t, seen in enumerate(turns(teams, intents, alerts)):
            found = teacher.advantage(seen)
            applied = teams.layouts["vehicle_ai"].chosen(seen, "applied_action")
            shows = int(0 <= applied[0] != intents[t, 0])
            for n, rule in enumerate(rules):
                alert = rule.act(seen)[n]
                shows = int(applied[n] >= 0 and applied[n] != intents[t, n])
                i, c = teams.attention.accepted[n], teams.attention.counter[n]
                exact = np.interp(rule.belief[n], grid, tables[n][t, shows, :, i, c])
                assert abs(found[n] - exact) < 0.15 + 0.02 * abs(exact)
                if abs(exact) > 0.3:
                    assert (found[n] > 0) == bool(alert)
                    compared += 1
    assert compared > 100


def test_the_driver_decides():
    teams = standing_teams(2, driver="bart", ai_sees_attention=False, duration=4.0)
    teams.reset(seeds(2))
    teacher = Teacher([DRIVERS["bart"], DRIVERS["lisa"]], HIDDEN, 0.35)
    trip = turns(teams, any_intents(15, 2), np.zeros((15, 2), np.int64))
    found = np.array([teacher.advantage(seen) for seen in trip])
    assert (np.sign(found[:, 0]) != np.sign(found[:, 1])).any()
