import itertools

import numpy as np
import pytest
from evidence_models import any_alerts, any_intents, seeds, turns
from hypothesis import given, settings
from hypothesis import strategies as st
from standing_world import standing_teams

from hmi_marl.agents.hmis import BeliefAlert
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import DRIVERS, PAPER_DRIVERS, Driver
from hmi_marl.exact.evidence import ChainEvidence, chains

FOUR = [DRIVERS[name] for name in PAPER_DRIVERS]
EVERY = np.ones(1, np.bool_)


def of_all_sequences(driver, window, intended, applied, alerts):
    """p(v) and p(v, d_t = 1), by enumerating every hidden sequence d_0 .. d_t."""
    total, distracted = 0.0, 0.0
    for hidden in itertools.product((0, 1), repeat=len(applied)):
        probability = 1.0
        for t, d in enumerate(hidden):
            helps = any(alerts[max(0, t - window + 1) : t + 1])  # an alert lasts a window
            eta = driver.eta if helps else 0.0
            if t > 0 and hidden[t - 1]:
                p = 1.0 - min(1.0, driver.alpha + eta)
            else:
                p = max(0.0, driver.beta - eta)
            probability *= p if d else 1.0 - p
            probability *= applied[t] == (applied[t - 1] if d and t > 0 else intended[t])
        total += probability
        distracted += probability * hidden[-1]
    return total, distracted


def believed(evidence, driver):
    """p(d_t = 1) of the only team if this driver drives."""
    chain = [other.traits[:3] for other in evidence.filter.drivers].index(driver.traits[:3])
    return evidence.filter.distracted[0, chain]


unit = st.floats(0, 1)
anybody = st.builds(Driver, st.just("k"), unit, unit, unit, st.just(1.0))


@settings(max_examples=60)
@given(
    who=anybody,
    candidates=st.lists(anybody, min_size=1, max_size=3),
    window=st.integers(1, 4),
    seed=st.integers(0, 2**32),
    rate=st.sampled_from([0.0, 0.3, 1.0]),
)
def test_it_is_the_likelihood_over_all_hidden_sequences(who, candidates, window, seed, rate):
    steps = 7
    teams = standing_teams(1, driver=who, alert_window=window, ai_sees_attention=False)
    teams.reset(seeds(1, seed))
    intents, alerts = any_intents(steps, 1, seed), any_alerts(steps, 1, rate, seed + 1)
    drivers = [who, *candidates]
    evidence = ChainEvidence(drivers, teams.config)
    found, applied = np.zeros(len(drivers)), []
    for t, seen in enumerate(turns(teams, intents, alerts)):
        if t:
            applied.append(int(teams.applied[0]))
        gains = evidence.observe(seen, EVERY)
        assert gains.shape == (1, len(drivers))
        found += gains[0]
        for k, driver in enumerate(drivers if t else []):
            past = intents[:t, 0], applied, alerts[:t, 0]
            p, with_d = of_all_sequences(driver, window, *past)
            if p > 1e-200:
                assert found[k] == pytest.approx(np.log(p), abs=1e-9)
                assert believed(evidence, driver) == pytest.approx(with_d / p, abs=1e-9)
            else:
                assert found[k] < -400
    assert found[0] > -np.inf, "the true driver is possible"


def test_a_step_that_shows_distraction_by_hand():
    # v_0 shows nothing. In step 1 they want something else and v stays: d_1 = 1.
    teams = standing_teams(1, driver=Driver("asleep", 1.0, 0.0, 0.0, 1.0), ai_sees_attention=False)
    teams.reset(seeds(1))
    evidence = ChainEvidence(["lisa", "bart"], teams.config)
    intents, alerts = np.array([[1], [3], [3]]), np.zeros((3, 1), np.int64)
    found = [evidence.observe(seen, EVERY)[0] for seen in turns(teams, intents, alerts)]
    assert found[0].tolist() == [0, 0]
    np.testing.assert_allclose(found[1], 0, atol=1e-12)
    lisa, bart = 0.2 * 0.2 + 0.8 * 0.2, 0.8 * 0.8 + 0.2 * 0.8
    np.testing.assert_allclose(np.exp(found[2]), [lisa, bart])


def test_an_impossible_candidate_is_excluded_and_followed_on():
    teams = standing_teams(1, driver=Driver("asleep", 1.0, 0.0, 0.0, 1.0), ai_sees_attention=False)
    teams.reset(seeds(1))
    awake = Driver("awake", 0.0, 1.0, 0.0, 1.0)
    evidence = ChainEvidence([awake], teams.config)
    intents = np.array([[1], [3], [1], [1]])
    found = []
    for seen in turns(teams, intents, np.zeros((4, 1), np.int64)):
        found.append(evidence.observe(seen, EVERY)[0, 0])
        if len(found) == 3:
            assert evidence.filter.distracted[0, 0] == 1.0, "which was plain"
    assert found == [0.0, 0.0, -np.inf, 0.0]


def test_drivers_who_differ_in_inflation_alone_are_one_chain():
    bart, lisa = DRIVERS["bart"], DRIVERS["lisa"]
    calm = Driver("calm", *bart.traits[:3], inflation=1.0)
    different, alike = chains([bart, lisa, calm, lisa])
    assert len(different) == 2
    assert [different[k].traits[:3] for k in alike] == [
        driver.traits[:3] for driver in (bart, lisa, calm, lisa)
    ]
    teams = standing_teams(1, driver="bart", ai_sees_attention=False)
    teams.reset(seeds(1))
    evidence, found = ChainEvidence([bart, lisa, calm, lisa], teams.config), np.zeros(4)
    for seen in turns(teams, any_intents(20, 1), any_alerts(20, 1)):
        found += evidence.observe(seen, EVERY)[0]
    assert found[0] == found[2] != found[1] == found[3]


def watched(evidence, teams, steps=12, seed=0):
    """Evidence of a trip, shape (T, N, K)."""
    count = teams.num_teams
    seen = turns(teams, any_intents(steps, count, seed), any_alerts(steps, count, seed=seed + 1))
    return np.array([evidence.observe(each, ~teams.over) for each in seen])


def test_a_turn_that_is_not_new_changes_nothing():
    teams, other = (standing_teams(3, driver="bart", ai_sees_attention=False) for _ in range(2))
    evidence, once = (ChainEvidence(FOUR, teams.config) for _ in range(2))
    for each in (evidence, once):
        each.reset(3)
    for each in (teams, other):
        each.reset(seeds(3))
    intents, alerts = any_intents(15, 3), any_alerts(15, 3)
    pairs = zip(turns(teams, intents, alerts), turns(other, intents, alerts), strict=True)
    for seen, same in pairs:
        np.testing.assert_array_equal(
            evidence.observe(seen, np.ones(3, np.bool_)), once.observe(same, np.ones(3, np.bool_))
        )
        for _ in range(2):
            assert not evidence.observe(seen, np.zeros(3, np.bool_)).any()
    assert once.filter.log_evidence.any()
    np.testing.assert_array_equal(evidence.filter.log_evidence, once.filter.log_evidence)


def test_a_new_trip_begins_attention_anew_where_there_is_one():
    teams = standing_teams(2, driver="bart", ai_sees_attention=False)
    evidence = ChainEvidence(FOUR, teams.config)
    evidence.reset(2)
    teams.reset(seeds(2))
    first = watched(evidence, teams)
    kept = evidence.filter.distracted[1].copy()
    accepted, counter = evidence.filter.accepted.copy(), evidence.filter.counter.copy()
    assert accepted.any()
    evidence.begin(np.array([True, False]))
    assert evidence.filter.distracted[0].tolist() == [0.0] * 4
    assert (evidence.filter.accepted[0], evidence.filter.counter[0]) == (0, 0)
    np.testing.assert_array_equal(evidence.filter.distracted[1], kept)
    assert (evidence.filter.accepted[1], evidence.filter.counter[1]) == (accepted[1], counter[1])
    evidence.begin(np.ones(2, np.bool_))
    teams.reset(seeds(2))
    np.testing.assert_array_equal(watched(evidence, teams), first)


def test_the_evidence_of_a_team_is_the_same_alone_and_among_many():
    teams, alone = (standing_teams(n, driver="homer", ai_sees_attention=False) for n in (5, 1))
    evidence, of_one = (ChainEvidence(FOUR, teams.config) for _ in range(2))
    evidence.reset(5)
    teams.reset(seeds(5))
    alone.reset(seeds(1, 3))
    intents, alerts = any_intents(15, 5), any_alerts(15, 5)
    many = [evidence.observe(s, np.ones(5, np.bool_))[3] for s in turns(teams, intents, alerts)]
    one = [of_one.observe(s, EVERY)[0] for s in turns(alone, intents[:, 3:4], alerts[:, 3:4])]
    assert np.any(many)
    np.testing.assert_array_equal(many, one)


def test_i_and_c_are_those_of_the_alerts_that_were_given_whoever_gave_them():
    teams = standing_teams(4, driver="homer", ai_sees_attention=False)
    evidence, hmi = ChainEvidence(["bart"], teams.config), BeliefAlert("homer", teams.config)
    evidence.reset(4)
    for each in (teams, hmi):
        each.reset(seeds(4))
    for seen in turns(teams, any_intents(40, 4), hmi.act):
        before = teams.attention
        evidence.observe(seen, np.ones(4, np.bool_))
        np.testing.assert_array_equal(evidence.filter.accepted, before.accepted)
        np.testing.assert_array_equal(evidence.filter.counter, before.counter)
    assert before.accepted.any()


def test_candidates_and_alerts_that_it_cannot_do_are_refused():
    with pytest.raises(ValueError, match="at least one candidate"):
        ChainEvidence([], TeamConfig())
    with pytest.raises(TypeError, match="candidates are a list of drivers, not 'bart'"):
        ChainEvidence("bart", TeamConfig())
    with pytest.raises(ValueError, match="the exact evidence of the chain"):
        ChainEvidence(["bart"], TeamConfig(alert_strengths=(0.5, 1.0)))
