"""Elementary functions: their error in units of the last place, by arithmetic of 160 bits."""

import inspect
import math
import re

import mpmath
import numpy as np
import pytest
from numba import njit

from hmi_marl.envs.worlds.batched import elementary

sin_cos = elementary.sin_cos
sine, cosine = njit(lambda x: sin_cos(x)[0]), njit(lambda x: sin_cos(x)[1])
COUNT = 1000

FUNCTIONS = {
    "sin": (sine, mpmath.sin, 1e5, 0.8),
    "cos": (cosine, mpmath.cos, 1e5, 0.8),
    "tan": (elementary.tan, mpmath.tan, math.pi / 2, 0.9),
    "arcsin": (elementary.arcsin, mpmath.asin, 1.0, 0.52),
    "arctan": (elementary.arctan, mpmath.atan, 1e12, 0.52),
    "fourth_power": (elementary.fourth_power, lambda x: x**4, 1e70, 0.51),
}
"""Ours, the exact one, the largest argument, and the largest error that is documented."""


def arguments(largest, seed):
    """Numbers of either sign: spread evenly, over all sizes, and at the edges of branches."""
    rng = np.random.default_rng(seed)
    even = rng.uniform(-largest, largest, COUNT)
    unit = rng.uniform(-min(largest, 1.5), min(largest, 1.5), COUNT)
    sizes = 10 ** rng.uniform(-12, math.log10(largest), COUNT) * rng.choice([-1.0, 1.0], COUNT)
    near = [
        np.nextafter(place, side)
        for place in (1 / 32, 1 / 16, 3 / 16, 15 / 16, 1.0, math.pi / 4, math.pi / 2)
        for side in (-np.inf, place, np.inf)
    ]
    diagonal = math.pi / 4 * (1 + rng.choice([-1, 1], COUNT) * 10 ** rng.uniform(-8, -1, COUNT))
    edges = np.array([place for place in (*near, *diagonal) if place <= largest])
    return np.concatenate([even, unit, sizes, edges, -edges, [0.0]])


def error(found, exact):
    """The distance from the exact value in units of the last place."""
    return float(abs(mpmath.mpf(float(found)) - exact) / math.ulp(float(exact)))


@pytest.mark.parametrize("name", FUNCTIONS)
def test_errors_are_below_the_documented_ones(name):
    ours, exact, largest, most = FUNCTIONS[name]
    with mpmath.workprec(400):
        worst = max(
            error(ours(x), exact(mpmath.mpf(float(x)))) for x in arguments(largest, len(name))
        )
    assert worst <= most


def test_the_angle_of_a_point_in_every_quadrant():
    rng = np.random.default_rng(0)
    points = rng.normal(size=(COUNT, 2)) * 10 ** rng.uniform(-6, 6, (COUNT, 2))
    axes = [(0.0, 1.0), (1.0, 0.0), (0.0, -1.0), (-1.0, 0.0), (1.0, 1.0), (-1.0, 1.0), (-2.0, -2.0)]
    with mpmath.workprec(400):
        for y, x in [*points, *axes]:
            exact = mpmath.atan2(mpmath.mpf(float(y)), mpmath.mpf(float(x)))
            assert error(elementary.arctan2(float(y), float(x)), exact) <= 0.52, (y, x)
    assert elementary.arctan2(0.0, 0.0) == 0.0


def test_ends_of_ranges_and_zero():
    assert elementary.arcsin(1.0) == math.pi / 2
    assert elementary.arcsin(-1.0) == -math.pi / 2
    for function in (sine, elementary.tan, elementary.arcsin, elementary.arctan):
        assert function(0.0) == 0.0
    assert cosine(0.0) == 1.0
    assert elementary.arctan(1e308) == math.pi / 2


@pytest.mark.parametrize("name", ["sine", "arcsin", "arctan", "tan"])
def test_odd_functions_are_odd_to_the_bit(name):
    function = {"sine": sine}.get(name) or getattr(elementary, name)
    for x in np.random.default_rng(3).uniform(0, 1, 200):
        assert function(-x) == -function(x)


def test_multiplying_and_adding_round_once():
    fma = elementary.fma
    fused = njit(lambda x, y, z: fma(x, y, z))
    x = 1.0 + 2.0**-30
    assert fused(x, x, -1.0) == 2.0**-29 + 2.0**-60
    for x, y, z in np.random.default_rng(4).normal(size=(200, 3)):
        assert fused(x, y, z) == elementary._fma_in_python(x, y, z)


def test_the_documentation_states_these_errors():
    stated = re.findall(r"^:func:`(\w+)`.*?([\d.]+)$", inspect.getdoc(elementary), re.MULTILINE)
    most = {name: most for name, (_, _, _, most) in FUNCTIONS.items()}
    expected = {"sin_cos": most.pop("sin"), "arctan2": 0.52} | most
    expected.pop("cos")
    assert {name: float(error) for name, error in stated} == expected
