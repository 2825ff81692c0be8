import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from hmi_marl.agents.learned.network import Network, NetworkConfig, _product
from hmi_marl.agents.learned.policy import PolicyCard
from hmi_marl.training.ppo.models import make_actor, weights_of

ACTIVATIONS = ("relu", "elu", "tanh")


def drawn_weights(config, inputs, outputs, seed=0, scale=1.0):
    rng = np.random.default_rng(seed)
    return {
        name: (scale * rng.standard_normal(shape)).astype(np.float32)
        for name, shape in config.shapes(inputs, outputs).items()
    }


@given(
    inputs=st.integers(1, 9),
    hidden=st.lists(st.integers(1, 8), min_size=1, max_size=3),
    memory=st.integers(0, 5),
    activation=st.sampled_from(ACTIVATIONS),
    seed=st.integers(0, 2**31),
)
def test_it_is_the_network_that_rsl_rl_trains(inputs, hidden, memory, activation, seed):
    config = NetworkConfig(tuple(hidden), activation, memory)
    torch.manual_seed(seed)
    actor = make_actor(PolicyCard("driver", (("speed", inputs),), config)).double()
    for weight in actor.parameters():
        torch.nn.init.normal_(weight)
    network = Network(config, weights_of(actor))
    network.forget(4)
    rng = np.random.default_rng(seed)
    with torch.no_grad():
        for step in range(5):
            if step == 3:
                begins = np.array([True, False, False, True])
                network.forget(4, begins)
                actor.reset(torch.from_numpy(begins.astype(np.int64)))
            x = rng.standard_normal((4, inputs)).astype(np.float32)
            latent = actor.get_latent({"actor": torch.from_numpy(x).double()})
            np.testing.assert_allclose(network(x), actor.mlp(latent).numpy(), atol=1e-11)


def test_two_layers_by_hand():
    weights = {
        "layer0.weight": np.array([[1.0, -1.0], [2.0, 0.0]], np.float32),
        "layer0.bias": np.array([0.0, -1.0], np.float32),
        "layer1.weight": np.array([[1.0, 10.0]], np.float32),
        "layer1.bias": np.array([0.5], np.float32),
    }
    x = np.array([[3.0, 1.0], [1.0, 3.0], [0.0, 0.0]], np.float32)
    # before the activation: (2, 5), (-2, 1), (0, -1)
    expected = {
        "relu": [2 + 50 + 0.5, 0 + 10 + 0.5, 0.5],
        "elu": [52.5, np.expm1(-2) + 10.5, 10 * np.expm1(-1) + 0.5],
        "tanh": [
            np.tanh(2) + 10 * np.tanh(5) + 0.5,
            np.tanh(-2) + 10 * np.tanh(1) + 0.5,
            10 * np.tanh(-1) + 0.5,
        ],
    }
    for activation in ACTIVATIONS:
        network = Network(NetworkConfig((2,), activation), weights)
        np.testing.assert_allclose(network(x)[:, 0], expected[activation], rtol=1e-14)


def test_one_unit_of_memory_by_hand():
    config = NetworkConfig((1,), "relu", rnn_hidden_dim=1)
    weights = {
        "memory.input_weight": np.array([[0.5], [1.0], [2.0]], np.float32),
        "memory.hidden_weight": np.array([[0.25], [-1.0], [3.0]], np.float32),
        "memory.input_bias": np.array([0.0, 0.5, -1.0], np.float32),
        "memory.hidden_bias": np.array([0.125, 0.0, 0.75], np.float32),
        "layer0.weight": np.array([[1.0, 0.5]], np.float32),  # of h and x
        "layer0.bias": np.array([9.0], np.float32),  # keeps relu out of it
        "layer1.weight": np.ones((1, 1), np.float32),
        "layer1.bias": np.array([-9.0], np.float32),
    }

    def sigmoid(x):
        return 1 / (1 + np.exp(-x))

    network, h = Network(config, weights), 0.0
    network.forget(1)
    for x in (1.0, -2.0, 0.5):
        reset = sigmoid(0.5 * x + 0.25 * h + 0.125)
        update = sigmoid(x + 0.5 - h)
        new = np.tanh(2 * x - 1 + reset * (3 * h + 0.75))
        h = (1 - update) * new + update * h
        answer = network(np.array([[x]], np.float32))[0, 0]
        assert answer == pytest.approx(h + 0.5 * x, abs=1e-14)


@pytest.mark.parametrize("memory", [0, 16])
def test_an_answer_does_not_depend_on_who_else_is_asked(memory):
    config = NetworkConfig((64, 64), "elu", memory)
    weights = drawn_weights(config, 80, 15, scale=0.3)
    whole, parts = Network(config, weights), [Network(config, weights) for _ in range(3)]
    whole.forget(300)
    cuts = np.split(np.arange(300), [1, 8])
    for part, rows in zip(parts, cuts, strict=True):
        part.forget(len(rows))
    rng = np.random.default_rng(2)
    for _ in range(4):
        x = rng.standard_normal((300, 80)).astype(np.float32)
        together = whole(x)
        apart = np.concatenate([part(x[rows]) for part, rows in zip(parts, cuts, strict=True)])
        np.testing.assert_allclose(together, apart, rtol=0, atol=1e-11)
        assert (together.argmax(1) == apart.argmax(1)).all()


@pytest.mark.parametrize("rows", [1, 51, 52, 53, 500])
def test_a_product_in_parts_is_the_product(rows):
    rng = np.random.default_rng(3)
    x, weight = rng.standard_normal((rows, 80)), rng.standard_normal((64, 80))
    np.testing.assert_allclose(_product(x, weight), x @ weight.T, rtol=0, atol=1e-12)


def test_no_product_of_small_layers_is_shared_among_threads(monkeypatch):
    sizes = []
    matmul = np.matmul

    def measured(one, other, out):
        sizes.append(one.shape[0] * one.shape[1] * other.shape[1])
        return matmul(one, other, out=out)

    monkeypatch.setattr(np, "matmul", measured)
    config = NetworkConfig((64, 128), "relu")
    Network(config, drawn_weights(config, 52, 5))(np.ones((1000, 52), np.float32))
    assert len(sizes) > 3
    assert max(sizes) <= 2**18  # OpenBLAS's own threshold


def test_a_memory_is_that_of_marked_teams_alone_after_forgetting():
    config = NetworkConfig((4,), rnn_hidden_dim=3)
    weights = drawn_weights(config, 2, 5)
    forgets, keeps, fresh = (Network(config, weights) for _ in range(3))
    x = np.random.default_rng(1).standard_normal((3, 2, 2)).astype(np.float32)
    for network in (forgets, keeps):
        network.forget(2)
        network(x[0])
        network(x[1])
    forgets.forget(2, np.array([False, True]))
    fresh.forget(2)
    after, kept, new = forgets(x[2]), keeps(x[2]), fresh(x[2])
    assert (after[0] == kept[0]).all()
    assert (after[1] == new[1]).all()
    assert not np.allclose(kept[1], new[1])


@pytest.mark.parametrize("teams", [1, 2])
def test_a_memory_needs_to_know_for_how_many_teams(teams):
    config = NetworkConfig((4,), rnn_hidden_dim=3)
    network = Network(config, drawn_weights(config, 2, 5))
    with pytest.raises(RuntimeError, match=rf"call reset\(seeds\) for {teams} teams first"):
        network(np.zeros((teams, 2), np.float32))


@pytest.mark.parametrize("activation", ACTIVATIONS)
def test_huge_inputs_do_not_overflow(activation):
    config = NetworkConfig((4,), activation, rnn_hidden_dim=3)
    network = Network(config, drawn_weights(config, 2, 5, scale=1e4))
    network.forget(2)
    assert np.isfinite(network(np.full((2, 2), 1e6, np.float32))).all()


def test_the_shapes_of_the_weights():
    assert NetworkConfig((64, 32)).shapes(10, 5) == {
        "layer0.weight": (64, 10),
        "layer0.bias": (64,),
        "layer1.weight": (32, 64),
        "layer1.bias": (32,),
        "layer2.weight": (5, 32),
        "layer2.bias": (5,),
    }
    assert NetworkConfig((8,), rnn_hidden_dim=4).shapes(10, 2) == {
        "memory.input_weight": (12, 10),
        "memory.hidden_weight": (12, 4),
        "memory.input_bias": (12,),
        "memory.hidden_bias": (12,),
        "layer0.weight": (8, 4 + 10),
        "layer0.bias": (8,),
        "layer1.weight": (2, 8),
        "layer1.bias": (2,),
    }


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"hidden_dims": ()}, "number of hidden_dims lies in 1 to"),
        ({"hidden_dims": (64, 0)}, "each of hidden_dims lies in 1 to .*, but got 0"),
        ({"rnn_hidden_dim": -1}, "rnn_hidden_dim lies in 0 to .*, but got -1"),
        ({"hidden_dims": (64.0,)}, "each of hidden_dims is a whole number, not 64.0"),
        ({"rnn_hidden_dim": True}, "rnn_hidden_dim is a whole number, not True"),
        ({"activation": "gelu"}, "activation is one of relu, elu, tanh, not 'gelu'"),
    ],
    ids=str,
)
def test_impossible_networks_are_refused(settings, message):
    with pytest.raises((ValueError, TypeError), match=message):
        NetworkConfig(**settings)


def test_sizes_may_come_as_a_list_as_json_has_them():
    assert NetworkConfig([8, 4]) == NetworkConfig((8, 4))


def test_inputs_of_marked_teams_alone_are_remembered():
    config = NetworkConfig((4,), rnn_hidden_dim=3)
    weights = drawn_weights(config, 2, 5)
    some, plain = (Network(config, weights) for _ in range(2))
    x = np.random.default_rng(1).standard_normal((3, 2, 2)).astype(np.float32)
    for network in (some, plain):
        network.forget(2)
        network(x[0])
    first = plain(x[1])
    # answers are the same whether or not they are to be remembered
    np.testing.assert_array_equal(some(x[1], np.array([False, False])), first)
    np.testing.assert_array_equal(some(x[1], np.array([True, False])), first)
    np.testing.assert_array_equal(some(x[1], np.array([False, True]))[1], first[1])
    np.testing.assert_array_equal(some(x[2]), plain(x[2]))
