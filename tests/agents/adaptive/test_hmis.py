import numpy as np
import pytest
from evidence_models import (
    HIDDEN,
    any_intents,
    drawn,
    hidden_card,
    seeds,
    turns,
    untrained_evidence,
)
from standing_world import CrashingWorld, standing_teams

from hmi_marl.agents import make_hmi
from hmi_marl.agents.adaptive.hmis import CAUTION, ChoosingHMI, ConditionedHMI, ExpectedValueHMI
from hmi_marl.agents.adaptive.trait_estimator import TraitEstimator
from hmi_marl.agents.hmis import BeliefAlert
from hmi_marl.agents.learned.policy import LearnedPolicy
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import DRIVERS, PAPER_DRIVERS, Driver, Traits
from hmi_marl.envs.rewards import RewardWeights
from hmi_marl.envs.seats import Policy
from hmi_marl.envs.teaming import Teaming
from hmi_marl.exact.evidence import ChainEvidence
from hmi_marl.exact.hidden_attention import GRID, solve_belief

FOUR = tuple(DRIVERS[name] for name in PAPER_DRIVERS)
CONFIG = TeamConfig(driver=PAPER_DRIVERS, ai_sees_attention=False)
COUNT, STEPS = 12, CONFIG.horizon


def estimator(drivers=FOUR, prior=None, **settings):
    return TraitEstimator(ChainEvidence(drivers, CONFIG), CONFIG, prior, **settings)


def sure_of(name):
    """An estimator that no evidence can move."""
    return estimator(prior=[driver.name == name for driver in FOUR])


def episode(hmi, first=0, begin=None):
    """(alerts, v) of shape (T, N) of one episode with crashes; everything else but the HMI same."""
    teams = Teaming(CONFIG, COUNT, CrashingWorld(CONFIG.scene, COUNT))
    teams.reset(seeds(COUNT, first))
    (begin or hmi.reset)(seeds(COUNT, first))
    alerts, applied = [], []

    def act(seen):
        alerts.append(np.where(teams.over, 0, hmi.act(seen)))
        return alerts[-1]

    for _ in turns(teams, any_intents(STEPS, COUNT), act):
        applied.append(teams.applied)
    assert len(set(teams.steps.tolist())) > 3, "some of which end early"
    return np.array(alerts), np.array(applied)


def assert_same_episodes(one, other):
    for first in (0, 100):
        for mine, theirs in zip(episode(one, first), episode(other, first), strict=True):
            np.testing.assert_array_equal(mine, theirs)


@pytest.fixture(autouse=True)
def standing_crashes_are_rare(monkeypatch):
    """A hundredth instead of a tenth of the steps."""
    from standing_world import uniform

    monkeypatch.setattr("standing_world.uniform", lambda *words: 10 * uniform(*words))


# By expected value.


# Not for marge, with whom an alert in the last step may be worth just as much as none.
@pytest.mark.parametrize("name", ["lisa", "bart", "homer", "average"])
def test_with_one_candidate_it_is_the_rule_for_them(name):
    hmi = ExpectedValueHMI(estimator([DRIVERS[name]]), CONFIG, caution=0.0)
    assert isinstance(hmi, Policy)
    assert_same_episodes(hmi, make_hmi(f"belief:{name}", CONFIG))


@pytest.mark.parametrize("caution", [0.0, CAUTION, 1e9])
def test_a_sure_belief_plays_the_rule_for_whom_it_is_sure_of_whatever_the_caution(caution):
    hmi = ExpectedValueHMI(sure_of("bart"), CONFIG, 0.2, caution)
    hmi.estimator.change_rate = 0.0
    assert_same_episodes(hmi, make_hmi("belief:bart:0.2", CONFIG))


def test_with_all_caution_it_does_what_the_hmi_for_the_average_driver_does():
    hmi = ExpectedValueHMI(estimator(), CONFIG, caution=1e9)
    average = make_hmi("belief:average", CONFIG)
    assert_same_episodes(hmi, average)
    bold = ExpectedValueHMI(estimator(), CONFIG, caution=0.0)
    assert (episode(bold)[0] != episode(average)[0]).any()


@pytest.mark.parametrize("caution", [0.0, 0.5, 2.0])
def test_it_deviates_exactly_where_the_gain_outweighs_the_doubt(caution):
    drivers = (*FOUR, Driver("calm", *DRIVERS["bart"].traits[:3], inflation=1.0))
    weights = np.array([0.3, 0.1, 0.1, 0.2, 0.3])
    watching = estimator(drivers, weights)
    hmi = ExpectedValueHMI(watching, CONFIG, 0.3, caution)
    average = make_hmi("belief:average", CONFIG)
    minds = [make_hmi(f"belief:{driver.name}", CONFIG) for driver in drivers[:4]]
    advantages = [solve_belief(driver, 7, 100, RewardWeights(), 0.3).advantage for driver in FOUR]
    count = 6
    teams = standing_teams(count, driver=PAPER_DRIVERS, ai_sees_attention=False)
    for each in (teams, hmi, average, *minds):
        each.reset(seeds(count))
    grid, deviated, layout = np.linspace(0, 1, GRID), 0, teams.layouts["vehicle_ai"]
    for t, seen in enumerate(turns(teams, any_intents(60, count), hmi.act)):
        usual, alerts = average.act(seen), hmi.act(seen)  # asked before the team asks again
        for mind in minds:
            mind.act(seen)
        applied = layout.chosen(seen, "applied_action")
        reveals = (applied >= 0) & (layout.chosen(seen, "intended_action") != applied)
        for n in range(count):
            gains = []
            for mind, advantage in zip(minds, advantages, strict=True):
                i, c = teams.attention.accepted[n], teams.attention.counter[n]
                values = advantage[t, int(reveals[n]), :, i, c]
                gains.append(np.interp(mind.belief[n], grid, values) * (1 - 2 * usual[n]))
            gains.append(gains[2])  # who only sees less differently
            p = watching.belief.probabilities[n]
            mean = float(p @ gains)
            who = np.append(p[:2], [p[2] + p[4], p[3]])  # whom alerts can be for
            doubt = -(who @ np.log(who, out=np.zeros(4), where=who > 0)) / np.log(4)
            doubt *= caution * np.sqrt(max(0.0, float(p @ np.square(gains)) - mean**2))
            if abs(mean - doubt) > 1e-6:
                assert (alerts[n] != usual[n]) == (mean > doubt)
            deviated += int(alerts[n] != usual[n])
    assert deviated > 0


def test_caution_below_0_is_refused():
    for caution in (-0.1, np.nan):
        with pytest.raises(ValueError, match=r"caution lies in .*, but got"):
            ExpectedValueHMI(estimator(), CONFIG, caution=caution)


# By type.


def choosing(watching):
    return ChoosingHMI(watching, [BeliefAlert(driver, CONFIG) for driver in FOUR])


@pytest.mark.parametrize("name", PAPER_DRIVERS)
def test_whoever_is_likeliest_has_their_hmi_act(name):
    assert_same_episodes(choosing(sure_of(name)), make_hmi(f"belief:{name}", CONFIG))


def test_the_choice_follows_the_belief_and_all_have_been_watching():
    hmi, chosen = choosing(estimator()), set()
    alone = [BeliefAlert(driver, CONFIG) for driver in FOUR]
    teams = standing_teams(COUNT, driver=PAPER_DRIVERS, ai_sees_attention=False)
    for each in (teams, hmi, *alone):
        each.reset(seeds(COUNT))
    for seen in turns(teams, any_intents(40, COUNT), hmi.act):
        alerts = np.stack([each.act(seen) for each in alone])
        given = hmi.act(seen)
        likeliest = hmi.estimator.belief.probabilities.argmax(axis=1)
        np.testing.assert_array_equal(given, alerts[likeliest, np.arange(COUNT)])
        chosen |= set(likeliest.tolist())
        for mind in hmi.hmis:
            # i and c go by the alerts that were given, not by those it would have given itself
            np.testing.assert_array_equal(mind._attention.filter.accepted, teams.attention.accepted)
            np.testing.assert_array_equal(mind._attention.filter.counter, teams.attention.counter)
    assert chosen == {0, 1, 2, 3}
    assert (alerts != alerts[0]).any(), "they disagree"


def test_every_candidate_needs_an_hmi():
    with pytest.raises(ValueError, match="4 candidates need an HMI each, but got 3"):
        ChoosingHMI(estimator(), [make_hmi("never", CONFIG)] * 3)


# Conditioned on z.


def conditioned(watching, latents, seed=3):
    card = hidden_card(CONFIG, context=2 * latents.shape[1])
    weights = drawn(card.shapes, seed)
    weights["layer1.bias"] *= 0
    weights["layer0.weight"][:, -card.context :] *= 5
    return ConditionedHMI(watching, LearnedPolicy(card, weights, CONFIG), latents)


def test_it_acts_on_the_z_that_is_expected_and_on_how_uncertain_it_is():
    latents = untrained_evidence(CONFIG).expected(Traits.of(FOUR))[:, :3]
    hmi, twin = (conditioned(estimator(), latents) for _ in range(2))
    policy = twin.policy
    teams = standing_teams(COUNT, driver=PAPER_DRIVERS, ai_sees_attention=False)
    for each in (teams, hmi, policy):
        each.reset(seeds(COUNT))
    alerts = []

    def act(seen):
        alerts.append(hmi.act(seen))
        p = hmi.estimator.belief.probabilities
        z = p @ latents
        apart = latents - z[:, None]
        spread = np.sqrt((p[..., None] * apart**2).sum(axis=1))
        context = np.concatenate([z, spread], axis=1)
        np.testing.assert_allclose(hmi.policy.context, context, rtol=1e-4, atol=1e-4)
        policy.context = hmi.policy.context
        np.testing.assert_array_equal(alerts[-1], policy.act(seen))
        return alerts[-1]

    for _ in turns(teams, any_intents(30, COUNT), act):
        pass
    assert np.ptp(hmi.policy.context, axis=0).min() > 0.01
    assert 0.05 < np.mean(alerts) < 0.95


def test_latents_that_do_not_fit_are_refused():
    latents = np.zeros((4, 3))
    conditioned(estimator(), latents)
    for wrong in (np.zeros((3, 3)), np.zeros((4, 2)), np.zeros(4)):
        hmi = conditioned(estimator(), latents)
        with pytest.raises(ValueError, match=r"need latents of shape \(4, 3\), but got"):
            ConditionedHMI(estimator(), hmi.policy, wrong)
    for context in (0, 3):
        card = hidden_card(CONFIG, context=context)
        other = LearnedPolicy(card, drawn(card.shapes), CONFIG)
        with pytest.raises(ValueError, match=f"conditioned on {context} numbers, mean and stand"):
            ConditionedHMI(estimator(), other, np.zeros((4, context // 2)))


# From trip to trip.

MAKE = {
    "expected": lambda: ExpectedValueHMI(estimator(), CONFIG),
    "choosing": lambda: choosing(estimator()),
    "conditioned": lambda: conditioned(
        estimator(), 3 * np.random.default_rng(0).standard_normal((4, 3))
    ),
}


@pytest.mark.parametrize("kind", MAKE)
def test_drivers_are_known_on_the_next_trip_and_forgotten_by_a_reset(kind):
    hmi = MAKE[kind]()
    stranger = episode(hmi)
    learned = hmi.estimator.belief.probabilities.copy()
    hmi.next_trip(seeds(COUNT))
    np.testing.assert_array_equal(hmi.estimator.belief.probabilities, learned)
    acquainted = episode(hmi, begin=hmi.next_trip)
    assert (acquainted[0] != stranger[0]).any()
    again = episode(hmi)
    np.testing.assert_array_equal(again, stranger)
    fresh = episode(MAKE[kind]())
    np.testing.assert_array_equal(fresh, stranger)


@pytest.mark.parametrize("known", [False, True])
@pytest.mark.parametrize("kind", MAKE)
def test_some_teams_may_begin_while_others_go_on(kind, known):
    which, count, begun = np.array([True, False, True, False]), 4, 15
    intents, hmis = any_intents(45, count), [MAKE[kind]() for _ in range(3)]
    hmi, _, fresh = hmis
    settings = {"driver": PAPER_DRIVERS, "ai_sees_attention": False}
    teams, others, newer = (standing_teams(count, **settings) for _ in range(3))
    for seat, team in zip(hmis, (teams, others, newer), strict=True):
        first = 50 if seat is fresh else 0
        for each in (seat, team):
            each.reset(seeds(count, first))
    for t, intended in enumerate(intents):
        if t == begun:
            before = hmi.estimator.belief.probabilities
            teams.reset(seeds(count, 50), which)
            (hmi.next_trip if known else hmi.reset)(seeds(count, 50), which)
            after = hmi.estimator.belief.probabilities
            expected = before if known else np.full((count, 4), 0.25)
            np.testing.assert_array_equal(after[which], expected[which])
            np.testing.assert_array_equal(after[~which], before[~which])
        for seat, team in zip(hmis, (teams, others, newer), strict=True):
            if seat is not fresh or t >= begun:
                team.intend(intended)
                team.step(seat.act(team.observe("vehicle_ai")))
        np.testing.assert_array_equal(teams.alerted[~which], others.alerted[~which])
        if t >= begun and not known:
            np.testing.assert_array_equal(teams.alerted[which], newer.alerted[which])
            belief = fresh.estimator.belief.probabilities
            np.testing.assert_allclose(hmi.estimator.belief.probabilities[which], belief[which])


def test_hidden_attention_is_all_it_needs():
    assert not HIDDEN.ai_sees_attention
    seen = TeamConfig(driver="bart")
    with_camera = ExpectedValueHMI(TraitEstimator(ChainEvidence(FOUR, seen), seen), seen)
    teams, others = (
        standing_teams(3, driver="bart"),
        standing_teams(3, driver="bart", ai_sees_attention=False),
    )
    without = MAKE["expected"]()
    for each in (teams, others, with_camera, without):
        each.reset(seeds(3))
    intents = any_intents(30, 3)
    for _ in zip(
        turns(teams, intents, with_camera.act), turns(others, intents, without.act), strict=True
    ):
        np.testing.assert_array_equal(teams.alerted, others.alerted)
