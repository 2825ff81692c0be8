"""Elementary functions with the same result to the bit on every processor.

NumPy, BLAS and the C library choose their loops by the processor, with and without fused
multiply-add, AVX2 or AVX-512, and the loops differ in the last bit. A car that has nearly stopped
steers by errors divided by its speed, so there one bit grows to centimetres. The functions here use
only operations that IEEE 754 rounds in one way: + - * /, square root and fused multiply-add (which
the C library computes exactly where the processor has none). Therefore the batched world gives the
same episode to the bit everywhere.

Largest errors, in units of the last place; 0.5 is the rounding of the result itself:

=====================  ====================  =====
function               range                 error
=====================  ====================  =====
:func:`sin_cos`        up to 1e5 rad         0.8
:func:`tan`            up to π/2 rad         0.9
:func:`arcsin`         up to 1               0.52
:func:`arctan`         up to 1e300           0.52
:func:`arctan2`        1e-290 to 1e300, 0    0.52
:func:`fourth_power`   1e-70 to 1e70, 0      0.51
=====================  ====================  =====
"""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Any

import numpy as np
from numba import types
from numba.extending import intrinsic

from hmi_marl.envs.worlds.batched.compiler import WITHOUT_COMPILER, compiled, inlined


def _fma_compiled(typing_context: Any, x: Any, y: Any, z: Any) -> Any:
    number = types.float64

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.fma(*arguments)

    return number(number, number, number), codegen


def _fma_in_python(x: float, y: float, z: float) -> float:
    return float(Fraction(x) * Fraction(y) + Fraction(z))


fma: Any = _fma_in_python if WITHOUT_COMPILER else intrinsic(_fma_compiled)
"""x * y + z with one rounding."""

_QUARTER_TURN, _QUARTER_TURN_LOW = 1.5707963267948966, 6.123233995736766e-17
"""π/2, and what its double leaves out."""
_PART_1, _PART_2, _PART_3 = 1.5707963267341256, 6.077100506303966e-11, 2.0222662487959506e-21
"""π/2 in three parts. Two have 33 bits, so that up to 2^20 times each of them is exact."""

_SIN = tuple((-1) ** k / math.factorial(2 * k + 1) for k in range(9))
_COS = tuple((-1) ** k / math.factorial(2 * k) for k in range(9))
_ARCTAN = tuple((-1) ** k / (2 * k + 1) for k in range(8))
_ARCSIN = tuple(math.comb(2 * k, k) / (4**k * (2 * k + 1)) for k in range(8))
"""Taylor's coefficients. What they leave out is below 2^-57 of the result where they are used."""

_STEPS = 8
_ANGLES = np.array(
    [
        [0.0, 0.0],
        [0.12435499454676144, -3.1253241424539383e-18],
        [0.24497866312686414, 1.0698755618734451e-17],
        [0.35877067027057225, -2.4623815582638635e-17],
        [0.4636476090008061, 2.2698777452961687e-17],
        [0.5585993153435624, -5.4556305485916264e-18],
        [0.6435011087932844, 1.5834785051444286e-17],
        [0.7188299996216245, -2.1478388444456983e-17],
        [0.7853981633974483, 3.061616997868383e-17],
    ]
)
"""Arctangents of 0, 1/8, ..., 1: the double, and what it leaves out."""
_SMALL = 1 / 32
"""Largest argument at which the arcsine's series needs no division."""


@inlined
def _reduced(x):
    """(n modulo 4, high, low) where x = n π/2 + high + low and |high| ≤ π/4."""
    if abs(x) <= math.pi / 4:
        return 0, x, 0.0
    n = np.rint(x * (2 / math.pi))
    rest = x - n * _PART_1
    step = n * _PART_2
    first = rest - step
    low = ((rest - first) - step) - n * _PART_3
    high = first + low
    return int(n) & 3, high, (first - high) + low


@inlined
def _sine(r, low):
    """Sine of r + low within ±π/4, as an unevaluated sum of two numbers."""
    z = r * r
    tail = fma(z, fma(z, fma(z, fma(z, _SIN[8], _SIN[7]), _SIN[6]), _SIN[5]), _SIN[4])
    tail = fma(z, fma(z, fma(z, tail, _SIN[3]), _SIN[2]), _SIN[1])
    correction = fma(r * z, tail, low * (1.0 - 0.5 * z))
    total = r + correction
    return total, (r - total) + correction


@inlined
def _cosine(r, low):
    """Cosine of r + low within ±π/4, as an unevaluated sum of two numbers."""
    z = r * r
    half, rest = 0.5 * z, 0.5 * fma(r, r, -z)
    tail = fma(z, fma(z, fma(z, _COS[8], _COS[7]), _COS[6]), _COS[5])
    tail = fma(z, fma(z, fma(z, tail, _COS[4]), _COS[3]), _COS[2])
    first = 1.0 - half
    correction = ((1.0 - first) - half) + (fma(z * z, tail, -rest) - r * low)
    total = first + correction
    return total, (first - total) + correction


@compiled
def sin_cos(x):
    """Sine and cosine of an angle [rad]."""
    n, r, low = _reduced(x)
    sine, _ = _sine(r, low)
    cosine, _ = _cosine(r, low)
    if n & 1:
        sine, cosine = cosine, -sine
    if n & 2:
        sine, cosine = -sine, -cosine
    return sine, cosine


@compiled
def tan(x):
    """Tangent of an angle [rad]."""
    n, r, low = _reduced(x)
    top, top_low = _sine(r, low)
    bottom, bottom_low = _cosine(r, low)
    if n & 1:
        top, top_low, bottom, bottom_low = bottom, bottom_low, -top, -top_low
    ratio = top / bottom
    return ratio + (fma(-ratio, bottom, top) + (top_low - ratio * bottom_low)) / bottom


@inlined
def _angle(y, x):
    """Angle of the point (x, y), as an unevaluated sum; both at least 0, and not both 0.

    With t = (y - c x) / (x + c y), arctan(y / x) = arctan(c) + arctan(t). c is the nearest eighth,
    so |t| is at most 1/16. Beyond the diagonal the complement to a quarter turn is computed.
    """
    steep = y > x
    if steep:
        y, x = x, y
    near = int(np.rint(_STEPS * (y / x)))
    c = near / _STEPS
    top, bottom = fma(-c, x, y), fma(c, y, x)
    t = top / bottom
    rest = fma(-t, bottom, top) - t * fma(c, y, x - bottom)
    z = t * t
    tail = fma(z, fma(z, fma(z, _ARCTAN[7], _ARCTAN[6]), _ARCTAN[5]), _ARCTAN[4])
    tail = fma(z, fma(z, fma(z, tail, _ARCTAN[3]), _ARCTAN[2]), _ARCTAN[1])
    high, low = t, fma(t * z, tail, rest / bottom)
    if near > 0:
        total = _ANGLES[near, 0] + t
        low += _ANGLES[near, 1] + ((_ANGLES[near, 0] - total) + t)
        high = total
    if steep:
        total = _QUARTER_TURN - high
        low = ((_QUARTER_TURN - total) - high) + (_QUARTER_TURN_LOW - low)
        high = total
    return high, low


@compiled
def arctan(x):
    """Arctangent [rad]."""
    high, low = _angle(abs(x), 1.0)
    return math.copysign(high + low, x)


@compiled
def arctan2(y, x):
    """Angle of the point (x, y) from -π to π [rad]; 0 for (0, 0)."""
    if x == 0.0 and y == 0.0:
        return 0.0
    high, low = _angle(abs(y), abs(x))
    if x < 0.0:
        total = 2 * _QUARTER_TURN - high
        low = ((2 * _QUARTER_TURN - total) - high) + (2 * _QUARTER_TURN_LOW - low)
        high = total
    return math.copysign(high + low, y)


@compiled
def arcsin(x):
    """Arcsine of a number from -1 to 1 [rad]."""
    z = x * x
    if abs(x) < _SMALL:
        tail = fma(z, fma(z, fma(z, _ARCSIN[5], _ARCSIN[4]), _ARCSIN[3]), _ARCSIN[2])
        return fma(x * z, fma(z, tail, _ARCSIN[1]), x)
    square = 1.0 - z
    rest = ((1.0 - square) - z) - fma(x, x, -z)
    if square == 0.0:
        return math.copysign(_QUARTER_TURN, x)
    other = math.sqrt(square)
    high, low = _angle(abs(x), other)
    other_low = (fma(-other, other, square) + rest) / (2.0 * other)
    return math.copysign(high + (low - abs(x) * other_low), x)


@compiled
def fourth_power(x):
    """The number x to the power of 4."""
    square = x * x
    rest = fma(x, x, -square)
    result = square * square
    return result + (fma(square, square, -result) + 2.0 * square * rest)
