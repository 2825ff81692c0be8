"""The batched world among forks, pools and other libraries' threads, in fresh processes.

Gymnasium's, SuperSuit's and Stable-Baselines3's processes are in ``tests/trainers``.
"""

import json
import os
import subprocess
import sys

import pytest

from hmi_marl.envs.worlds.batched.threads import available

LIMIT = 120
"""Seconds after which a process counts as stuck; each takes a few."""

MANY = """
import numpy as np
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.teaming import Teaming
from hmi_marl.envs.worlds import make_world


def drive(teams, steps=3, threads=None):
    config = TeamConfig(driver="bart", duration=2.0)
    team = Teaming(config, teams, make_world("batched", config.scene, teams, threads))
    team.reset(np.arange(teams, dtype=np.uint64))
    for _ in range(steps):
        team.intend(np.full(teams, 3))
        team.step(np.zeros(teams, np.int64))
    return float(team.state().sum())
"""
"""Drives teams; many of them in all the threads that there are."""


def environment(more):
    """Environment variables as a user has them, without what limits threads."""
    limits = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS")
    return {name: value for name, value in os.environ.items() if name not in limits} | more


def run(code, **env):
    """Run code in a fresh process; returns what it printed."""
    full = MANY + "\nif __name__ == '__main__':\n" + "\n".join(f"    {x}" for x in code.split("\n"))
    ended = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", full],
        env=environment(env),
        capture_output=True,
        text=True,
        check=False,
        timeout=LIMIT,
    )
    assert ended.returncode == 0, ended.stderr
    assert "fork()" not in ended.stderr
    return ended.stdout.strip()


EACH_IN_A_FORK = """
import contextlib, io, json, os, sys, traceback

def printed_in_a_fork(code):
    read, write = os.pipe()
    child = os.fork()
    if child == 0:
        status = 1
        try:
            with contextlib.redirect_stdout(io.StringIO()) as out:
                exec(code, globals())
            os.write(write, out.getvalue().encode())
            status = 0
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(status)
    os.close(write)
    with open(read) as told:
        printed = told.read().strip()
    assert os.waitpid(child, 0)[1] == 0, code
    return printed

print(json.dumps([printed_in_a_fork(code) for code in json.loads(sys.stdin.read())]))
"""


def run_each(*codes, imports="", **env):
    """What each code prints, in a fork of a process that has imported, but has done nothing yet."""
    ended = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", MANY + imports + EACH_IN_A_FORK],
        env=environment(env),
        input=json.dumps(codes),
        capture_output=True,
        text=True,
        check=False,
        timeout=LIMIT,
    )
    assert ended.returncode == 0, ended.stderr
    return json.loads(ended.stdout)


def run_file(code, folder, **env):
    """The same from a file, as pools that start their workers afresh need it."""
    path = folder / "program.py"
    path.write_text(MANY + "\n" + code)
    ended = subprocess.run(
        [sys.executable, "-W", "ignore", str(path)],
        env=environment(env),
        capture_output=True,
        text=True,
        check=False,
        timeout=LIMIT,
        cwd=folder,
    )
    assert ended.returncode == 0, ended.stderr
    return ended.stdout.strip()


@pytest.mark.parametrize(
    "methods", [("fork",), pytest.param(("spawn", "forkserver"), marks=pytest.mark.slow)]
)
def test_a_pool_of_workers_drives_many_teams_after_their_parent_did(methods, tmp_path):
    printed = run_file(
        "if __name__ == '__main__':\n"
        "    import multiprocessing\n"
        "    alone = drive(256)\n"
        f"    for method in {methods}:\n"
        "        several = 2 if method == 'fork' else 1\n"  # others import everything again
        "        with multiprocessing.get_context(method).Pool(several) as pool:\n"
        "            same = pool.map(drive, [256, 256]) == [alone, alone]\n"
        "        print(method, same, drive(256) == alone)",
        tmp_path,
    )
    told = [f"{method} True True" for method in methods]
    assert printed.splitlines() == told


@pytest.mark.slow
def test_joblib_of_any_kind_and_with_worlds_that_are_large(tmp_path):
    pytest.importorskip("joblib")
    printed = run_file(
        "def look(world):\n"
        "    world.step(np.ones(600, np.int64), np.ones(600, bool))\n"
        "    return world.lidar(True).sum(), world.lidar(False).sum()\n"
        "\n"
        "if __name__ == '__main__':\n"
        "    import joblib\n"
        "    alone = drive(64)\n"
        "    for backend in ('threading', 'loky', 'multiprocessing'):\n"
        "        work = joblib.Parallel(n_jobs=2, backend=backend)\n"
        "        same = work(joblib.delayed(drive)(64) for _ in range(4)) == [alone] * 4\n"
        "        print(backend, same)\n"
        "    world = make_world('batched', TeamConfig(duration=1.0).scene, 600, 2)\n"
        "    results = joblib.Parallel(n_jobs=2)(joblib.delayed(look)(world) for _ in range(2))\n"
        "    print('handed', results == [look(world)] * 2)",
        tmp_path,
    )
    kinds = ("threading", "loky", "multiprocessing", "handed")
    assert printed.splitlines() == [f"{kind} True" for kind in kinds]


TWO_THREADS = (
    "from concurrent.futures import ThreadPoolExecutor\n"
    "alone = drive(128)\n"
    "with ThreadPoolExecutor(4) as pool:\n"
    "    print(list(pool.map(lambda _: drive(128, 10), range(8))) == [drive(128, 10)] * 8)"
)


@pytest.mark.usefixtures("unmeasured")
@pytest.mark.slow
@pytest.mark.parametrize("layer", ["omp", "workqueue"])
def test_two_threads_step_two_worlds_under_any_threading_layer(layer):
    assert run(TWO_THREADS, NUMBA_THREADING_LAYER=layer) == "True"


LOADED = "import threading\ndrive(1)\nassert threading.active_count() == 1\n"
"""Loads the compiled loops once for all forks, into which threads would not come along."""
THREADS_STARTED = (
    "import sys, threading\n"
    "drive(1); drive(512, threads=1); print(threading.active_count())\n"
    "drive(512); print(threading.active_count())\n"
    "maps = open('/proc/self/maps').read() if sys.platform.startswith('linux') else ''\n"
    "print('gomp' in maps or 'omppool' in maps or 'workqueue' in maps)"
)
INTERRUPTED = (
    "import signal, time\n"
    "def interrupt(*_): raise KeyboardInterrupt\n"
    "signal.signal(signal.SIGALRM, interrupt)\n"
    "config = TeamConfig(duration=20.0)\n"
    "world = make_world('batched', config.scene, 4096)\n"
    "everywhere, keep, changed, interrupted = np.ones(4096, bool), np.ones(4096, int), 0, 0\n"
    "for k in range(30):\n"
    "    try:\n"
    "        signal.setitimer(signal.ITIMER_REAL, 0.001 + 0.0004 * k)\n"
    "        for _ in range(20): world.step(keep, everywhere)\n"
    "    except KeyboardInterrupt: interrupted += 1\n"
    "    before = world._floats.copy(); time.sleep(0.02)\n"
    "    changed += not np.array_equal(before, world._floats, equal_nan=True)\n"
    "print(interrupted > 15, changed)"
)
RAISED = (
    "import threading\n"
    "from hmi_marl.envs.worlds.batched.threads import share, take\n"
    "main = threading.current_thread()\n"
    "ready = threading.Event()\n"
    "def loop(progress):\n"
    "    if threading.current_thread() is not main:\n"
    "        take(progress, 0, 64); ready.set(); raise MemoryError('in a helper')\n"
    "    ready.wait()\n"
    "    first, last = take(progress, 0, 64)\n"
    "    while first < last: first, last = take(progress, last - first, 64)\n"
    "for _ in range(2):\n"
    "    ready.clear()\n"
    "    try: share(loop, 64, 2)\n"
    "    except MemoryError as error: print(error)"
)
NO_THREADS = (
    "import threading\n"
    "alone = drive(256, threads=1)\n"
    'def start(self): raise RuntimeError("can\'t start new thread")\n'
    "threading.Thread.start = start\n"
    "print(drive(256) == alone)"
)


def test_threads_are_helpers_that_start_end_and_fail_without_harm():
    """Each in a process that has no threads yet."""
    together, started, interrupted, raised, without = run_each(
        TWO_THREADS, THREADS_STARTED, INTERRUPTED, RAISED, NO_THREADS, imports=LOADED
    )
    assert together == "True", "two threads step two worlds"
    alone, many, openmp = started.split()
    assert alone == "1"
    assert int(many) == min(available(), 32)  # 512 teams are worth no more
    assert openmp == "False"
    assert interrupted == "True 0", "an interrupt leaves a helper at work"
    assert raised.splitlines() == ["in a helper"] * 2, "what a helper raises reaches the caller"
    assert without == "True", "where no thread can be started the caller drives alone"


COUNTS = (
    "import numba\n"
    "counts = lambda: (numba.get_num_threads(), torch.get_num_threads(),\n"
    "    torch.get_num_interop_threads())\n"
    "torch.set_num_threads(1); numba.set_num_threads(1)\n"
    "few = counts(); drive(512); drive(8); drive(512, threads=1); print(counts() == few)\n"
    "most = numba.config.NUMBA_NUM_THREADS\n"
    "torch.set_num_threads(3); numba.set_num_threads(most)\n"
    "many = counts(); drive(512); drive(512, threads=1); print(counts() == many)"
)
ON_ONE_THREAD = (
    "from pathlib import Path\n"
    "from hmi_marl.training.ppo.learner import PPOLearner\n"
    "from hmi_marl.training.ppo.run import train\n"
    "from hmi_marl.training.protocols.two_stage import TwoStage\n"
    "torch.set_num_threads(4)\n"
    "seen, learn = set(), PPOLearner.learn\n"
    "def watched(self, *args):\n"
    "    seen.add(torch.get_num_threads())\n"
    "    return learn(self, *args)\n"
    "PPOLearner.learn = watched\n"
    "size = {'num_teams': 32, 'duration': 2.0, 'threads': 1}\n"
    "settings = TwoStage(driver_steps=320, hmi_steps=320, **size)\n"
    "train(settings, Path('run'), quiet=True)\n"
    "print(seen, torch.get_num_threads())"
)


@pytest.mark.usefixtures("unmeasured")
def test_thread_counts_of_other_libraries_stay():
    pytest.importorskip("torch")
    assert run("import torch\n" + COUNTS).split() == ["True", "True"]


@pytest.mark.slow
def test_training_with_one_thread_learns_on_one_thread(tmp_path):
    pytest.importorskip("rsl_rl")
    training = ON_ONE_THREAD.replace("'run'", repr(str(tmp_path / "run")))
    assert run("import torch\n" + training) == "{1} 4"


@pytest.mark.slow
def test_a_pickled_world_loads_where_fewer_threads_are_allowed(tmp_path):
    path = str(tmp_path / "env.pickle")
    if available() < 2:
        pytest.skip("needs two cores")
    before = run(
        "import pickle\n"
        "from hmi_marl import merge_v0\n"
        "env = merge_v0.parallel_env(world='batched', duration=1.0); env.reset(seed=3)\n"
        "config = TeamConfig(duration=1.0)\n"
        "team = Teaming(config, 64, make_world('batched', config.scene, 64, 2))\n"
        f"pickle.dump((env, team), open({path!r}, 'wb'))\n"
        "print(env.state().sum())"
    )
    after = run(
        "import pickle\n"
        f"env, team = pickle.load(open({path!r}, 'rb'))\n"
        "assert team.world.threads == 1\n"
        "print(env.state().sum())\n"
        "team.reset(np.arange(64)); env.step({'driver': 1, 'vehicle_ai': 0})",
        NUMBA_NUM_THREADS="1",
    )
    assert after == before
