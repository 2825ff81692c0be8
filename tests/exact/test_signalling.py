import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hmi_marl.envs.drivers import DRIVERS, Driver, Traits
from hmi_marl.exact.signalling import entropy, read_signal, reveals, surprise

NONA = Driver("nona", beta=0.5, alpha=0.25, eta=0.25, inflation=1.0)
unit = st.floats(0, 1)
anybody = st.builds(Driver, st.just("any"), unit, unit, unit, st.just(1.0))


def follow(driver, helped, last, intended, applied):
    """The signals of one team, from the start."""
    belief, signals = np.zeros(1), []
    for now in zip(helped, last, intended, applied, strict=True):
        signals.append(read_signal(belief, np.array([now[0]]), driver, *np.array(now[1:])[:, None]))
        belief = signals[-1].belief
    return signals


def test_entropy_by_hand():
    half, quarter = 1.0, 2.0 - 0.75 * np.log2(3)
    np.testing.assert_allclose(entropy(np.array([0.5, 0.25, 0.75])), [half, quarter, quarter])
    assert entropy(np.array([0.0, 1.0, 1.0 + 1e-16, -1e-17])).tolist() == [0.0] * 4
    assert surprise(np.array([1.0, 0.5, 0.125])).tolist() == [0.0, 1.0, 3.0]
    assert np.isfinite(surprise(np.zeros(1))).all()


def test_a_chain_worked_by_hand():
    # No alert in step 0; an alert in step 1, in effect from there on. i: 0, 1, 1, 1.
    # Step 0: p = β = 0.5, silent since v_0 = a^H_0.
    # Step 1: helped, 0 -> 1 with 0.25, 1 -> 1 with 0.5: p = 0.5 x 0.5 + 0.5 x 0.25 = 0.375; silent.
    # Step 2: p = 0.375 x 0.5 + 0.625 x 0.25 = 0.34375; a^H = 3 is followed: d = 0 is revealed.
    # Step 3: p = 0.25; a^H = 1 is not followed: d = 1 is revealed.
    signals = follow(
        NONA, helped=[0, 1, 1, 1], last=[-1, 1, 1, 3], intended=[1, 1, 3, 1], applied=[1, 1, 3, 3]
    )
    assert [float(s.predicted[0]) for s in signals] == [0.5, 0.375, 0.34375, 0.25]
    assert [bool(s.reveals[0]) for s in signals] == [False, False, True, True]
    assert [float(s.belief[0]) for s in signals] == [0.5, 0.375, 0.0, 1.0]
    bits = [float(s.information[0]) for s in signals]
    # h(11/32) = 5 - 11/32 log2 11 - 21/32 log2 21; h(1/4) = 2 - 3/4 log2 3
    by_hand = 5 - 11 / 32 * np.log2(11) - 21 / 32 * np.log2(21), 2 - 0.75 * np.log2(3)
    assert bits == pytest.approx([0.0, 0.0, *by_hand])
    assert by_hand == pytest.approx((0.9284, 0.8113), abs=1e-4)
    losses = [
        float(s.log_loss(np.array([d]))[0]) for s, d in zip(signals, [1, 0, 0, 1], strict=True)
    ]
    assert losses == pytest.approx([1.0, -np.log2(0.625), 0.0, 0.0])


def chain(driver, d, helped):
    """p(d_t = 1 | d_{t-1} = d), as the paper writes it."""
    if d == 0:
        return max(0.0, driver.beta - driver.eta * helped)
    return 1.0 - min(1.0, driver.alpha + driver.eta * helped)


def mutual_information(driver, helped, pattern):
    """Information of all of d and what was revealed, from their joint distribution [bits].

    ``pattern`` says whether step t reveals, from t and what was revealed before.
    """
    seen = {}
    for hidden in itertools.product((0, 1), repeat=len(helped)):
        probability, d, shown = 1.0, 0, ()
        for t, new in enumerate(hidden):
            p = chain(driver, d, helped[t])
            probability *= p if new else 1.0 - p
            shown += (new if pattern(t, shown) else None,)
            d = new
        seen[shown] = seen.get(shown, 0.0) + probability
    # What is seen follows from d, so that the information is the entropy of what is seen.
    return -sum(p * np.log2(p) for p in seen.values() if p > 0)


def expected_bits(driver, helped, pattern):
    """Expected sum of the information of each step, over all hidden sequences [bits]."""
    total = 0.0
    for hidden in itertools.product((0, 1), repeat=len(helped)):
        probability, d, shown, last, rows = 1.0, 0, (), -1, []
        for t, new in enumerate(hidden):
            p = chain(driver, d, helped[t])
            probability *= p if new else 1.0 - p
            now = pattern(t, shown)
            shown += (new if now else None,)
            intended = (last + 1) % 5 if now else max(last, 0)
            applied = last if new and t else intended
            rows.append((helped[t], last, intended, applied))
            last, d = applied, new
        total += probability * sum(
            float(s.information[0]) for s in follow(driver, *zip(*rows, strict=True))
        )
    return total


@given(
    driver=anybody,
    helped=st.lists(st.sampled_from([0, 1, 0.5]), min_size=5, max_size=5),
    salt=st.integers(0, 1000),
    share=st.sampled_from([0.0, 0.4, 1.0]),
)
def test_the_sum_of_all_steps_is_the_information_about_the_whole_sequence(
    driver, helped, salt, share
):
    def pattern(t, shown):
        return t > 0 and hash((salt, t, tuple(-1 if d is None else d for d in shown))) % 10 < (
            10 * share
        )

    expected = mutual_information(driver, helped, pattern)
    assert expected_bits(driver, helped, pattern) == pytest.approx(expected, abs=1e-9)


@given(driver=anybody, belief=unit, helped=unit, last=st.integers(-1, 4), new=st.integers(0, 4))
def test_bits_lie_between_nothing_and_all_that_is_unknown(driver, belief, helped, last, new):
    now = (np.array([x]) for x in (last, new, new))
    signal = read_signal(np.array([belief]), np.array([helped]), driver, *now)
    (bits,), (unknown,), (shown,) = signal.information, signal.entropy, signal.reveals
    assert 0.0 <= bits <= unknown <= 1.0
    assert bits == (unknown if shown else 0.0)
    assert shown == (last not in (-1, new))


def test_every_team_has_its_own_traits():
    drivers = [DRIVERS["lisa"], DRIVERS["bart"], NONA]
    belief, helped = np.array([0.25, 0.5, 1.0]), np.array([1, 0, 1])
    last, intended = np.array([1, 1, -1]), np.array([1, 2, 1])
    together = read_signal(belief, helped, Traits.of(drivers), last, intended, intended)
    for k, driver in enumerate(drivers):
        arrays = (each[k : k + 1] for each in (belief, helped))
        actions = (each[k : k + 1] for each in (last, intended, intended))
        alone = read_signal(*arrays, driver, *actions)
        for one, many in zip(alone, together, strict=True):
            assert one[0] == many[k]


def test_only_another_action_than_the_last_applied_one_reveals():
    assert reveals(np.array([1, 2, 0, 1]), np.array([1, 1, -1, -1])).tolist() == [
        False,
        True,
        False,
        False,
    ]
