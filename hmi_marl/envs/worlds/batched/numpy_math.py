"""NumPy's own sine, arcsine, power and the like, called from compiled code.

highway-env computes with NumPy, whose functions differ from the C library's in the last bit on
processors with wide vectors. Mostly that does not matter; but a vehicle that has come to a stand at
the end of the ramp steers by errors divided by its speed, and there one bit grows into centimetres.
So the compiled world calls the very loops that NumPy calls. Their addresses, which differ from
process to process, are given to the linker by name, so that compiled code can be kept.
"""

from __future__ import annotations

import ctypes
from fractions import Fraction
from typing import Any

import numba
import numpy as np
from llvmlite import binding, ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

_FUNCTIONS_AT, _DATA_AT = 32, 40
"""Where PyUFuncObject keeps its loops and their data, in bytes (numpy/ufuncobject.h)."""
_HOLDERS: list[ctypes.c_void_p] = []


def _register(name: str, ufunc: np.ufunc) -> None:
    """Make the loop over float64 of a NumPy function known to the linker."""
    which = ufunc.types.index("d" * ufunc.nin + "->d")
    functions = ctypes.c_void_p.from_address(id(ufunc) + _FUNCTIONS_AT).value
    data = ctypes.c_void_p.from_address(id(ufunc) + _DATA_AT).value
    size = ctypes.sizeof(ctypes.c_void_p)
    loop = ctypes.c_void_p.from_address((functions or 0) + which * size).value
    holder = ctypes.c_void_p.from_address((data or 0) + which * size) if data else None
    kept = ctypes.c_void_p(holder.value if holder is not None else None)
    _HOLDERS.append(kept)  # the linked code reads it as long as the process lives
    binding.add_symbol(f"hmi_marl_{name}", loop)
    binding.add_symbol(f"hmi_marl_{name}_data", ctypes.addressof(kept))


def _loop(name: str, ufunc: np.ufunc) -> Any:
    """A compiled function of one or two numbers that calls NumPy's loop for one element."""
    _register(name, ufunc)
    inputs = ufunc.nin

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        double, word, byte = ir.DoubleType(), ir.IntType(64), ir.IntType(8).as_pointer()
        result = cgutils.alloca_once(builder, double)
        slots = [cgutils.alloca_once_value(builder, argument) for argument in arguments]
        pointers = [builder.bitcast(slot, byte) for slot in (*slots, result)]
        table = cgutils.alloca_once(builder, ir.ArrayType(byte, inputs + 1))
        for k, pointer in enumerate(pointers):
            builder.store(pointer, cgutils.gep_inbounds(builder, table, 0, k))
        steps = ir.Constant(ir.ArrayType(word, inputs + 1), [8] * (inputs + 1))
        strides = cgutils.alloca_once_value(builder, steps)
        count = cgutils.alloca_once_value(builder, ir.Constant(word, 1))
        kind = ir.FunctionType(
            ir.VoidType(), [byte.as_pointer(), word.as_pointer(), word.as_pointer(), byte]
        )
        function = cgutils.get_or_insert_function(builder.module, kind, f"hmi_marl_{name}")
        data = builder.module.globals.get(f"hmi_marl_{name}_data")
        if data is None:
            data = ir.GlobalVariable(builder.module, byte, f"hmi_marl_{name}_data")
        builder.call(
            function,
            [
                cgutils.gep_inbounds(builder, table, 0, 0),
                count,
                cgutils.gep_inbounds(builder, strides, 0, 0),
                builder.load(data),
            ],
        )
        return builder.load(result)

    number = types.float64

    def of_one(typing_context: Any, x: Any) -> Any:
        return number(number), codegen

    def of_two(typing_context: Any, x: Any, y: Any) -> Any:
        return number(number, number), codegen

    return intrinsic(of_one if inputs == 1 else of_two)


def _fused(typing_context: Any, x: Any, y: Any, z: Any) -> Any:
    number = types.float64

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.fma(*arguments)

    return number(number, number, number), codegen


def _fused_in_python(x: float, y: float, z: float) -> float:
    return float(Fraction(x) * Fraction(y) + Fraction(z))


_UFUNCS = {
    "sin": np.sin,
    "cos": np.cos,
    "tan": np.tan,
    "arcsin": np.arcsin,
    "arctan": np.arctan,
    "power": np.power,
}
_LOOPS: dict[str, Any] = (  # under NUMBA_DISABLE_JIT nothing is compiled
    dict(_UFUNCS)
    if numba.config.DISABLE_JIT  # type: ignore[attr-defined]
    else {name: _loop(name, ufunc) for name, ufunc in _UFUNCS.items()}
)
sin, cos, tan = _LOOPS["sin"], _LOOPS["cos"], _LOOPS["tan"]
arcsin, arctan, power = _LOOPS["arcsin"], _LOOPS["arctan"], _LOOPS["power"]
fused: Any = (
    _fused_in_python if numba.config.DISABLE_JIT else intrinsic(_fused)  # type: ignore[attr-defined]
)
"""x * y + z with one rounding, as BLAS sums up NumPy's dot products."""
