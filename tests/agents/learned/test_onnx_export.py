import builtins
import importlib
import json
import sys

import numpy as np
import onnx
import pytest
from onnx.reference import ReferenceEvaluator

from hmi_marl.agents.learned.network import NetworkConfig
from hmi_marl.agents.learned.onnx_export import export_onnx, observed_columns
from hmi_marl.agents.learned.policy import LearnedPolicy, make_card, read_policy, save_policy
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.observations import driver_layout, vehicle_ai_layout

CONFIG = TeamConfig()
LAYOUTS = {"driver": driver_layout(CONFIG), "vehicle_ai": vehicle_ai_layout(CONFIG)}


def policy_for(seat, network=NetworkConfig((6, 5)), knows_traits=True, **card):  # noqa: B008
    made = make_card(seat, CONFIG, network, knows_traits, **card)
    rng = np.random.default_rng(1)
    weights = {
        name: (0.5 * rng.standard_normal(shape)).astype(np.float32)
        for name, shape in made.shapes.items()
    }
    return LearnedPolicy(made, weights, CONFIG)


def observations(seat, count=7, seed=0):
    layout, rng = LAYOUTS[seat], np.random.default_rng(seed)
    seen = rng.uniform(0, 1, (count, layout.size)).astype(np.float32)
    if "intended_action" in layout:
        seen[:, layout["intended_action"]] = np.eye(6, 5)[np.arange(count) % 6]  # the last: none
    return seen


def exported(policy, tmp_path):
    path = tmp_path / "policy.onnx"
    export_onnx(policy, path)
    onnx.checker.check_model(str(path), full_check=True)
    return onnx.load(path)


def fed(policy, seen):
    """Return the inputs of the model from an observation, by their names."""
    layout = LAYOUTS[policy.card.seat]
    parts = [seen[:, layout[name]] for name, _ in observed_columns(policy.card)]
    return {"observation": np.concatenate(parts, axis=1)}


@pytest.mark.parametrize("activation", ["relu", "elu", "tanh"])
@pytest.mark.parametrize("seat", ["driver", "vehicle_ai"])
def test_the_model_gives_the_policys_probabilities(tmp_path, seat, activation):
    policy = policy_for(seat, NetworkConfig((6, 5), activation))
    run = ReferenceEvaluator(exported(policy, tmp_path))
    for count in (1, 7):
        seen = observations(seat, count)
        probabilities, action = run.run(None, fed(policy, seen))
        expected = policy.probabilities(seen)
        np.testing.assert_allclose(probabilities, expected, atol=1e-5)
        assert probabilities.dtype == np.float32
        assert action.dtype == np.int64
        assert action.tolist() == expected.argmax(1).tolist()


def test_by_intent_takes_the_row_of_the_intent_and_even_odds_before_the_first(tmp_path):
    policy = policy_for("vehicle_ai", by_intent=True)
    run = ReferenceEvaluator(exported(policy, tmp_path))
    seen = observations("vehicle_ai")
    probabilities, _ = run.run(None, fed(policy, seen))
    np.testing.assert_allclose(probabilities, policy.probabilities(seen), atol=1e-5)
    assert probabilities[5].tolist() == [0.5, 0.5]


@pytest.mark.parametrize("by_intent", [False, True])
def test_a_context_is_an_input_of_its_own(tmp_path, by_intent):
    policy = policy_for("vehicle_ai", knows_traits=False, context=3, by_intent=by_intent)
    run = ReferenceEvaluator(exported(policy, tmp_path))
    seen = observations("vehicle_ai")
    policy.context = np.random.default_rng(3).standard_normal((7, 3))
    probabilities, _ = run.run(None, fed(policy, seen) | {"context": policy.context})
    np.testing.assert_allclose(probabilities, policy.probabilities(seen), atol=1e-5)


@pytest.mark.parametrize("by_intent", [False, True])
def test_a_memory_goes_from_step_to_step(tmp_path, by_intent):
    network = NetworkConfig((6,), "elu", rnn_hidden_dim=4)
    policy = policy_for("vehicle_ai", network, by_intent=by_intent)
    run = ReferenceEvaluator(exported(policy, tmp_path))
    policy.reset(np.arange(7, dtype=np.uint64))
    memory = np.zeros((7, 4), np.float32)
    for step in range(5):
        if step == 3:
            begins = np.arange(7) < 3
            policy.reset(np.arange(7, dtype=np.uint64), begins)
            memory = np.where(begins[:, None], np.float32(0), memory)
        seen = observations("vehicle_ai", seed=step)
        inputs = fed(policy, seen) | {"memory_in": memory}
        probabilities, action, memory = run.run(None, inputs)
        expected = policy.probabilities(seen)
        np.testing.assert_allclose(probabilities, expected, atol=1e-5)
        assert action.tolist() == expected.argmax(1).tolist()


def test_the_model_names_its_columns_and_its_card(tmp_path):
    policy = policy_for("vehicle_ai", by_intent=True, knows_traits=False, context=2)
    model = exported(policy, tmp_path)
    about = {prop.key: json.loads(prop.value) for prop in model.metadata_props}
    assert about["observation"][0] == ["lidar", 32]
    assert about["observation"][-1] == ["intended_action", 5]
    assert about["card"]["seat"] == "vehicle_ai"
    assert about["card"]["reads"] == about["observation"][:-1]
    shapes = {
        value.name: [dim.dim_value or dim.dim_param for dim in value.type.tensor_type.shape.dim]
        for value in (*model.graph.input, *model.graph.output)
    }
    assert shapes == {
        "observation": ["teams", policy.card.inputs - 2 + 5],
        "context": ["teams", 2],
        "probabilities": ["teams", 2],
        "action": ["teams"],
    }


def test_a_policy_in_files_is_exported_as_it_is(tmp_path):
    policy = policy_for("driver")
    read = read_policy(save_policy(tmp_path, policy.card, policy.weights))
    export_onnx(policy, tmp_path / "one.onnx")
    export_onnx(read, tmp_path / "two.onnx")
    assert (tmp_path / "one.onnx").read_bytes() == (tmp_path / "two.onnx").read_bytes()


def test_weights_that_do_not_fit_are_refused_and_leave_nothing(tmp_path):
    card = policy_for("driver").card
    with pytest.raises(ValueError, match="do not fit the policy's card"):
        export_onnx((card, {}), tmp_path / "policy.onnx")
    assert list(tmp_path.iterdir()) == []


def test_without_onnx_the_error_says_what_to_install(monkeypatch):
    name = "hmi_marl.agents.learned.onnx_export"
    importing = builtins.__import__

    def without(module, *args, **kwargs):
        if module.split(".")[0] == "onnx":
            raise ModuleNotFoundError("No module named 'onnx'", name="onnx")
        return importing(module, *args, **kwargs)

    monkeypatch.delitem(sys.modules, name)
    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(
        ModuleNotFoundError, match=r"ONNX needs onnx: pip install 'hmi-marl\[train\]'"
    ):
        importlib.import_module(name)


@pytest.mark.parametrize("by_intent", [False, True])
def test_a_model_of_graded_alerts_gives_the_policys_probabilities(tmp_path, by_intent):
    config = TeamConfig(alert_strengths=(0.25, 0.5, 1.0))
    card = make_card("vehicle_ai", config, NetworkConfig((6,)), True, by_intent=by_intent)
    rng = np.random.default_rng(2)
    weights = {n: rng.standard_normal(shape).astype("f4") for n, shape in card.shapes.items()}
    policy = LearnedPolicy(card, weights, config)
    seen = observations("vehicle_ai")  # laid out as without grades
    found, action = ReferenceEvaluator(exported(policy, tmp_path)).run(None, fed(policy, seen))
    expected = policy.probabilities(seen)
    assert expected.shape == (7, 4)
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-6)
    assert action.tolist() == expected.argmax(axis=1).tolist()
