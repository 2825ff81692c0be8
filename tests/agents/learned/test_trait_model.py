import math
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hmi_marl.agents.learned import trait_model
from hmi_marl.agents.learned.network import NetworkConfig
from hmi_marl.agents.learned.trait_model import (
    ACTIONS,
    EXTRA,
    LONG_AGO,
    PARTS,
    TraitCard,
    TraitModel,
    encoder_inputs,
    situations,
    standardise,
)

CARD = TraitCard(
    (("lidar", 3), ("speed", 1)),
    latent=2,
    encoder_units=5,
    gamma=0.9,
    reward=NetworkConfig((4,), "tanh"),
    potential=NetworkConfig((3,), "tanh"),
    policy=NetworkConfig((4, 3), "elu"),
)


def weights_for(card=CARD, seed=0):
    rng = np.random.default_rng(seed)
    weights = {n: rng.standard_normal(size).astype(np.float32) for n, size in card.shapes.items()}
    return weights | {"state.scale": np.full(card.state_size, 0.5, np.float32)}


def silent(card=CARD, **last):
    """Weights of zero except for those given by name, with __ for the dot."""
    weights = {name: np.zeros(size, np.float32) for name, size in card.shapes.items()}
    weights["state.scale"] += 1.0
    for name, value in last.items():
        weights[name.replace("__", ".")][...] = value
    return weights


MODEL = TraitModel(CARD, weights_for())


def windows(seed=0, length=(6, 2, 4, 1)):
    """States, actions, alerts and length of some windows."""
    rng = np.random.default_rng(seed)
    real = np.arange(max(length)) < np.array(length)[:, None]
    states = rng.random((*real.shape, 4), np.float32) * real[..., None]
    actions = np.where(real, rng.integers(0, ACTIONS, real.shape), -1)
    return states, actions, rng.integers(0, 2, real.shape) * real, np.array(length)


# The card.


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"reads": ()}, "reads parts of at least one column"),
        ({"reads": (("speed", 0),)}, "reads parts of at least one column"),
        ({"latent": 0}, "latent lies in 1 to .*, but got 0"),
        ({"encoder_units": -3}, "encoder_units lies in 1 to .*, but got -3"),
        ({"pool": 0}, "pool lies in 1 to .*, but got 0"),
        ({"gamma": 1.01}, r"gamma lies in \[0, 1\], but got 1.01"),
        ({"gamma": math.nan}, r"gamma lies in \[0, 1\], but got nan"),
        *(
            (
                {part: NetworkConfig(rnn_hidden_dim=2)},
                "only the encoder is recurrent: set encoder_units",
            )
            for part in PARTS
        ),
    ],
    ids=str,
)
def test_a_card_that_makes_no_model_is_refused(changed, message):
    with pytest.raises(ValueError, match=message):
        replace(CARD, **changed)


def test_sizes_of_a_card_by_hand():
    assert CARD.state_size == 4
    assert CARD.situation_size == 4 + 5 + 11
    assert [CARD.inputs(part) for part in PARTS] == [20 + 5 + 2, 20 + 2, 20 + 2]
    assert CARD.encoder_inputs == 20 + 5 + 11
    shapes = CARD.shapes
    assert shapes["encoder.input_weight"] == (4 * 5, 36)
    assert shapes["encoder.hidden_weight"] == (4 * 5, 5)
    assert shapes["mean.weight"] == shapes["log_variance.weight"] == (2, 5)
    assert shapes["reward.layer0.weight"] == (4, 27)
    assert shapes["reward.layer1.weight"] == (1, 4)
    assert shapes["policy.layer2.weight"] == (5, 3)


def test_a_card_reads_lists_as_json_has_them():
    assert replace(CARD, reads=[["lidar", 3], ["speed", 1]]) == CARD


def test_weights_that_do_not_fit_are_refused():
    weights = weights_for()
    with pytest.raises(ValueError, match=r"mean\.bias has shape \(3,\), but the card says \(2,\)"):
        TraitModel(CARD, weights | {"mean.bias": np.zeros(3, np.float32)})
    with pytest.raises(ValueError, match=r"state\.scale is not finite everywhere"):
        TraitModel(CARD, weights | {"state.scale": np.full(4, np.inf, np.float32)})
    del weights["policy.layer0.bias"]
    with pytest.raises(
        ValueError, match=r"do not fit the trait model's card: policy\.layer0\.bias"
    ):
        TraitModel(CARD, weights)


# The encoder.


def test_situations_are_standardised_by_hand():
    x = np.arange(4 + EXTRA, dtype=np.float32)
    out = standardise(x, np.array([0.0, 1.0, 1.0, 5.0]), np.array([1.0, 2.0, 0.5, 4.0]))
    assert out.tolist() == [0.0, 0.0, 2.0, -0.5, *range(4, 4 + EXTRA)]
    assert x.tolist() == list(range(4 + EXTRA))
    assert out.dtype == np.float32


def test_what_the_encoder_reads_by_hand():
    # A situation has one column of state, v_{t-1} and the steps since the alert. Behind it v_t, and
    # if that is v_{t-1}, the steps since the alert once more.
    x = np.zeros((4, 1 + EXTRA), np.float32)
    x[:, 0] = 0.5, 0.6, 0.7, 0.8
    x[[1, 2], 1 + 3] = 1.0  # v_{t-1} = 3 in the second and third row, none in the others
    x[np.arange(4), 1 + ACTIONS + np.array([10, 2, 0, 7])] = 1.0
    read = encoder_inputs(x, np.array([0, 3, 4, -1]))
    np.testing.assert_array_equal(read[:, : 1 + EXTRA], x)
    assert read[:, 1 + EXTRA : 1 + EXTRA + ACTIONS].tolist() == [
        [1, 0, 0, 0, 0],
        [0, 0, 0, 1, 0],
        [0, 0, 0, 0, 1],
        [0, 0, 0, 0, 0],
    ]
    repeated = read[:, 1 + EXTRA + ACTIONS :]
    assert repeated.shape == (4, LONG_AGO + 1)
    assert np.argwhere(repeated).tolist() == [[1, 2]]


def test_the_encoder_by_hand():
    # One unit, whose gates are biases alone: input 1/2, forget 3/4, the new value tanh 20 = 1 and
    # output 1/4. The cell is 1/2, then 3/4 1/2 + 1/2 = 7/8, then 3/4 7/8 + 1/2 = 37/32; hidden is
    # 1/4 tanh of it.
    card = replace(CARD, encoder_units=1)
    weights = silent(card)
    weights["encoder.input_bias"][:] = 0.0, math.log(3), 20.0, -math.log(3)
    states, actions, alerts, length = windows(length=(3, 2))
    encoded = TraitModel(card, weights).encode(states, actions, alerts, length)
    expected = [[0.25 * math.tanh(37 / 32)], [0.25 * math.tanh(7 / 8)]]
    np.testing.assert_allclose(encoded, expected, rtol=1e-6)


def test_gates_read_the_hidden_state_by_hand():
    # The new value is tanh of 8 times the hidden state, and of 20 in the first step alone, where
    # v_{t-1} is still unknown: a bias of 20 less 20 for each v_{t-1}.
    card = replace(CARD, encoder_units=1)
    weights = silent(card)
    weights["encoder.input_bias"][2] = 20.0
    weights["encoder.input_weight"][2, 4 : 4 + ACTIONS] = -20.0
    weights["encoder.hidden_weight"][2] = 8.0
    states, actions, alerts, length = windows(length=(2,))
    encoded = TraitModel(card, weights).encode(states, actions, alerts, length)
    first = 0.5 * math.tanh(0.5)
    second = 0.5 * math.tanh(0.25 + 0.5 * math.tanh(8 * first))
    np.testing.assert_allclose(encoded, [[second]])


@given(st.integers(0, 2**32 - 1))
def test_reading_step_by_step_is_encoding(seed):
    states, actions, alerts, length = windows(seed)
    x, now = situations(states, actions, alerts), MODEL.begin(len(states))
    encoded = MODEL.encode(states, actions, alerts, length)
    for t in range(x.shape[1]):
        now = MODEL.read(now, x[:, t], actions[:, t])
        over = length == t + 1
        np.testing.assert_allclose(now.hidden[over], encoded[over], rtol=1e-12)


def test_beginning_anew_leaves_no_trace():
    states, actions, alerts, _ = windows()
    x, begun = situations(states, actions, alerts), MODEL.begin(4)
    first = MODEL.read(begun, x[:, 0], actions[:, 0])
    MODEL.read(first, x[:, 1], actions[:, 1])
    assert not any(part.any() for part in begun)
    again = MODEL.read(begun, x[:, 0], actions[:, 0])
    for one, other in zip(first, again, strict=True):
        np.testing.assert_array_equal(one, other)


def test_what_comes_after_a_windows_end_is_not_read():
    states, actions, alerts, length = windows()
    encoded = MODEL.encode(states, actions, alerts, length)
    over = np.arange(6) >= length[:, None]
    states[over], actions[over], alerts[over] = 0.9, 2, 1
    np.testing.assert_array_equal(MODEL.encode(states, actions, alerts, length), encoded)


@pytest.mark.parametrize("at_once", [1, 3, 4])
def test_how_many_are_encoded_at_once_does_not_matter(monkeypatch, at_once):
    expected = MODEL.encode(*windows())
    monkeypatch.setattr(trait_model, "_CHUNK", at_once)
    np.testing.assert_allclose(MODEL.encode(*windows()), expected, rtol=1e-12)


def test_states_of_another_scene_are_refused():
    _, *rest = windows()
    with pytest.raises(
        ValueError, match="reads states of 4 columns, but got 9; use the scene that"
    ):
        MODEL.encode(np.zeros((4, 6, 9), np.float32), *rest)


def test_the_posterior_by_hand():
    # One unit in: mean 2 h + 1 and -h, log-variance 0 h + log 3 and 4 h, h being 1/2.
    card = replace(CARD, encoder_units=1)
    weights = silent(card)
    weights["mean.weight"][:, 0], weights["mean.bias"][:] = (2, -1), (1, 0)
    weights["log_variance.weight"][:, 0] = 0, 4
    weights["log_variance.bias"][0] = math.log(3)
    latent = TraitModel(card, weights).latent(np.array([[0.5], [0.0]]))
    np.testing.assert_allclose(latent.mean, [[2.0, -0.5], [1.0, 0.0]])
    np.testing.assert_allclose(latent.variance, [[3.0, math.e**2], [3.0, 1.0]], rtol=1e-6)


# The policy and the reward.


def test_the_policy_by_hand():
    # Logits log 1 ... log 5 whatever is seen: probabilities 1/15 ... 5/15.
    weights = silent(policy__layer2__bias=np.log([1, 2, 3, 4, 5]))
    found = TraitModel(CARD, weights).policy(np.ones((2, 20), np.float32), np.zeros((2, 2)))
    np.testing.assert_allclose(np.exp(found), np.array([[1, 2, 3, 4, 5]] * 2) / 15, rtol=1e-6)


def test_a_policy_that_is_sure_gives_no_nan():
    weights = silent(policy__layer2__bias=[0, 1000, 0, 0, 0])
    found = TraitModel(CARD, weights).policy(np.ones((1, 20), np.float32), np.zeros(2))
    assert found.tolist() == [[-1000, 0, -1000, -1000, -1000]]


def test_the_reward_by_hand():
    # g = 3 and h = 2 everywhere: f = 3 + 0.9 · 2 − 2 = 2.8.
    model = TraitModel(CARD, silent(reward__layer1__bias=3.0, potential__layer1__bias=2.0))
    x, actions, z = np.ones((3, 20), np.float32), np.array([0, 4, 2]), np.zeros((3, 2))
    np.testing.assert_allclose(model.reward(x, actions, x, z), [2.8] * 3)
    np.testing.assert_allclose(model.base_reward(x, actions, z), [3.0] * 3)


def test_rewards_and_policies_depend_on_z_and_all_rows_may_share_one():
    rng = np.random.default_rng(3)
    x, after = rng.random((2, 6, 20), np.float32)
    actions, z = rng.integers(0, ACTIONS, 6), rng.standard_normal(2)
    rows = np.tile(z, (6, 1))
    np.testing.assert_array_equal(MODEL.policy(x, z), MODEL.policy(x, rows))
    np.testing.assert_array_equal(
        MODEL.reward(x, actions, after, z), MODEL.reward(x, actions, after, rows)
    )
    assert (MODEL.reward(x, actions, after, z + 1) != MODEL.reward(x, actions, after, z)).all()
    assert (MODEL.policy(x, z + 1) != MODEL.policy(x, z)).any(axis=1).all()


def test_using_a_trait_model_needs_no_torch():
    code = "import sys, hmi_marl.agents.learned.trait_model; print('torch' in sys.modules)"
    message = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert message.stdout.strip() == "False"
