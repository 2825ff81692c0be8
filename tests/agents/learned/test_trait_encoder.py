import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from trait_models import SMALL

from hmi_marl.agents.learned import trait_encoder
from hmi_marl.agents.learned.network import NetworkConfig
from hmi_marl.agents.learned.situations import ACTIONS, EXTRA, LONG_AGO, situations
from hmi_marl.agents.learned.trait_encoder import (
    BEHAVIOUR,
    COUNT_SCALE,
    LEAST_LOG,
    Encoder,
    EncoderConfig,
    behaviour,
)

COLUMNS, LATENT = 4, 2
PLAIN = EncoderConfig(1, 1, 2, 1, head=NetworkConfig((1,)), average=NetworkConfig((1,)))
"""One feature of each kind, over two steps."""


def weights_for(config=SMALL, seed=0):
    rng = np.random.default_rng(seed)
    shapes = config.shapes(COLUMNS, LATENT)
    weights = {n: rng.standard_normal(size).astype(np.float32) for n, size in shapes.items()}
    centre, scale = rng.standard_normal(COLUMNS), np.full(COLUMNS, 0.5)
    return weights | {
        "state.centre": centre.astype(np.float32),
        "state.scale": scale.astype(np.float32),
    }


def silent(**given):
    """Weights of PLAIN, zero except for those given by name, with __ for the dot."""
    weights = {n: np.zeros(size, np.float32) for n, size in PLAIN.shapes(COLUMNS, LATENT).items()}
    units = {"state.centre": np.zeros(COLUMNS, np.float32), "state.scale": np.ones(COLUMNS)}
    for name, value in given.items():
        weights["encoder." + name.replace("__", ".")][...] = value
    return weights | units


ENCODER = Encoder(SMALL, weights_for(), LATENT)


def windows(seed=0, length=(6, 2, 4, 1)):
    """States, actions, alerts and length of some windows."""
    rng = np.random.default_rng(seed)
    real = np.arange(max(length)) < np.array(length)[:, None]
    states = rng.random((*real.shape, COLUMNS), np.float32) * real[..., None]
    actions = np.where(real, rng.integers(0, ACTIONS, real.shape), -1)
    return states, actions, rng.integers(0, 2, real.shape) * real, np.array(length)


@pytest.mark.parametrize("part", ["head", "average"])
def test_networks_have_no_recurrent_layer(part):
    with pytest.raises(ValueError, match=rf"set {part}\.rnn_hidden_dim to 0"):
        replace(SMALL, **{part: NetworkConfig(rnn_hidden_dim=2)})


@pytest.mark.parametrize("size", ["state_features", "step_features", "span", "features"])
def test_sizes_are_at_least_1(size):
    with pytest.raises(ValueError, match=f"{size} lies in 1 to .*, but got 0"):
        replace(SMALL, **{size: 0})


def test_behaviour_by_hand():
    # A situation has one column of state, v_{t-1} and the steps since the alert.
    x = np.zeros((4, 1 + EXTRA), np.float32)
    x[:, 0] = 0.5, 0.6, 0.7, 0.8
    x[[1, 2], 1 + 3] = 1.0  # v_{t-1} = 3 in the second and third row, none in the others
    x[np.arange(4), 1 + ACTIONS + np.array([10, 2, 0, 7])] = 1.0
    log_average = np.log([[0.5, 0.2, 0.1, 0.1, 0.1]] * 3 + [[1.0, 1e-9, 1e-9, 1e-9, 1e-9]])
    read = behaviour(x, np.array([0, 3, 4, 1]), log_average)
    assert read.shape == (4, BEHAVIOUR)
    extra, done, repeated, likely = np.split(
        read, [EXTRA, EXTRA + ACTIONS, EXTRA + ACTIONS + LONG_AGO + 1], axis=1
    )
    np.testing.assert_array_equal(extra, x[:, 1:])
    assert done.argmax(axis=1).tolist() == [0, 3, 4, 1]
    assert done.sum() == 4
    assert np.argwhere(repeated).tolist() == [[1, 2]]
    # Of v_t, and of v_{t-1}, if there is one.
    expected = [[0.5, 1.0], [0.1, 0.1], [0.1, 0.1]]
    np.testing.assert_allclose(np.exp(likely[:3]), expected)
    np.testing.assert_array_equal(likely[3], [LEAST_LOG, 0.0])


def test_an_action_after_the_end_leaves_nothing():
    x = np.zeros((1, 1 + EXTRA), np.float32)
    read = behaviour(x, np.array([-1]), np.zeros((1, ACTIONS)))
    assert not read[:, EXTRA:].any()


def test_features_by_hand():
    # u = relu(3 relu(2 s_0 - 1)), w = relu(u_t - 1/2 u_{t-1} - 1), for s_0 of 1, 1, 1/4 and 1:
    # u = 3, 3, 0, 3 and w = 2, 1/2, 0, 2.
    weights = silent(
        state_layer__weight=[[2, 0, 0, 0]],
        state_layer__bias=-1.0,
        step_layer__weight=[[0] * BEHAVIOUR + [3]],
        span_layer__weight=np.array([[[1.0]], [[-0.5]]]),
        span_layer__bias=-1.0,
    )
    states = np.zeros((2, 4, COLUMNS), np.float32)
    states[:, :, 0] = 1.0, 1.0, 0.25, 1.0
    actions, alerts = np.zeros((2, 2, 4), np.int64)
    sums = Encoder(PLAIN, weights, LATENT).encode(states, actions, alerts, np.array([4, 2]))
    np.testing.assert_allclose(sums, [[4.5, 4.0], [2.5, 2.0]])


def test_the_posterior_by_hand():
    # The hidden unit is the mean feature plus log n, h; mean 2 h + 1 and -h, log-variance log 3
    # and 4 h.
    weights = silent(
        head__layer0__weight=[[1.0, 1.0 / COUNT_SCALE]],
        head__layer1__weight=[[2.0], [-1.0], [0.0], [4.0]],
        head__layer1__bias=[1.0, 0.0, math.log(3), 0.0],
    )
    latent = Encoder(PLAIN, weights, LATENT).latent(np.array([[0.5, 1.0], [3.0, 3.0]]))
    h = np.array([0.5, 1.0 + math.log(3)])
    np.testing.assert_allclose(latent.mean, np.stack([2 * h + 1, -h], axis=1), rtol=1e-6)
    expected = np.stack([np.full(2, 3.0), np.exp(4 * h)], axis=1)
    np.testing.assert_allclose(latent.variance, expected, rtol=1e-5)


def test_a_pool_has_steps():
    with pytest.raises(ValueError, match="at least one step"):
        ENCODER.latent(np.zeros((2, SMALL.features + 1)))


@given(st.integers(0, 2**32 - 1))
def test_reading_step_by_step_is_encoding(seed):
    states, actions, alerts, length = windows(seed)
    x, now = situations(states, actions, alerts), ENCODER.begin(len(states))
    encoded = ENCODER.encode(states, actions, alerts, length)
    np.testing.assert_array_equal(encoded[:, -1], length)
    for t in range(x.shape[1]):
        now = ENCODER.read(now, x[:, t], actions[:, t])
        over = length == t + 1
        np.testing.assert_allclose(now.sums[over], encoded[over], rtol=1e-12)


def test_beginning_anew_leaves_no_trace():
    states, actions, alerts, _ = windows()
    x, begun = situations(states, actions, alerts), ENCODER.begin(4)
    first = ENCODER.read(begun, x[:, 0], actions[:, 0])
    ENCODER.read(first, x[:, 1], actions[:, 1])
    assert not any(part.any() for part in begun)
    again = ENCODER.read(begun, x[:, 0], actions[:, 0])
    for one, other in zip(first, again, strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_feature_covers_its_span_and_no_more():
    # With another first step, features differ in the first three steps, which cover it.
    states, actions, alerts, _ = windows(length=(6, 6))
    other = states.copy()
    other[:, 0] += 1.0
    ends = np.arange(1, 7)
    growth = [
        np.diff([ENCODER.encode(s, actions, alerts, np.full(2, end)) for end in ends], axis=0)
        for s in (states, other)
    ]
    differs = (abs(growth[0] - growth[1]) > 1e-9).any(axis=(1, 2))
    assert differs.tolist() == [True, True, False, False, False]


def test_what_comes_after_a_windows_end_is_not_read():
    states, actions, alerts, length = windows()
    encoded = ENCODER.encode(states, actions, alerts, length)
    over = np.arange(6) >= length[:, None]
    states[over], actions[over], alerts[over] = 0.9, 2, 1
    np.testing.assert_array_equal(ENCODER.encode(states, actions, alerts, length), encoded)


@pytest.mark.parametrize("at_once", [1, 3, 4])
def test_how_many_are_encoded_at_once_does_not_matter(monkeypatch, at_once):
    expected = ENCODER.encode(*windows())
    monkeypatch.setattr(trait_encoder, "_CHUNK", at_once)
    np.testing.assert_allclose(ENCODER.encode(*windows()), expected, rtol=1e-12)


def test_states_of_another_scene_are_refused():
    _, *rest = windows()
    with pytest.raises(
        ValueError, match="reads states of 4 columns, but got 9; use the scene that"
    ):
        ENCODER.encode(np.zeros((4, 6, 9), np.float32), *rest)
