"""What numba needs to know to compile the rules of a step; imported for that alone.

The rules are those that NumPy applies to all teams at once (:mod:`hmi_marl.envs.elementwise`).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba.extending import overload, register_jitable

from hmi_marl.envs import alerts, attention, elementwise, rewards, streams, team_step
from hmi_marl.envs import observation_values as values

_OPTIONS: Any = {"error_model": "numpy", "forceinline": True, "_nrt": False}

for rule in (
    alerts.help_share,
    alerts.next_level,
    attention.next_attention,
    elementwise.within,
    rewards.add_up,
    rewards.attention_values,
    rewards.driving_values,
    streams.mix_bits,
    streams.unit_draw,
    team_step.begin,
    team_step.decide,
    team_step.reward,
    team_step.score,
    values.write,
):
    register_jitable(**_OPTIONS)(rule)


def _compile_inside(rule: Any) -> None:
    """Let compiled code call a rule that takes lists too, without the part that takes lists."""
    overload(rule, jit_options=_OPTIONS, strict=False)(lambda *_: rule.__wrapped__)


_compile_inside(attention.next_acceptance)
_compile_inside(attention.distraction_probability)


@overload(elementwise.choose, jit_options=_OPTIONS, strict=False)
def _choose(condition: Any, yes: Any, no: Any) -> Any:
    return lambda condition, yes, no: yes if condition else no


@overload(elementwise.put, jit_options=_OPTIONS, strict=False)
def _put(rows: Any, row: Any, column: Any, low: Any, high: Any, value: Any) -> Any:
    def put(rows: Any, row: Any, column: Any, low: Any, high: Any, value: Any) -> None:
        if column >= 0:
            rows[row, column] = elementwise.within(np.float32(value), low, high)

    return put


@overload(elementwise.put_one_hot, jit_options=_OPTIONS, strict=False)
def _put_one_hot(rows: Any, row: Any, column: Any, index: Any, size: Any) -> Any:
    def put_one_hot(rows: Any, row: Any, column: Any, index: Any, size: Any) -> None:
        if column >= 0:
            for value in range(size):
                rows[row, column + value] = 1.0 if value == index else 0.0

    return put_one_hot


@overload(elementwise.put_row, jit_options=_OPTIONS, strict=False)
def _put_row(rows: Any, row: Any, column: Any, values: Any) -> Any:
    def put_row(rows: Any, row: Any, column: Any, values: Any) -> None:
        if column >= 0:
            for place in range(len(values)):
                rows[row, column + place] = values[place]

    return put_row


@overload(elementwise.put_scaled, jit_options=_OPTIONS, strict=False)
def _put_scaled(rows: Any, row: Any, column: Any, values: Any, scale: Any, bound: Any) -> Any:
    def put_scaled(rows: Any, row: Any, column: Any, values: Any, scale: Any, bound: Any) -> None:
        if column >= 0:
            flat = values.reshape(values.size)
            # Indices into a slice are never negative, so the compiler writes several at once.
            places = rows[row, column : column + len(flat)]
            for place in range(len(flat)):
                places[place] = elementwise.within(flat[place] / scale, -bound, bound)

    return put_scaled
