"""The batched world without its compiler: the same functions, run as plain Python."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numba import njit

from hmi_marl.envs.worlds.batched import numpy_math as nm

TESTS = Path(__file__).parents[2]
CODE = (
    "from parity import *\n"
    "assert_parity(Scene(lanes=2, vehicles=10), range(4), duration=7.0, inflation=6.0)\n"
    "assert_parity(Scene(vehicles=6), [3], duration=10.0, driver='rule')\n"
    "assert_parity(Scene(lanes=1, vehicles=12), [1], duration=5.0, inflation=2.0)\n"
    "print('same')"
)


def test_it_follows_highway_env_as_plain_python_too():
    env = os.environ | {"NUMBA_DISABLE_JIT": "1", "PYTHONPATH": str(TESTS)}
    command = [sys.executable, "-W", "ignore", "-c", CODE]
    run = subprocess.run(command, env=env, capture_output=True, text=True, check=False)
    assert run.stdout.strip().endswith("same"), run.stderr


@pytest.mark.parametrize("name", ["sin", "cos", "tan", "arcsin", "arctan"])
def test_compiled_functions_give_numpys_bits(name):
    ours, numpys = getattr(nm, name), getattr(np, name)
    compiled = njit(lambda x: ours(x))
    for x in np.random.default_rng(0).uniform(-1, 1, 2000):
        assert compiled(x) == numpys(x)


def test_compiled_powers_and_dot_products_give_numpys_bits():
    power, fused = nm.power, nm.fused
    compiled_power = njit(lambda x: power(x, 4.0))
    compiled_dot = njit(lambda a, b: fused(a[1], b[1], a[0] * b[0]))
    rng = np.random.default_rng(0)
    for x in rng.uniform(0, 1.5, 2000):
        assert compiled_power(x) == np.power(x, 4.0)
    for a, b in rng.normal(size=(2000, 2, 2)):
        assert compiled_dot(a, b) == np.dot(a, b)
