"""Tests of what the model assumes: right size, and power against planted violations."""

import numpy as np
import pytest
from people.measure.made_up import walk

from hmi_marl.people.measure.assumptions import check_assumptions, dwell_rows, effect_rows, holm
from hmi_marl.people.measure.steps import chain_steps

NAMES = ["dwell_attentive", "dwell_away", "constant_effect", "one_effect"]


def weibull(shape):
    """Chances that change with the time in the state."""

    def change(chance, age, away, accepted, counter):
        leaves = np.where(away == 1, 1 - chance, chance)
        leaves = 1 - (1 - leaves) ** (shape * (age / 5) ** (shape - 1))
        return np.where(away == 1, 1 - leaves, leaves)

    return change


def fades(chance, age, away, accepted, counter):
    """An alert that helps most at first: from β = 0.3, α = 0.2, to 0 after the window."""
    help_given = 0.3 * np.clip(1 - counter / 6, 0, 1) * accepted
    return np.where(away == 1, 1 - np.minimum(1, 0.2 + help_given), np.maximum(0, 0.3 - help_given))


def rejected(trips, seed=0):
    return {test.name for test in check_assumptions(chain_steps(trips, 7), seed) if test.rejected}


def test_holm_by_hand():
    assert holm([0.01, None, 0.04, 0.03]) == pytest.approx([0.03, None, 0.06, 0.06])
    assert holm([0.5, 0.9]) == pytest.approx([1.0, 1.0])
    assert holm([None]) == [None]


def test_what_was_not_seen_is_not_tested():
    tests = check_assumptions(chain_steps([([0] * 20, [0] * 20)], 7))
    assert [(test.name, test.p, test.rejected) for test in tests] == [
        (name, None, False) for name in NAMES
    ]


def test_steps_by_dwell_time_and_by_step_since_the_alert():
    steps = chain_steps([([0, 1, 1, 0, 0, 1], [0, 0, 0, 0, 1, 0])], window=2)
    assert [each.tolist() for each in dwell_rows(steps, 0)] == [[1, 2], [1, 1], [0, 1]]
    assert [each.tolist() for each in dwell_rows(steps, 1)] == [[1, 2], [1, 1], [0, 1]]
    assert [each.tolist() for each in effect_rows(steps, 0)] == [[0, 1], [1, 1], [0, 1]]


def test_a_regular_person_is_not_memoryless():
    """Away for exactly 3 steps, at the road for exactly 5."""
    pattern = ([0] * 5 + [1] * 3) * 12
    tests = check_assumptions(chain_steps([(pattern, [0] * len(pattern))], 7))
    by_name = {test.name: test for test in tests}
    assert by_name["dwell_attentive"].rejected
    assert by_name["dwell_away"].rejected
    assert by_name["dwell_attentive"].trend > 0


def test_planted_violations_are_noticed():
    rng = np.random.default_rng(1)
    late = walk(0.1, 0.2, 0.1, 30, rng, change=weibull(2.0))
    assert {"dwell_attentive", "dwell_away"} <= rejected(late)
    tests = {
        test.name: test
        for test in check_assumptions(chain_steps(walk(0.3, 0.2, 0.0, 30, rng, change=fades), 7))
    }
    assert tests["constant_effect"].rejected
    assert tests["constant_effect"].trend < 0


def test_two_different_effects_are_noticed():
    """An alert that brings back those who look away, and keeps nobody from it."""

    def only_back(chance, age, away, accepted, counter):
        return np.where(away == 1, chance, 0.2)

    trips = walk(0.2, 0.3, 0.4, 30, np.random.default_rng(2), change=only_back)
    assert "one_effect" in rejected(trips)


def test_results_depend_on_the_seed_alone():
    steps = chain_steps(walk(0.1, 0.2, 0.1, 5, np.random.default_rng(3)), 7)
    assert check_assumptions(steps, 4) == check_assumptions(steps, 4)


@pytest.mark.slow
@pytest.mark.parametrize("traits", [(0.2, 0.8, 0.01), (0.8, 0.2, 1.0), (0.05, 0.2, 0.1)])
def test_persons_as_assumed_are_rarely_rejected(traits):
    """At most 5 % of 200 in any of the tests, give or take: above 20 has a chance of 0.1 %."""
    rng = np.random.default_rng(5)
    wrong = sum(bool(rejected(walk(*traits, 15, rng), person)) for person in range(200))
    assert wrong <= 20


@pytest.mark.slow
def test_planted_violations_are_noticed_in_most_persons():
    """In at least 90 % of 50 persons after 10 minutes."""
    rng = np.random.default_rng(6)
    found = {"dwell_attentive": 0, "constant_effect": 0}
    for person in range(50):
        late = walk(0.1, 0.2, 0.1, 30, rng, change=weibull(2.0))
        fading = walk(0.3, 0.2, 0.0, 30, rng, change=fades)
        found["dwell_attentive"] += "dwell_attentive" in rejected(late, person)
        found["constant_effect"] += "constant_effect" in rejected(fading, person)
    assert min(found.values()) >= 45, found
