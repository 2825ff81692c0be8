import numpy as np
from evidence_models import any_alerts, any_intents, seeds, turns
from standing_world import standing_teams

from hmi_marl.agents.memory import AttentionWatch, step_of


def test_steps_are_counted_up_to_the_last_one():
    time = np.array([0.0, 0.01, 0.5, 0.99, 1.0], np.float32)
    assert step_of(time, 100).tolist() == [0, 1, 50, 99, 99]


def test_it_follows_what_the_alerts_do_and_takes_a_turn_once():
    teams = standing_teams(3, driver="bart", ai_sees_attention=False)
    watch = AttentionWatch(["bart", "homer"], teams.config)
    teams.reset(seeds(3))
    watch.reset(3)
    layout, shown = teams.layouts["vehicle_ai"], 0
    for t, seen in enumerate(turns(teams, any_intents(20, 3), any_alerts(20, 3))):
        assert watch.observe(seen).tolist() == [t] * 3
        before = watch.filter.distracted.copy()
        watch.observe(seen)
        np.testing.assert_array_equal(watch.filter.distracted, before)
        np.testing.assert_array_equal(watch.filter.accepted, teams.attention.accepted)
        np.testing.assert_array_equal(watch.filter.counter, teams.attention.counter)
        applied = layout.chosen(seen, "applied_action")
        intended = layout.chosen(seen, "intended_action")
        assert watch.reveals(seen).tolist() == [
            v != -1 and a != v for a, v in zip(intended, applied, strict=True)
        ]
        shown += int(watch.reveals(seen).sum())
    assert 0 < shown < 60
    accepted = watch.filter.accepted.copy()
    watch.reset(3, np.array([True, True, False]))
    assert accepted.tolist() != [0, 0, 0]  # or nothing could have been forgotten
    assert watch.filter.accepted.tolist() == [0, 0, accepted[2]]
    assert watch.filter.distracted[:2].tolist() == [[0.0, 0.0], [0.0, 0.0]]
