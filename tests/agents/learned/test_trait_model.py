import math
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from trait_models import SMALL

from hmi_marl.agents.learned.network import NetworkConfig
from hmi_marl.agents.learned.situations import ACTIONS
from hmi_marl.agents.learned.trait_model import PARTS, TraitCard, TraitModel

CARD = TraitCard(
    (("lidar", 3), ("speed", 1)),
    latent=2,
    encoder=SMALL,
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


# The card.


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"reads": ()}, "reads parts of at least one column"),
        ({"reads": (("speed", 0),)}, "reads parts of at least one column"),
        ({"latent": 0}, "latent lies in 1 to .*, but got 0"),
        ({"pool": 0}, "pool lies in 1 to .*, but got 0"),
        ({"gamma": 1.01}, r"gamma lies in \[0, 1\], but got 1.01"),
        ({"gamma": math.nan}, r"gamma lies in \[0, 1\], but got nan"),
        *(
            (
                {part: NetworkConfig(rnn_hidden_dim=2)},
                "a trait model has no recurrent layer: set rnn_hidden_dim to 0",
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
    shapes = CARD.shapes
    assert shapes["encoder.state_layer.weight"] == (3, 4)
    assert shapes["encoder.step_layer.weight"] == (4, 5 + 11 + 5 + 11 + 2 + 3)
    assert shapes["encoder.span_layer.weight"] == (3, 5, 4)
    assert shapes["encoder.head.layer0.weight"] == (4, 5 + 1)
    assert shapes["encoder.head.layer1.weight"] == (2 * 2, 4)
    assert shapes["encoder.average.layer1.weight"] == (5, 4)
    assert shapes["reward.layer0.weight"] == (4, 27)
    assert shapes["reward.layer1.weight"] == (1, 4)
    assert shapes["policy.layer2.weight"] == (5, 3)


def test_a_card_reads_lists_as_json_has_them():
    assert replace(CARD, reads=[["lidar", 3], ["speed", 1]]) == CARD


def test_weights_that_do_not_fit_are_refused():
    weights = weights_for()
    with pytest.raises(
        ValueError, match=r"encoder\.step_layer\.bias has shape \(3,\), but the card says \(4,\)"
    ):
        TraitModel(CARD, weights | {"encoder.step_layer.bias": np.zeros(3, np.float32)})
    with pytest.raises(ValueError, match=r"state\.scale is not finite everywhere"):
        TraitModel(CARD, weights | {"state.scale": np.full(4, np.inf, np.float32)})
    del weights["policy.layer0.bias"]
    with pytest.raises(
        ValueError, match=r"do not fit the trait model's card: policy\.layer0\.bias"
    ):
        TraitModel(CARD, weights)


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
