"""Compilation of the batched world's functions."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from typing import Any

import numba
from numba import njit

from hmi_marl.envs.worlds.batched.kept_code import KeptCode, one_process_at_a_time

_OPTIONS: dict[str, Any] = {"error_model": "numpy", "_nrt": False}

compiled: Any = njit(**_OPTIONS)
"""A function of one world. It divides by zero as NumPy does, and it makes no arrays and counts no
references to them, which would cost more than all the rest."""

inlined: Any = njit(forceinline=True, **_OPTIONS)
"""The same, always merged into its caller."""


def kernel(loop: Callable[..., None]) -> Any:
    """Compile a loop over worlds when :func:`prepare` is called, or take what was kept of it."""
    function: Any = njit(nogil=True, error_model="numpy")(loop)
    if not numba.config.DISABLE_JIT:  # type: ignore[attr-defined]
        function._cache = KeptCode(loop)
    return function


def prepare(calls: Sequence[tuple[Any, tuple[Any, ...]]]) -> None:
    """Compile kernels for the types of the arguments that they will be called with.

    Compiles all of them together, so that a user waits, and reads about it, only once.

    Args:
        calls: pairs of a kernel and an example of its arguments.
    """
    if numba.config.DISABLE_JIT:  # type: ignore[attr-defined]
        return
    wanted = [(each, tuple(numba.typeof(one) for one in given)) for each, given in calls]
    if all(types in each.overloads for each, types in wanted):
        return
    start = time.perf_counter()
    with one_process_at_a_time():
        for each, types in wanted:
            each.compile(types)
    if any(each.stats.cache_misses.get(types) for each, types in wanted):
        print(f"hmi-marl: compiled in {time.perf_counter() - start:.0f} s", file=sys.stderr)
