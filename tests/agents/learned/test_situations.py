import inspect

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hmi_marl.agents.learned.situations import (
    ACTIONS,
    EXTRA,
    LONG_AGO,
    Recent,
    situations,
)
from hmi_marl.agents.learned.trait_encoder import standardise

COLUMNS = 3
seeds = st.integers(0, 2**32 - 1)


def drives(seed, count=3, steps=16):
    """States, actions and alerts of some drives."""
    rng = np.random.default_rng(seed)
    states = rng.random((count, steps, COLUMNS), np.float32)
    actions = rng.integers(0, ACTIONS, (count, steps))
    return states, actions, (rng.random((count, steps)) < 0.15).astype(np.int64)


def split(x):
    """Observed state, v_{t-1} one-hot, steps since the alert one-hot."""
    return np.split(x, [x.shape[-1] - EXTRA, x.shape[-1] - EXTRA + ACTIONS], axis=-1)


def test_situations_by_hand():
    # One drive of five steps, which does 3, 3, 0, 4, 1; alerts sound in the second and fourth.
    states = np.arange(5, dtype=np.float32)[None, :, None] * [1.0, 10.0]
    actions, alerts = np.array([[3, 3, 0, 4, 1]]), np.array([[0, 1, 0, 1, 0]])
    x = situations(states.astype(np.float32), actions, alerts)
    assert x.shape == (1, 5, 2 + 5 + 11)
    assert x.dtype == np.float32
    seen, before, since = split(x[0])
    np.testing.assert_array_equal(seen, states[0])
    assert before.tolist() == [
        [0, 0, 0, 0, 0],  # nothing was done before the first step
        [0, 0, 0, 1, 0],
        [0, 0, 0, 1, 0],
        [1, 0, 0, 0, 0],
        [0, 0, 0, 0, 1],
    ]
    # No alert yet counts as long ago; it sounds now: 0; the step after it: 1.
    assert since.argmax(axis=1).tolist() == [LONG_AGO, 0, 1, 0, 1]
    assert since.sum(axis=1).tolist() == [1] * 5


def test_an_alert_is_long_ago_at_last():
    steps = LONG_AGO + 4
    alerts = np.zeros((1, steps), np.int64)
    alerts[0, 1] = 1
    x = situations(np.zeros((1, steps, 1), np.float32), np.zeros((1, steps), np.int64), alerts)
    since = split(x[0])[2].argmax(axis=1)
    assert since.tolist() == [LONG_AGO, *range(LONG_AGO + 1), LONG_AGO, LONG_AGO]


def test_after_a_drives_end_nothing_was_done():
    x = situations(np.zeros((1, 3, 1), np.float32), np.array([[2, -1, -1]]), np.zeros((1, 3), int))
    assert split(x[0])[1].sum(axis=1).tolist() == [0, 1, 0]


def test_forgetting_begins_new_drives_where_it_is_set():
    recent = Recent(2)
    states, both = np.zeros((2, 1), np.float32), np.ones(2, np.int64)
    recent.situation(states, both)
    recent.acted(np.array([4, 2]))
    recent.forget(np.array([True, False]))
    assert recent.applied.tolist() == [-1, 2]
    assert recent.since_alert.tolist() == [LONG_AGO, 0]
    _, before, since = split(recent.situation(states, 0 * both))
    assert before.tolist() == [[0, 0, 0, 0, 0], [0, 0, 1, 0, 0]]
    assert since.argmax(axis=1).tolist() == [LONG_AGO, 1]


@given(seeds)
def test_step_by_step_is_all_at_once(seed):
    states, actions, alerts = drives(seed)
    expected = situations(states, actions, alerts)
    recent = Recent(len(states))
    for t in range(states.shape[1]):
        if t == 7:  # a new drive need not begin for all at the same time
            recent.forget(np.array([False, True, False]))
            expected[1, t:] = situations(states[1:2, t:], actions[1:2, t:], alerts[1:2, t:])[0]
        np.testing.assert_array_equal(recent.situation(states[:, t], alerts[:, t]), expected[:, t])
        recent.acted(actions[:, t])


@given(seeds, st.integers(0, 15))
def test_a_situation_knows_nothing_of_what_comes_after_it(seed, t):
    states, actions, alerts = drives(seed)
    x = situations(states, actions, alerts)
    states[:, t + 1 :] += 1.0
    actions[:, t:] = (actions[:, t:] + 1) % ACTIONS  # v_t is done in x_t, so not yet known
    alerts[:, t + 1 :] = 1 - alerts[:, t + 1 :]
    np.testing.assert_array_equal(situations(states, actions, alerts)[:, : t + 1], x[:, : t + 1])


@given(seeds)
def test_drives_do_not_know_of_each_other(seed):
    everything = drives(seed)
    x = situations(*everything)
    for k in range(len(x)):
        alone = situations(*(values[k : k + 1] for values in everything))
        np.testing.assert_array_equal(alone[0], x[k])


def test_nothing_hidden_can_be_handed_in():
    # d, i, c, a^H, traits and the inflated lidar have no way in.
    assert list(inspect.signature(situations).parameters) == ["states", "actions", "alerts"]
    assert list(inspect.signature(Recent.situation).parameters)[1:] == ["states", "alerts"]
    assert list(inspect.signature(Recent.acted).parameters)[1:] == ["applied"]
    assert sorted(vars(Recent(1))) == ["applied", "count", "since_alert"]


@pytest.mark.parametrize("count", [0, 1])
def test_few_drives_are_drives(count):
    assert situations(*drives(0, count)).shape == (count, 16, COLUMNS + EXTRA)


def test_situations_are_standardised_by_hand():
    x = np.arange(4 + EXTRA, dtype=np.float32)
    out = standardise(x, np.array([0.0, 1.0, 1.0, 5.0]), np.array([1.0, 2.0, 0.5, 4.0]))
    assert out.tolist() == [0.0, 0.0, 2.0, -0.5, *range(4, 4 + EXTRA)]
    assert x.tolist() == list(range(4 + EXTRA))
    assert out.dtype == np.float32
