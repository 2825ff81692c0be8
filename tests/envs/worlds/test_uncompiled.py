"""The batched world without its compiler: the same functions, run as plain Python."""

import os
import subprocess
import sys
from pathlib import Path

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
