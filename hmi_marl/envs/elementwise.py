"""Parts of rules that are written once and run two ways: on arrays, and compiled for one team.

The rules of a step (:mod:`attention`, :mod:`alerts`, :mod:`rewards`, :mod:`team_step` and
:mod:`observation_values`) work element by element. NumPy applies them to the arrays of all teams at
once; the compiled loops (:mod:`loops`) apply the same functions to the numbers of one team after
the other. What the two spell differently stands here for NumPy, and in :mod:`compiled_rules` for
numba.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

EVERY = slice(None)
"""All teams at once, as the number of a team."""

_Rule = TypeVar("_Rule", bound=Callable[..., Any])


def elementwise(rule: _Rule) -> _Rule:
    """Let a rule that works on arrays take lists too; ``rule`` stays reachable for the compiler."""

    @functools.wraps(rule)
    def on_arrays(*arguments: Any) -> Any:
        return rule(*(np.asarray(each) for each in arguments))

    return on_arrays  # type: ignore[return-value]


def choose(condition: Any, yes: Any, no: Any) -> Any:
    """``yes`` where the condition holds, ``no`` elsewhere."""
    return np.where(condition, yes, no)


def within(value: Any, low: Any, high: Any) -> Any:
    """Keep values between two bounds; NaN stays NaN."""
    return choose(value < low, low, choose(value > high, high, value))


def put(
    rows: NDArray[np.float32],
    row: Any,
    column: int,
    low: np.float32,
    high: np.float32,
    value: Any,
) -> None:
    """Write one number into a column, within its bounds; nothing if the column is -1."""
    if column >= 0:
        rows[row, column] = within(np.float32(value), low, high)


def put_one_hot(rows: NDArray[np.float32], row: Any, column: int, index: Any, size: int) -> None:
    """Write ``size`` columns, 1 at the index and 0 elsewhere; all 0 if the index is -1."""
    if column >= 0:
        rows[row, column : column + size] = np.expand_dims(index, -1) == np.arange(size)


def put_row(rows: NDArray[Any], row: Any, column: int, values: Any) -> None:
    """Write as many columns as there are values, as they are."""
    if column >= 0:
        rows[row, column : column + values.shape[-1]] = values


def put_scaled(
    rows: NDArray[np.float32], row: Any, column: int, values: Any, scale: Any, bound: Any
) -> None:
    """Write a table of values divided by a scale and kept within -bound to bound, cell by cell."""
    if column >= 0:
        size = values.shape[-2] * values.shape[-1]
        scaled = within(values / scale, -bound, bound).reshape(*values.shape[:-2], size)
        rows[row, column : column + size] = scaled
