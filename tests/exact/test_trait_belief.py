import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hmi_marl.envs.drivers import DRIVERS, Driver
from hmi_marl.exact.identify import TraitBelief

LISA, MARGE, BART = (DRIVERS[name] for name in ("lisa", "marge", "bart"))
BELIEF = TraitBelief((LISA, MARGE, BART), np.array([[0.5, 0.25, 0.25], [0.0, 0.0, 1.0]]))


def test_mean_and_spread_by_hand():
    # β .2 .2 .8, α .8 .8 .2, η .01 1 .01, inflation 3 9 3
    np.testing.assert_allclose(
        BELIEF.mean, [[0.35, 0.65, 0.2575, 4.5], [0.8, 0.2, 0.01, 3.0]], atol=1e-12
    )
    spread = np.sqrt([0.25 * 0.75 * 0.36, 0.25 * 0.75 * 0.36, 3 / 16 * 0.99**2, 3 / 16 * 36])
    np.testing.assert_allclose(BELIEF.spread, [spread, np.zeros(4)], atol=1e-12)


def test_the_likeliest_is_the_first_of_equals():
    assert BELIEF.most_likely.tolist() == [0, 2]
    assert TraitBelief((LISA, MARGE), np.full((1, 2), 0.5)).most_likely.tolist() == [0]


def test_names_are_summed_up():
    mona = Driver("bart", 0.7, 0.3, 0.0, 2.0)
    belief = TraitBelief((BART, LISA, mona), np.array([[0.2, 0.5, 0.3]]))
    named = belief.named()
    assert list(named) == ["bart", "lisa"]
    assert named["bart"] == pytest.approx([0.5])
    assert named["lisa"] == pytest.approx([0.5])


def test_what_candidates_have_is_averaged_whatever_its_shape():
    np.testing.assert_allclose(BELIEF.expected(np.array([4.0, 8.0, 0.0])), [4.0, 0.0])
    places = np.array([[1.0, 0.0], [0.0, 1.0], [2.0, -2.0]])
    np.testing.assert_allclose(BELIEF.expected(places), [[1.0, -0.25], [2.0, -2.0]])
    deep = np.arange(12.0).reshape(3, 2, 2)
    assert BELIEF.expected(deep).shape == (2, 2, 2)
    np.testing.assert_array_equal(BELIEF.expected(deep)[1], deep[2])


@given(st.lists(st.floats(0.01, 1), min_size=3, max_size=3))
def test_the_mean_lies_among_the_candidates_and_the_spread_is_that_of_draws(weights):
    p = np.array([weights]) / sum(weights)
    belief = TraitBelief((LISA, MARGE, BART), p)
    table = np.array([driver.traits for driver in belief.drivers])
    assert (belief.mean >= table.min(axis=0) - 1e-12).all()
    assert (belief.mean <= table.max(axis=0) + 1e-12).all()
    variance = p @ table**2 - (p @ table) ** 2
    np.testing.assert_allclose(belief.spread**2, variance, atol=1e-9)
