import dataclasses

import numpy as np
import pytest
import torch
from demonstrations import LAYOUT, changed, made_up
from hypothesis import given
from hypothesis import strategies as st

from hmi_marl.agents.learned.situations import EXTRA, situations
from hmi_marl.training.traits.episodes import Episodes
from hmi_marl.training.traits.windows import (
    Batch,
    Windows,
    by_driver,
    draw_pools,
    transitions,
)

NAN = float("nan")
LENGTH = [3, 5, 2, 5, 1, 4, 5, 3, 4]
DRIVER = [0, 1, 0, -1, 0, 1, 1, 0, 1]
"""Windows 0, 2, 4, 7 are lisa's, 1, 5, 6, 8 bart's, 3 nobody's."""
LABELS = np.array([1.0, NAN, 1.0, 1.0, NAN, 0.0, 0.0, NAN, NAN])
OBSERVED = made_up(LENGTH, driver=DRIVER, names=("lisa", "bart"), with_truth=False).observed
UNITS = Episodes.of(OBSERVED).units
WINDOWS = Windows(Episodes.of(OBSERVED), LABELS)
seeds = st.integers(0, 2**32 - 1)


def rng(seed=0):
    return np.random.default_rng(seed)


# Units.


def test_units_are_mean_and_spread_of_the_steps_that_there_were():
    # Speeds 0.1 and 0.3, then one of 0.8 alone: mean 0.4, spread sqrt((0.09 + 0.01 + 0.16) / 3).
    # The zeros after the second episode's end are no speeds.
    observed = made_up([2, 1]).observed
    speed = LAYOUT["speed"].start
    states = observed.states.copy()
    states[0, :, speed], states[1, 0, speed] = (0.1, 0.3), 0.8
    units = Episodes.of(dataclasses.replace(observed, states=states)).units
    assert units.centre[speed] == pytest.approx(0.4)
    assert units.scale[speed] == pytest.approx(np.sqrt(0.26 / 3))
    assert units.centre.shape == units.scale.shape == (LAYOUT.size,)
    assert units.centre.dtype == units.scale.dtype == np.float32


def test_a_column_that_never_changes_keeps_its_unit():
    speed = LAYOUT["speed"].start
    states = changed(OBSERVED, "states", (..., speed), 0.7)
    states *= OBSERVED.steps_taken[..., None]
    units = Episodes.of(dataclasses.replace(OBSERVED, states=states)).units
    assert units.scale[speed] == 1.0
    assert (units.scale > 0).all()
    x = units.standardise(situations(states, OBSERVED.actions, OBSERVED.alerts))
    np.testing.assert_allclose(x[OBSERVED.steps_taken][:, speed], 0.0, atol=1e-6)


def test_situations_in_units_have_mean_0_and_spread_1_and_what_is_one_hot_stays():
    x = situations(OBSERVED.states, OBSERVED.actions, OBSERVED.alerts)
    standard = UNITS.standardise(x)
    assert standard.dtype == np.float32
    real = standard[OBSERVED.steps_taken][:, : LAYOUT.size]
    np.testing.assert_allclose(real.mean(axis=0), 0.0, atol=1e-5)
    np.testing.assert_allclose(real.std(axis=0), 1.0, atol=1e-5)
    np.testing.assert_array_equal(standard[..., -EXTRA:], x[..., -EXTRA:])


# Pools.


@given(seeds, st.integers(1, 6), st.integers(1, 4))
def test_pools_are_of_one_driver_without_repeats(seed, count, size):
    which = WINDOWS.draw(rng(seed), count, size)
    assert which.shape == (count, size)
    for pool in which:
        assert len(set(OBSERVED.driver[pool])) == 1
        assert len(set(pool)) == size
    assert 3 not in which  # whose driver is not known


def test_a_driver_of_few_windows_gives_some_twice():
    which = WINDOWS.draw(rng(), 4, 6)
    for pool in which:
        assert len(set(OBSERVED.driver[pool])) == 1


def test_drivers_are_equally_likely_however_much_they_drove():
    driver = np.array([0] * 99 + [1])
    which = draw_pools(rng(), by_driver(driver, np.ones(100, np.bool_)), 4000, 1)
    # 4000 draws of 1/2: a standard deviation of 0.008.
    assert (which == 99).mean() == pytest.approx(0.5, abs=0.04)
    times = np.bincount(which[which < 99], minlength=99)
    assert times.min() > 0


def test_only_the_windows_among_which_to_draw_are_drawn():
    among = np.array([True, False, True, False, False, True, True, False, False])
    which = draw_pools(rng(), by_driver(OBSERVED.driver, among), 40, 2)
    assert {tuple(sorted(pool)) for pool in which} == {(0, 2), (5, 6)}


@given(seeds)
def test_labelled_pools_hold_labelled_windows_and_have_their_label(seed):
    which, labels = WINDOWS.draw_labelled(rng(seed), 5, 2)
    assert which.shape == (5, 2)
    for pool, label in zip(which, labels, strict=True):
        np.testing.assert_array_equal(LABELS[pool], label)
        assert set(pool) == ({0, 2} if label == 1.0 else {5, 6})


@given(seeds, st.integers(1, 3), st.integers(1, 2))
def test_pairs_of_pools_are_of_one_driver(seed, pairs, size):
    which = WINDOWS.draw_pairs(rng(seed), 2 * pairs, size)
    assert which.shape == (2 * pairs, size)
    for first, second in zip(which[::2], which[1::2], strict=True):
        assert len(set(OBSERVED.driver[[*first, *second]])) == 1
        assert not set(first) & set(second)  # each has four windows, enough for both


@given(seeds, st.integers(1, 3), st.integers(1, 4))
def test_drivers_are_drawn_once_with_an_even_number_of_windows(seed, count, size):
    which = WINDOWS.draw_drivers(rng(seed), count, size)
    # Both known drivers have four windows, so at most two in each half.
    assert which.shape == (min(count, 2), 2 * min(size, 2))
    drivers = OBSERVED.driver[which]
    assert (drivers == drivers[:, :1]).all()
    assert len(set(drivers[:, 0])) == len(which)
    for own in which:
        assert len(set(own)) == len(own)


@pytest.mark.parametrize("driver", [[0, 0, 0, 0], [0, 0, 0, 1], [-1, -1, 0, 0]])
def test_drivers_among_others_take_two_with_two_windows_each(driver):
    few = made_up([3] * 4, driver=driver, names=("ada", "bob")).observed
    windows = Windows(Episodes.of(few), np.full(4, np.nan))
    with pytest.raises(ValueError, match="two drivers or more with two windows or more each"):
        windows.draw_drivers(rng(), 2, 2)


@pytest.mark.parametrize("draw", ["draw", "draw_pairs", "draw_labelled", "draw_drivers"])
def test_equal_seeds_give_equal_pools(draw):
    def drawn(seed):
        which = getattr(WINDOWS, draw)(rng(seed), 8, 2)
        return which[0] if draw == "draw_labelled" else which

    np.testing.assert_array_equal(drawn(5), drawn(5))
    assert any((drawn(5) != drawn(seed)).any() for seed in (6, 7, 8))


def test_windows_that_cannot_be_pooled_are_told():
    with pytest.raises(ValueError, match=r"labels have shape \(9,\), not \(3,\)"):
        Windows(Episodes.of(OBSERVED), LABELS[:3])
    nobody = dataclasses.replace(OBSERVED, driver=np.full(9, -1))
    with pytest.raises(ValueError, match="no window's driver is known, so none can be pooled"):
        Windows(Episodes.of(nobody), LABELS)
    of_nobody = Windows(Episodes.of(OBSERVED), np.where(np.arange(9) == 3, 1.0, NAN))
    with pytest.raises(ValueError, match="no window of a known driver has a label"):
        of_nobody.draw_labelled(rng(), 4, 2)
    with pytest.raises(ValueError, match="count is an even number of pools, but got 3"):
        WINDOWS.draw_pairs(rng(), 3, 2)


def test_a_batch_is_the_windows_asked_for():
    which = np.array([[0, 2], [8, 1], [5, 5]])
    x, actions, length = WINDOWS.batch(which)
    assert x.shape == (3, 2, 5, LAYOUT.size + EXTRA)
    assert x.dtype == torch.float32
    expected = situations(OBSERVED.states, OBSERVED.actions, OBSERVED.alerts)
    for pool, place in np.ndindex(3, 2):
        window = which[pool, place]
        np.testing.assert_array_equal(x[pool, place], UNITS.standardise(expected[window]))
        np.testing.assert_array_equal(actions[pool, place], OBSERVED.actions[window])
    assert length.tolist() == [[3, 2], [4, 5], [4, 4]]


# Transitions.


def test_transitions_by_hand():
    # Two pools of two windows, at most four steps; x is a number 100 pool + 10 window + step and
    # the action is the step, -1 after the end. A window of L steps has L - 1 transitions.
    pool, window, step = torch.meshgrid(*map(torch.arange, (2, 2, 4)), indexing="ij")
    length = torch.tensor([[3, 1], [2, 4]])
    actions = torch.where(step < length[..., None], step, -1)
    x = (100.0 * pool + 10 * window + step)[..., None]
    found = transitions(Batch(x, actions, length))
    assert found.before[:, 0].tolist() == [0, 1, 100, 110, 111, 112]
    assert found.after[:, 0].tolist() == [1, 2, 101, 111, 112, 113]
    assert found.actions.tolist() == [0, 1, 0, 0, 1, 2]
    assert found.pool.tolist() == [0, 0, 1, 1, 1, 1]


@given(seeds)
def test_no_transition_leads_past_a_windows_end(seed):
    batch = WINDOWS.batch(WINDOWS.draw(rng(seed), 3, 3))
    found = transitions(batch)
    assert len(found.before) == int((batch.length - 1).sum())
    assert (found.actions >= 0).all()
    assert found.pool.bincount(minlength=3).tolist() == (batch.length - 1).sum(dim=1).tolist()
    over = torch.arange(5) >= batch.length[..., None]
    changed_after = batch.situations.masked_fill(over[..., None], NAN)
    again = transitions(batch._replace(situations=changed_after))
    for one, other in zip(found, again, strict=True):
        assert torch.equal(one, other)


def test_windows_of_a_single_step_have_no_transitions():
    found = transitions(Batch(torch.zeros(1, 2, 1, 3), torch.zeros(1, 2, 1), torch.ones(1, 2)))
    assert [len(values) for values in found] == [0, 0, 0, 0]


def test_windows_that_cannot_be_learned_from_are_refused():
    single = made_up([1, 1], driver=[0, 0]).observed
    with pytest.raises(ValueError, match="windows have a single step, so there are no"):
        Windows(Episodes.of(single), np.full(2, NAN))
    two = made_up([3, 3], driver=[0, 0]).observed
    with pytest.raises(ValueError, match="windows of lisa have different labels"):
        Windows(Episodes.of(two), np.array([0.0, 1.0]))
