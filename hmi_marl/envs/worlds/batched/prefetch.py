"""Ask for memory that will soon be written to, so that it is in the cache by then.

A step reads more memory than fits into a core's cache, and computes for long on little
of it. Rows that are asked for before such a computation cost nothing after it.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from hmi_marl.envs.worlds.batched.compiler import WITHOUT_COMPILER, inlined

_LINE = 64
"""Bytes that a processor takes from memory at once."""
_TO_WRITE, _KEEP, _DATA = 1, 3, 1
"""Arguments of LLVM's prefetch."""


def _ask_compiled(typing_context: Any, array: Any, place: Any) -> Any:
    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kind, _ = signature.args
        data = cgutils.create_struct_proxy(kind)(context, builder, arguments[0]).data
        where = builder.bitcast(builder.gep(data, [arguments[1]]), cgutils.voidptr_t)
        number = ir.IntType(32)
        signature_of_it = ir.FunctionType(ir.VoidType(), [cgutils.voidptr_t, *[number] * 3])
        prefetch = builder.module.declare_intrinsic(
            "llvm.prefetch", [cgutils.voidptr_t], signature_of_it
        )
        builder.call(prefetch, [where, *map(number, (_TO_WRITE, _KEEP, _DATA))])
        return context.get_dummy_value()

    return types.void(array, types.int64), codegen


def _ask_in_python(array: Any, place: int) -> None:
    """Do nothing."""


_ask: Any = _ask_in_python if WITHOUT_COMPILER else intrinsic(_ask_compiled)


@inlined
def ask_for_rows(table, first, last):
    """Ask for rows ``first`` to ``last`` - 1 of a table, whose rows follow each other in memory."""
    columns = table.shape[1]
    step = _LINE // table.itemsize
    for place in range(first * columns, last * columns, step):
        _ask(table, place)
