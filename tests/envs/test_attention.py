import itertools
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hmi_marl.envs import attention
from hmi_marl.envs.attention import Attention, check_window, transition_matrix
from hmi_marl.envs.drivers import DRIVERS, Driver, Traits
from hmi_marl.envs.streams import Stream, uniform

WINDOWS = (1, 2, 3, 7)
ALL_DRIVERS = tuple(DRIVERS.values())


def by_hand(driver, window, alert, d, i, c):
    """{(d', i', c'): probability}, from the paper's relations case by case, in fractions."""
    beta, alpha, eta = (Fraction(str(trait)) for trait in driver.traits[:3])
    if i == 0:
        new_i, new_c = (1, 0) if alert else (0, 0)
    elif alert:
        new_i, new_c = 1, 0
    else:
        new_c = (c + 1) % window
        new_i = 1 if c < window - 1 else 0
    if d == 0:
        p_distracted = max(Fraction(0), beta - (eta if new_i == 1 else 0))
    else:
        p_distracted = 1 - min(Fraction(1), alpha + (eta if new_i == 1 else 0))
    return {(1, new_i, new_c): p_distracted, (0, new_i, new_c): 1 - p_distracted}


@pytest.mark.parametrize("window", WINDOWS)
@pytest.mark.parametrize("driver", ALL_DRIVERS, ids=lambda driver: driver.name)
def test_every_transition_is_the_papers(driver, window):
    matrix = transition_matrix(driver, window)
    assert matrix.shape == (2, 2, 2, window, 2, 2, window)
    for alert, d, i, c in itertools.product((0, 1), (0, 1), (0, 1), range(window)):
        expected = np.zeros((2, 2, window))
        for (new_d, new_i, new_c), probability in by_hand(driver, window, alert, d, i, c).items():
            expected[new_d, new_i, new_c] = float(probability)
        np.testing.assert_allclose(matrix[alert, d, i, c], expected, rtol=0, atol=1e-15)


def test_homer_after_an_alert_by_hand():
    # β 0.8, α 0.2, η 1: while an alert is in effect, never distracted for long.
    matrix = transition_matrix(DRIVERS["homer"], 7)
    assert matrix[1, 1, 0, 0, 0, 1, 0] == 1.0  # min(1, 0.2 + 1)
    assert matrix[0, 0, 1, 5, 0, 1, 6] == 1.0  # max(0, 0.8 - 1), last step of the window
    assert matrix[0, 0, 1, 6, 1, 0, 0] == 0.8  # the window is over
    assert matrix[0, 1, 0, 0, 1, 0, 0] == 0.8


def test_a_window_of_one_step_helps_in_the_step_of_the_alert_alone():
    i, c = attention.next_acceptance([0, 1], [0, 0], [1, 0], 1)
    assert i.tolist() == [1, 0]
    assert c.tolist() == [0, 0]


def test_an_alert_lasts_for_exactly_the_window():
    i, c = np.array(0), np.array(0)
    lasted = []
    for alert in (1, 0, 0, 0, 0, 0, 0, 0, 0):
        i, c = attention.next_acceptance(i, c, alert, 4)
        lasted.append((int(i), int(c)))
    assert lasted == [(1, 0), (1, 1), (1, 2), (1, 3), (0, 0), (0, 0), (0, 0), (0, 0), (0, 0)]


@pytest.mark.parametrize("driver", ALL_DRIVERS, ids=lambda driver: driver.name)
def test_a_million_draws_keep_to_the_matrix(driver):
    window, count = 3, 1_000_000
    matrix = transition_matrix(driver, window)
    states = np.array(list(itertools.product((0, 1), (0, 1), (0, 1), range(window))))
    alert, d, i, c = states[np.arange(count) % len(states)].T
    draws = uniform(np.arange(count, dtype=np.uint64), Stream.ATTENTION, 3)
    traits = Traits.from_array(np.tile(driver.traits, (count, 1)))
    after = attention.step(Attention(d, i, c, np.zeros_like(d)), alert, traits, window, draws)
    seen = np.zeros_like(matrix)
    np.add.at(seen, (alert, d, i, c, after.distracted, after.accepted, after.counter), 1)
    visits = seen.sum(axis=(-3, -2, -1), keepdims=True)
    standard_error = np.sqrt(matrix * (1 - matrix) / visits)
    assert np.all(np.abs(seen / visits - matrix) <= 4 * standard_error + 1e-12)


@given(
    beta=st.floats(0, 1),
    alpha=st.floats(0, 1),
    eta=st.floats(0, 1),
    window=st.integers(1, 9),
)
def test_the_matrix_is_a_distribution_and_alerts_never_harm(beta, alpha, eta, window):
    matrix = transition_matrix(Driver("any", beta, alpha, eta, 1.0), window)
    assert np.all(matrix >= 0)
    np.testing.assert_allclose(matrix.sum(axis=(-3, -2, -1)), 1.0, atol=1e-12)
    p_distracted = matrix[..., 1, :, :].sum(axis=(-2, -1))
    assert np.all(p_distracted[1] <= p_distracted[0] + 1e-12)


@given(st.integers(1, 6), st.lists(st.booleans(), min_size=1, max_size=40), st.integers(0, 99))
def test_the_chain_stays_in_range(window, alerts, seed):
    state = Attention.initial(1)
    traits = Traits.of([DRIVERS["bart"]])
    for step, alert in enumerate(alerts):
        draw = uniform(np.array([seed], np.uint64), Stream.ATTENTION, step)
        state = attention.step(state, np.array([int(alert)]), traits, window, draw)
        assert state.distracted[0] in (0, 1)
        assert state.accepted[0] in (0, 1)
        assert 0 <= state.counter[0] < window
        assert state.accepted[0] == 1 or state.counter[0] == 0


@pytest.mark.parametrize(("window", "error"), [(0, ValueError), (-3, ValueError), (2.5, TypeError)])
def test_a_bad_window_is_refused(window, error):
    with pytest.raises(error, match="alert_window"):
        check_window(window)
