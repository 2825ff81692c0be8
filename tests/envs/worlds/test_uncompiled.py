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

STEPS = (
    "import numpy as np\n"
    "from step_ways import *\n"
    "from hmi_marl import Scene, TeamConfig\n"
    "from hmi_marl.envs.series import Series\n"
    "seeds = np.arange(3, dtype=np.uint64)\n"
    "for settings in CONFIGS.values():\n"
    "    config = TeamConfig(duration=1.0, scene=Scene(vehicles=3), **settings)\n"
    "    played = []\n"
    "    for way in WAYS:\n"
    "        teams = teams_of(way, config, 3)\n"
    "        teams.reset(seeds)\n"
    "        teams.whole_actions(np.array([[1.0], [4.0]]), (5,))\n"
    "        try: teams.whole_actions(np.array([[1.5]]), (5,))\n"
    "        except ValueError: pass\n"
    "        played.append(play(teams, 11, 0, Series(seeds, config.population)))\n"
    "    for one in zip(*played, strict=True):\n"
    "        assert len({array.tobytes() for array in one}) == 1\n"
    "print('same')"
)


def test_as_plain_python_steps_of_teams_are_the_same_and_it_follows_highway_env_too():
    env = os.environ | {"NUMBA_DISABLE_JIT": "1", "PYTHONPATH": str(TESTS)}
    command = [sys.executable, "-W", "ignore", "-c", f"{STEPS}\n{CODE}"]
    run = subprocess.run(command, env=env, capture_output=True, text=True, check=False)
    assert run.stdout.split() == ["same", "same"], run.stderr
