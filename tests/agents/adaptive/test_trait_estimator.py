import numpy as np
import pytest
from evidence_models import (
    any_alerts,
    any_intents,
    seeds,
    trait_model,
    turns,
    untrained_evidence,
)
from hypothesis import given
from hypothesis import strategies as st
from standing_world import standing_teams

from hmi_marl.agents.adaptive.evidence_model import LearnedEvidence
from hmi_marl.agents.adaptive.trait_estimator import CHANGE_RATE, TraitEstimator
from hmi_marl.agents.hmis import BeliefAlert
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import DRIVERS, PAPER_DRIVERS, Driver, TraitDistributions, Traits
from hmi_marl.envs.observations import vehicle_ai_layout
from hmi_marl.envs.teaming import Teaming
from hmi_marl.exact.evidence import ChainEvidence

CONFIG = TeamConfig(ai_sees_attention=False)
LAYOUT = vehicle_ai_layout(CONFIG)
FOUR = tuple(DRIVERS[name] for name in PAPER_DRIVERS)


class Told:
    """Evidence as it is put down, a row of (N, K) for each turn that is asked for."""

    def __init__(self, gains, drivers=FOUR[:2]):
        self.drivers = drivers
        self.gains = iter(np.array(gains, np.float64))
        self.counts, self.forgotten, self.begun = [], [], []

    def reset(self, count, which=None):
        if which is None:
            self.counts.append(count)
        else:
            self.forgotten.append(which.tolist())

    def begin(self, which):
        self.begun.append(which.tolist())

    def observe(self, observations, new):
        return np.where(new[:, None], next(self.gains), 0.0)


def at(*steps):
    """Observations of teams that have taken so many steps."""
    seen = np.zeros((len(steps), LAYOUT.size), np.float32)
    seen[:, LAYOUT["time"]] = np.array(steps, np.float32)[:, None] / 100
    return seen


def believed(gains, prior=None, rate=0.0):
    """Beliefs of one team about two candidates after each turn, shape (T, 2)."""
    estimator = TraitEstimator(Told([[g] for g in gains]), CONFIG, prior, rate)
    return np.array([estimator.observe(at(t)).probabilities[0] for t in range(len(gains))])


def test_bayes_rule_by_hand():
    found = believed([[np.log(0.5), np.log(0.25)], [np.log(0.1), np.log(0.9)]])
    np.testing.assert_allclose(found, [[2 / 3, 1 / 3], [2 / 11, 9 / 11]])
    found = believed([[np.log(0.5), np.log(0.25)]], prior=[1, 3])
    np.testing.assert_allclose(found, [[0.4, 0.6]])


def test_another_driver_may_take_over_by_hand():
    # (0.9 (0.8, 0.2) + 0.1 (0.5, 0.5)) = (0.77, 0.23); odds 77 : 46 after evidence 1 : 2
    found = believed([[np.log(4), 0], [0, np.log(2)]], rate=0.1)
    np.testing.assert_allclose(found, [[0.8, 0.2], [77 / 123, 46 / 123]])
    # with a prior of 1 : 3 the newcomer is drawn from it
    found = believed([[np.log(3), 0], [0, 0]], prior=[1, 3], rate=0.1)
    np.testing.assert_allclose(found, [[0.5, 0.5], [0.475, 0.525]])


def test_evidence_may_rule_a_candidate_out():
    found = believed([[0, -np.inf], [-5, 5]])
    assert found.tolist() == [[1, 0], [1, 0]]


def test_if_no_candidate_is_possible_the_belief_stays():
    found = believed([[np.log(3), 0], [-np.inf, -np.inf], [0, np.log(3)]])
    np.testing.assert_allclose(found, [[0.75, 0.25], [0.75, 0.25], [0.5, 0.5]])
    # the only candidate left is ruled out as well
    assert believed([[0, -np.inf], [-np.inf, 0]]).tolist() == [[1, 0], [1, 0]]
    # with a change rate it stays but for the change
    found = believed([[np.log(3), 0], [-np.inf, -np.inf]], rate=0.2)
    np.testing.assert_allclose(found[1], [0.8 * 0.75 + 0.1, 0.8 * 0.25 + 0.1])


def test_evidence_beyond_what_exp_can_hold_is_no_trouble():
    assert believed([[2000, 0]]).tolist() == [[1, 0]]
    np.testing.assert_allclose(believed([[-5000, -5000]]), [[0.5, 0.5]])


def test_certainty_recovers_from_a_change_of_driver_if_there_can_be_one():
    gains = [[0, -np.inf]] + [[0, 3]] * 10
    with_change, without = (believed(gains, rate=rate)[:, 1] for rate in (CHANGE_RATE, 0.0))
    assert (without == 0).all()
    assert with_change[0] == 0
    assert with_change[-1] > 0.999
    # as soon as evidence outweighs the odds of a change, 1 : 2000
    assert (with_change > 0.5).argmax() == int(np.ceil(np.log(2000) / 3))


def test_a_turn_counts_once():
    estimator = TraitEstimator(Told([[[1, 0]]] * 4), CONFIG, change_rate=0.1)
    first = estimator.observe(at(0)).probabilities
    for _ in range(2):
        np.testing.assert_allclose(estimator.observe(at(0)).probabilities, first, rtol=1e-12)
    assert abs(estimator.observe(at(1)).probabilities - first).min() > 0.01


def test_the_next_trip_keeps_the_belief_and_a_stranger_does_not():
    evidence = Told([[[1, 0]] * 3] * 3)
    estimator = TraitEstimator(evidence, CONFIG, [1, 2], change_rate=0.0)
    estimator.reset(3)
    before = estimator.observe(at(7, 7, 7)).probabilities.copy()
    estimator.next_trip(np.array([True, False, False]))
    estimator.reset(3, np.array([False, True, False]))
    np.testing.assert_array_equal(estimator.belief.probabilities[[0, 2]], before[[0, 2]])
    np.testing.assert_allclose(estimator.belief.probabilities[1], [1 / 3, 2 / 3])
    assert evidence.begun == [[True, False, False]]
    assert evidence.forgotten == [[False, True, False]]
    after = estimator.observe(at(0, 0, 7)).probabilities  # step 0 of new trips is new
    np.testing.assert_allclose(after[[2, 1]], before[[2, 0]], rtol=1e-12)
    np.testing.assert_allclose(after[0], [np.e**2 / (np.e**2 + 2), 2 / (np.e**2 + 2)])
    estimator.next_trip()
    assert evidence.begun[-1] == [True] * 3
    np.testing.assert_array_equal(estimator.belief.probabilities, after)
    estimator.reset(2)
    assert evidence.counts == [1, 3, 2]
    np.testing.assert_allclose(estimator.belief.probabilities, [[1 / 3, 2 / 3]] * 2)


def test_other_numbers_of_teams_are_refused():
    estimator = TraitEstimator(Told([]), CONFIG)
    with pytest.raises(RuntimeError, match=r"follows 1 teams, but got observations of 2: call re"):
        estimator.observe(at(0, 0))


@pytest.mark.parametrize("rate", [-0.1, 1.1, np.nan])
def test_a_rate_out_of_range_is_refused(rate):
    with pytest.raises(ValueError, match=r"change_rate lies in \[0, 1\], but got"):
        TraitEstimator(Told([]), CONFIG, change_rate=rate)


@pytest.mark.parametrize("prior", [[1, 2, 3], [-1, 2], [0, 0], [np.nan, 1]])
def test_numbers_that_are_no_prior_are_refused(prior):
    with pytest.raises(ValueError, match="a prior"):
        TraitEstimator(Told([]), CONFIG, prior)


numbers = st.floats(-30, 30)
rows = st.lists(st.tuples(numbers, numbers, numbers), min_size=1, max_size=5)


@given(gains=rows, shift=numbers, rate=st.floats(0, 1), order=st.permutations(range(3)))
def test_beliefs_are_probabilities_of_candidates_in_any_order(gains, shift, rate, order):
    gains = np.array(gains)[:, None]
    found = []
    for table, who in ((gains + shift, range(3)), (gains[..., order], order)):
        evidence = Told(table, tuple(FOUR[k] for k in who))
        estimator = TraitEstimator(evidence, CONFIG, change_rate=rate)
        for t in range(len(table)):
            last = estimator.observe(at(t))
        found.append(last.probabilities[0])
        assert (last.probabilities >= 0).all()
        assert last.probabilities.sum() == pytest.approx(1.0)
        assert last.drivers == tuple(FOUR[k] for k in who)
    np.testing.assert_allclose(found[0][list(order)], found[1], atol=1e-9)


# Real trips.


def evidence_of(kind, config):
    if kind == "exact":
        return ChainEvidence(SOFT, config)
    return LearnedEvidence(untrained_evidence(config), trait_model(), SOFT, config)


SOFT = (DRIVERS["lisa"], DRIVERS["bart"], Driver("mona", 0.4, 0.3, 0.2, 2.0))
"""For none of whom anything is impossible."""
KINDS = pytest.mark.parametrize("kind", ["exact", "learned"])


def followed(estimator, teams, intents, alerts):
    """Beliefs after each turn, shape (T, N, K)."""
    return np.array(
        [estimator.observe(seen).probabilities for seen in turns(teams, intents, alerts)]
    )


@KINDS
def test_team_k_is_believed_of_as_if_it_were_alone(kind):
    steps, count = 30, 6
    intents, alerts = any_intents(steps, count), any_alerts(steps, count)

    def play(which):
        teams = standing_teams(len(which), driver=PAPER_DRIVERS, ai_sees_attention=False)
        estimator = TraitEstimator(evidence_of(kind, teams.config), teams.config)
        estimator.reset(len(which))
        teams.reset(seeds(count)[which])
        teams.world.crash_next[:] = [k == 1 for k in which]  # in its first step
        return followed(estimator, teams, intents[:, which], alerts[:, which])

    together = play(np.arange(count))
    assert np.ptp(together, axis=0).min(axis=1).max() > 0.01
    np.testing.assert_allclose(play(np.array([4])), together[:, [4]], rtol=1e-12)
    np.testing.assert_allclose(play(np.array([5, 1, 0])), together[:, [5, 1, 0]], rtol=1e-12)


@KINDS
def test_asking_twice_in_a_turn_changes_nothing(kind):
    found = []
    for asked in (1, 3):
        teams = standing_teams(2, driver="bart", ai_sees_attention=False)
        estimator = TraitEstimator(evidence_of(kind, teams.config), teams.config)
        estimator.reset(2)
        teams.reset(seeds(2))
        for seen in turns(teams, any_intents(12, 2), any_alerts(12, 2)):
            for _ in range(asked):
                last = estimator.observe(seen).probabilities
        found.append(last)
    np.testing.assert_allclose(*found, rtol=1e-12)
    assert abs(found[0] - 1 / 3).max() > 0.05


@KINDS
def test_a_trip_that_is_over_shows_nothing_more(kind):
    teams = standing_teams(2, driver="bart", ai_sees_attention=False, duration=6.0)
    estimator = TraitEstimator(evidence_of(kind, teams.config), teams.config)
    estimator.reset(2)
    teams.reset(seeds(2))
    beliefs = []
    for t, seen in enumerate(turns(teams, any_intents(30, 2), any_alerts(30, 2))):
        beliefs.append(estimator.observe(seen).probabilities)
        teams.world.crash_next[0] = t == 9
    assert teams.steps.tolist() == [10, 30]
    # its last step is shown once, after the crash
    np.testing.assert_allclose(np.array(beliefs)[11:, 0], [beliefs[10][0]] * 19, rtol=1e-12)
    assert (beliefs[-1][1] != beliefs[10][1]).all()


@KINDS
def test_trips_of_one_driver_add_up(kind):
    # Without a change rate, log odds after two trips are those of each trip together.
    config = TeamConfig(driver="bart", ai_sees_attention=False, duration=4.0)
    odds = []

    def trip(estimator, seed):
        teams = standing_teams(1, driver="bart", ai_sees_attention=False, duration=4.0)
        teams.reset(seeds(1, seed))
        p = followed(estimator, teams, any_intents(20, 1, seed), any_alerts(20, 1, seed=seed))
        return np.log(p[-1, 0, 1:] / p[-1, 0, 0])

    for seed in (1, 2):
        odds.append(trip(TraitEstimator(evidence_of(kind, config), config, None, 0), seed))
    both = TraitEstimator(evidence_of(kind, config), config, None, 0)
    trip(both, 1)
    both.next_trip()
    np.testing.assert_allclose(trip(both, 2), odds[0] + odds[1], rtol=1e-9)
    assert np.abs(odds).min() > 1e-3


@KINDS
def test_a_new_driver_is_judged_as_in_a_first_trip(kind):
    config = TeamConfig(driver="bart", ai_sees_attention=False, duration=4.0)
    estimator, fresh = (TraitEstimator(evidence_of(kind, config), config) for _ in range(2))

    def trip(of, seed):
        teams = standing_teams(2, driver="bart", ai_sees_attention=False, duration=4.0)
        teams.reset(seeds(2, seed))
        return followed(of, teams, any_intents(20, 2, seed), any_alerts(20, 2, seed=seed))

    estimator.reset(2)
    trip(estimator, 1)
    estimator.next_trip(np.array([True, False]))
    estimator.reset(2, np.array([False, True]))
    fresh.reset(2)
    again, first = trip(estimator, 2), trip(fresh, 2)
    np.testing.assert_array_equal(again[:, 1], first[:, 1])
    assert (again[:, 0] != first[:, 0]).any(axis=1).all()
    evidence, alone = estimator.evidence, fresh.evidence
    if kind == "exact":
        of_trips, of_one = evidence.filter.log_evidence, alone.filter.log_evidence
    else:
        of_trips, of_one = evidence.encoder.sums, alone.encoder.sums
    np.testing.assert_array_equal(of_trips[1], of_one[1])
    assert (of_trips[0] != of_one[0]).any()


def calibrated(drivers, who, prior, steps=40):
    """Beliefs after some of the steps about drivers who were drawn as the prior says."""
    count = len(who)
    config = TeamConfig(ai_sees_attention=False)

    class Drawn:
        def draw(self, seeds):
            return Traits.of([drivers[k] for k in who])

    teams = standing_teams(count, driver=Drawn(), ai_sees_attention=False)
    hmi = BeliefAlert("average", config)  # alerts go by what was seen, as the evidence may not
    estimator = TraitEstimator(ChainEvidence(drivers, config), config, prior, change_rate=0.0)
    for each in (teams, hmi):
        each.reset(seeds(count))
    estimator.reset(count)
    every = list(turns_kept(teams, hmi, estimator, any_intents(steps, count)))
    return [every[t] for t in (3, steps // 2, steps - 1)]


def turns_kept(teams: Teaming, hmi, estimator, intents):
    for seen in turns(teams, intents, hmi.act):
        yield estimator.observe(seen)


def mean_is_0(excess):
    """Within four deviations."""
    return abs(excess.mean()) < 4 * excess.std() / np.sqrt(len(excess))


def test_probabilities_are_right_as_often_as_they_say():
    prior = np.array([0.4, 0.3, 0.2, 0.1])
    who = np.random.default_rng(5).choice(4, 3000, p=prior)
    shares = []
    for belief in calibrated(FOUR, who, prior):
        p = belief.probabilities
        for k in range(4):
            excess = (who == k) - p[:, k]
            assert mean_is_0(excess)
            for low, high in ((0.0, 0.1), (0.1, 0.3), (0.3, 0.6), (0.6, 1.01)):
                inside = (p[:, k] >= low) & (p[:, k] < high)
                deviation = np.sqrt((p[inside, k] * (1 - p[inside, k])).sum())
                assert abs(excess[inside].sum()) < 4 * deviation + 1
        shares.append((belief.most_likely == who).mean())
    assert shares[-1] > shares[0] + 0.1
    assert shares[-1] > 0.6


def test_means_and_spreads_are_right_in_a_continuous_population():
    table = TraitDistributions().draw(seeds(40, 9)).as_array()
    drivers = [Driver(f"k{n}", *traits) for n, traits in enumerate(table)]
    who = np.random.default_rng(6).integers(0, 40, 2000)
    for belief in calibrated(drivers, who, None):
        away = table[who] - belief.mean
        for trait in range(3):
            assert mean_is_0(away[:, trait])
            assert mean_is_0(away[:, trait] ** 2 - belief.spread[:, trait] ** 2)
    assert (belief.spread[:, 0] < 0.8 * table[:, 0].std()).mean() > 0.5, (
        "β was learned something of"
    )
