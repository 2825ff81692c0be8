"""Export learned policies as ONNX models for other programs and languages.

The graph is built from a policy's card and weights, in single precision. For N teams:

====================  ====================  ======================================================
name                  type and shape        meaning
====================  ====================  ======================================================
``observation``       float32 (N, columns)  the parts in ``card.reads``, in their order; after them
                                            one-hot a^H (5 columns) if the policy is ``by_intent``
``context``           float32 (N, Z)        z, only if the policy is conditioned on it
``memory_in``         float32 (N, H)        only of a recurrent policy: zeros at the start of an
                                            episode, later ``memory_out`` of the last step
``probabilities``     float32 (N, actions)  π(a | observation)
``action``            int64 (N,)            the likeliest action
``memory_out``        float32 (N, H)        only of a recurrent policy
====================  ====================  ======================================================

The model's metadata holds ``observation``, the names and sizes of its columns in order, and
``card``, the policy's card, both as JSON.

Needs onnx, which comes with the ``train`` extra.
"""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hmi_marl.agents.learned.network import Weights
from hmi_marl.agents.learned.policy import FORMAT, INTENT, INTENTS, LearnedPolicy, PolicyCard
from hmi_marl.extras import needing
from hmi_marl.files import write_bytes

with needing("exporting to ONNX"):
    import onnx
    from onnx import TensorProto, helper, numpy_helper

OPSET, IR_VERSION = 18, 9
"""Versions that runtimes of 2023 support."""
_ACTIVATIONS = {"relu": "Relu", "elu": "Elu", "tanh": "Tanh"}
_GRU = ("input_weight", "hidden_weight", "input_bias", "hidden_bias")


def export_onnx(policy: LearnedPolicy | tuple[PolicyCard, Weights], path: Path) -> None:
    """Write a policy, or what :func:`read_policy` returns, to ``path`` as ONNX, atomically.

    Raises:
        ValueError: weights that do not fit the card.
    """
    card, weights = (policy.card, policy.weights) if isinstance(policy, LearnedPolicy) else policy
    FORMAT.check(card, weights)
    write_bytes(path, _model(card, weights).SerializeToString())


def observed_columns(card: PolicyCard) -> tuple[tuple[str, int], ...]:
    """Return names and sizes of the parts of the model's ``observation``, in order."""
    return (*card.reads, (INTENT, INTENTS)) if card.by_intent else card.reads


def _model(card: PolicyCard, weights: Weights) -> onnx.ModelProto:
    """Build the model; see the module's docstring."""
    columns = observed_columns(card)
    inputs = {"observation": sum(size for _, size in columns)}
    if card.context:
        inputs["context"] = card.context
    if card.network.rnn_hidden_dim:
        inputs["memory_in"] = card.network.rnn_hidden_dim
    outputs = [
        _value("probabilities", TensorProto.FLOAT, card.actions),
        _value("action", TensorProto.INT64),
    ]
    if card.network.rnn_hidden_dim:
        outputs.append(_value("memory_out", TensorProto.FLOAT, card.network.rnn_hidden_dim))

    nodes = _Nodes(weights)
    x = _read(nodes, card)
    if card.network.rnn_hidden_dim:
        remembered = _remember(nodes, card, weights, x)
        x = nodes.add("Concat", remembered, x, to="remembered", axis=1)
    logits = _layers(nodes, card, x)
    nodes.add("Softmax", logits, to="probabilities", axis=1)
    nodes.add("ArgMax", "probabilities", to="action", axis=1, keepdims=0)
    graph = helper.make_graph(
        nodes.nodes,
        f"policy of {card.seat}",
        [_value(name, TensorProto.FLOAT, size) for name, size in inputs.items()],
        outputs,
        [numpy_helper.from_array(array, name) for name, array in nodes.constants.items()],
    )
    model = helper.make_model(
        graph,
        producer_name="hmi-marl",
        opset_imports=[helper.make_opsetid("", OPSET)],
        ir_version=IR_VERSION,
    )
    card_text = json.dumps(asdict(card))
    helper.set_model_props(model, {"observation": json.dumps(columns), "card": card_text})
    return model


class _Nodes:
    """Nodes and constants of a graph under construction."""

    def __init__(self, weights: Weights) -> None:
        self.nodes: list[onnx.NodeProto] = []
        self.constants: dict[str, NDArray[Any]] = {
            name: np.asarray(weights[name], np.float32)
            for name in sorted(weights)
            if name.startswith("layer")
        }

    def add(self, operator: str, *inputs: str, to: str | tuple[str, ...], **attributes: Any) -> str:
        """Add a node; return the name of its last output."""
        outputs = (to,) if isinstance(to, str) else to
        self.nodes.append(helper.make_node(operator, inputs, outputs, outputs[-1], **attributes))
        return outputs[-1]

    def constant(self, name: str, values: ArrayLike, kind: type = np.int64) -> str:
        """Add a constant, by default of indices; return its name."""
        self.constants[name] = np.asarray(values, kind)
        return name


def _value(name: str, kind: int, *size: int) -> onnx.ValueInfoProto:
    return helper.make_tensor_value_info(name, kind, ["teams", *size])


def _read(nodes: _Nodes, card: PolicyCard) -> str:
    """Add the network's inputs: the observation, with a^H split off, and z."""
    x = "observation"
    if card.by_intent:
        sizes = nodes.constant("split_sizes", [card.inputs - card.context, INTENTS])
        nodes.add("Split", x, sizes, to=("seen", "intent"), axis=1)
        x = "seen"
    return nodes.add("Concat", x, "context", to="conditioned", axis=1) if card.context else x


def _remember(nodes: _Nodes, card: PolicyCard, weights: Weights, x: str) -> str:
    """Add the recurrent layer; return its new state."""
    gates = {name: _reordered(weights[f"memory.{name}"]) for name in _GRU}
    biases = np.concatenate([gates["input_bias"], gates["hidden_bias"]])
    kernels = [
        nodes.constant("memory_W", gates["input_weight"][None], np.float32),
        nodes.constant("memory_R", gates["hidden_weight"][None], np.float32),
        nodes.constant("memory_B", biases[None], np.float32),
    ]
    time = nodes.constant("time_axis", [0])
    seen = nodes.add("Unsqueeze", x, time, to="memory_X")
    before = nodes.add("Unsqueeze", "memory_in", time, to="memory_before")
    after = nodes.add(
        "GRU",
        seen,
        *kernels,
        "",  # no lengths
        before,
        to=("", "memory_after"),
        hidden_size=card.network.rnn_hidden_dim,
        linear_before_reset=1,
    )
    return nodes.add("Squeeze", after, time, to="memory_out")


def _reordered(gates: NDArray[np.floating]) -> NDArray[np.floating]:
    """Reorder gates from (reset, update, new) to ONNX's (update, reset, new)."""
    reset, update, new = np.split(gates, 3)
    return np.concatenate([update, reset, new])


def _layers(nodes: _Nodes, card: PolicyCard, x: str) -> str:
    """Add the layers; return the logits of the seat's actions."""
    last = len(card.network.hidden_dims)
    for layer in range(last + 1):
        name = f"layer{layer}"
        x = nodes.add("Gemm", x, f"{name}.weight", f"{name}.bias", to=name, transB=1)
        if layer < last:
            x = nodes.add(_ACTIVATIONS[card.network.activation], x, to=f"{name}.active")
    if not card.by_intent:
        return x
    shape = nodes.constant("by_intent_shape", [-1, INTENTS, card.actions])
    nodes.add("Reshape", x, shape, to="by_intent")
    nodes.add("Unsqueeze", "intent", nodes.constant("action_axis", [2]), to="intent_column")
    nodes.add("Mul", "by_intent", "intent_column", to="of_intent")
    axis = nodes.constant("intent_axis", [1])
    return nodes.add("ReduceSum", "of_intent", axis, to="logits", keepdims=0)
