import itertools
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hmi_marl.envs import attention
from hmi_marl.envs.alerts import PLAIN, Alerts, Fatigue, check_strengths, need_plain
from hmi_marl.envs.attention import Attention, successors
from hmi_marl.envs.drivers import DRIVERS, Driver, Traits

GRADED = Alerts((0.25, 0.5, 1.0))
WEARY = Alerts((0.25, 0.5, 1.0), Fatigue(levels=6, per_alert=3, effect=0.5))
MONA = Driver("mona", beta=0.4, alpha=0.3, eta=0.5, inflation=2.0)

strength_sets = st.sets(st.sampled_from([k / 20 for k in range(1, 21)]), min_size=1, max_size=5)
fatigues = st.builds(Fatigue, st.integers(1, 9), st.integers(1, 12), st.floats(0, 1))
some_alerts = st.builds(
    lambda strengths, fatigue: Alerts(tuple(sorted(strengths)), fatigue),
    strength_sets,
    st.none() | fatigues,
)


def test_the_default_is_the_papers_one_bit():
    assert Alerts() == PLAIN
    assert (PLAIN.choices, PLAIN.strongest, PLAIN.levels, PLAIN.plain) == (2, 1, 0, True)
    assert PLAIN.shape(7) == (2, 2, 7)
    assert PLAIN.help([0, 1], 0).tolist() == [0.0, 1.0]
    assert PLAIN.next_fatigue([0, 0], [1, 0]).tolist() == [0, 0]
    assert not Alerts((0.5,)).plain
    assert not Alerts(fatigue=Fatigue()).plain


def test_shapes_count_alerts_and_levels():
    assert (GRADED.choices, GRADED.strongest) == (4, 3)
    assert GRADED.shape(5) == (2, 4, 5)
    assert WEARY.shape(5) == (2, 4, 5, 7)


def test_help_by_hand():
    # Strength 0.5 at level 3 of 6, where half of all is lost at most: 0.5 (1 - 0.5 * 3 / 6).
    assert WEARY.help(2, 3) == 0.375
    assert WEARY.help([0, 1, 3, 3], [6, 0, 0, 6]).tolist() == [0.0, 0.25, 1.0, 0.5]
    assert GRADED.help([0, 1, 2, 3], 0).tolist() == [0.0, 0.25, 0.5, 1.0]


def test_weariness_by_hand():
    # 3 levels for strength 1, so 1.5 for 0.5 and 0.75 for 0.25: rounded up 3, 2 and 1.
    level, seen = 0, []
    for alert in (3, 0, 2, 1, 3, 0, 0, 3):
        level = int(WEARY.next_fatigue(level, alert))
        seen.append(level)
    assert seen == [3, 2, 4, 5, 6, 5, 4, 6]
    assert int(WEARY.next_fatigue(0, 0)) == 0


def test_rises_are_not_off_by_one_where_floats_are():
    assert 100 * 0.07 > 7  # 7.000000000000001
    tired = Alerts((0.07, 1.0), Fatigue(levels=200, per_alert=100))
    assert int(tired.next_fatigue(0, 1)) == 7


def test_what_an_alert_does_is_weakened_by_the_alerts_before_it():
    # Mona is tired at level 6 of 6 and half the help is lost; the alert of this step counts later.
    traits = Traits.of([MONA, MONA])
    before = Attention(*np.array([[1, 1], [0, 0], [0, 0], [0, 6]]))
    chances = np.array([0.2, 0.2])  # p(d = 1) is 1 - (0.3 + 0.5) = 0.2 fresh, 0.45 tired
    after = attention.step(before, np.array([3, 3]), traits, 7, chances, WEARY)
    assert after.distracted.tolist() == [0, 1]
    assert after.accepted.tolist() == [3, 3]
    assert after.fatigue.tolist() == [3, 6]
    tired = attention.step(before, np.array([3, 3]), traits, 7, chances + 0.24, WEARY)
    assert tired.distracted.tolist() == [0, 1]
    tired = attention.step(before, np.array([3, 3]), traits, 7, chances + 0.26, WEARY)
    assert tired.distracted.tolist() == [0, 0]


def test_a_weaker_alert_does_not_undo_a_stronger_one():
    seen, i, c = [], 0, 0
    for alert in (2, 0, 1, 1, 0, 3, 3, 2, 1, 2, 0, 0, 0):
        i, c = (int(x) for x in attention.next_acceptance(i, c, alert, 3))
        seen.append((i, c))
    assert seen == [
        *[(2, 0), (2, 1), (2, 2)],  # the weaker one in its last step changes nothing
        *[(1, 0), (1, 1)],  # its window is over, so that the next weaker one is in effect
        *[(3, 0), (3, 0), (3, 1), (3, 2)],  # a stronger one takes over, an equal one restarts
        *[(2, 0), (2, 1), (2, 2), (0, 0)],
    ]


def by_hand(driver, alerts, window, alert, d, i, c, f):
    """((i', c', f'), p(d' = 1)) from the rules case by case, in fractions."""
    beta, alpha, eta = (Fraction(str(trait)) for trait in driver.traits[:3])
    strengths = [Fraction(0), *(Fraction(str(s)) for s in alerts.strengths)]
    if i > alert and c < window - 1:
        new_i, new_c = i, c + 1
    else:
        new_i, new_c = alert, 0
    help_given, new_f = eta * strengths[new_i], 0
    if alerts.fatigue:
        levels, rise = alerts.fatigue.levels, alerts.fatigue.per_alert * strengths[alert]
        help_given *= 1 - Fraction(str(alerts.fatigue.effect)) * Fraction(f, levels)
        new_f = min(levels, f + -(-rise // 1)) if alert else max(0, f - 1)
    p = max(0, beta - help_given) if d == 0 else 1 - min(1, alpha + help_given)
    return (new_i, new_c, new_f), p


@pytest.mark.parametrize("alerts", [PLAIN, GRADED, WEARY], ids=["plain", "graded", "weary"])
@pytest.mark.parametrize("window", [1, 3])
@pytest.mark.parametrize("driver", [*DRIVERS.values(), MONA], ids=lambda driver: driver.name)
def test_every_successor_is_that_of_the_rules(driver, window, alerts):
    after = successors(driver, window, alerts)
    assert after.distracted.shape == (alerts.choices, *alerts.shape(window))
    for place in itertools.product(*map(range, after.distracted.shape)):
        alert, d, i, c, *level = place
        if i == 0 and c > 0:
            continue  # never comes about, and the rules say nothing of it
        f = level[0] if level else 0
        known, p = by_hand(driver, alerts, window, alert, d, i, c, f)
        assert (after.accepted[place], after.counter[place], after.fatigue[place]) == known
        assert after.distracted[place] == pytest.approx(float(p), abs=1e-15)


@given(some_alerts, st.integers(0, 9))
def test_no_alert_does_not_help_and_weariness_never_helps_more(alerts, level):
    level = min(level, alerts.levels)
    every = np.arange(alerts.choices)
    helped = alerts.help(every, level)
    assert helped[0] == 0
    assert np.all((helped >= 0) & (helped <= alerts.strength(every)))
    assert np.all(np.diff(helped) >= 0)
    np.testing.assert_array_equal(alerts.help(every, 0), (0.0, *alerts.strengths))


@given(some_alerts, st.lists(st.integers(0, 5), max_size=30))
def test_the_level_stays_in_range_and_rests_again(alerts, choices):
    level = np.zeros((), np.int64)
    for choice in choices:
        alert = min(choice, alerts.strongest)
        following = alerts.next_fatigue(level, alert)
        assert 0 <= following <= alerts.levels
        assert following >= level if alert else following == max(0, level - 1)
        level = following
    for _ in range(alerts.levels):
        level = alerts.next_fatigue(level, 0)
    assert level == 0


@given(some_alerts)
def test_a_strength_is_known_again_in_single_precision(alerts):
    every = np.arange(alerts.choices)
    shown = alerts.strength(every).astype(np.float32)
    assert alerts.nearest(shown).tolist() == every.tolist()


@pytest.mark.parametrize("strengths", [[0.5, 1], np.array([0.5, 1.0]), (np.float32(0.5), 1)])
def test_strengths_become_a_tuple_of_floats(strengths):
    checked = check_strengths(strengths)
    assert checked == (0.5, 1.0)
    assert all(type(strength) is float for strength in checked)


@pytest.mark.parametrize(
    "strengths",
    [(), (0.0, 1.0), (0.5, 0.5), (1.0, 0.5), (0.5, 1.1), (-0.5,), (float("nan"),)],
    ids=str,
)
def test_strengths_that_do_not_rise_within_0_and_1_are_refused(strengths):
    with pytest.raises(ValueError, match=r"alert_strengths (rise within|lies in) \(0, 1\]"):
        Alerts(strengths)


def test_too_many_strengths_are_refused():
    with pytest.raises(ValueError, match="at most 100 alert_strengths, not 101"):
        Alerts(tuple(np.linspace(0.001, 1, 101)))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Alerts(0.5), "a tuple of numbers, not 0.5"),
        (lambda: Alerts("1.0"), "a tuple of numbers, not '1.0'"),
        (lambda: Alerts((True,)), "each of alert_strengths is a number, not True"),
        (lambda: Alerts(("1",)), "each of alert_strengths is a number, not '1'"),
        (lambda: Alerts(fatigue=(10, 2, 0.5)), r"fatigue is a Fatigue, not \(10, 2, 0.5\)"),
        (lambda: Fatigue(levels=2.5), "fatigue: levels is a whole number, not 2.5"),
        (lambda: Fatigue(per_alert=True), "fatigue: per_alert is a whole number, not True"),
        (lambda: Fatigue(effect="half"), "fatigue: effect is a number, not 'half'"),
    ],
)
def test_what_is_of_another_kind_is_refused_by_name(make, message):
    with pytest.raises(TypeError, match=message):
        make()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Fatigue(levels=0), "fatigue: levels lies in 1 to .*, but got 0"),
        (lambda: Fatigue(per_alert=-1), "fatigue: per_alert lies in 1 to .*, but got -1"),
        (lambda: Fatigue(effect=1.5), r"fatigue: effect lies in \[0, 1\], but got 1.5"),
        (lambda: Fatigue(effect=float("nan")), r"fatigue: effect lies in \[0, 1\]"),
        (lambda: need_plain(GRADED, "X"), "X is for alerts of one strength, 1, without fatigue"),
        (lambda: need_plain(Alerts(fatigue=Fatigue()), "X"), "X is for alerts of one strength"),
    ],
)
def test_numbers_out_of_their_range_are_refused_by_name(make, message):
    with pytest.raises(ValueError, match=message):
        make()
    need_plain(PLAIN, "X")
