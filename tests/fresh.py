"""Programs in processes of their own, for what changes a process or leaves marks in it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
LIMIT = 300
"""Seconds, so that a worker that died keeps no test waiting for ever."""


def run(*arguments: str | Path, **environment: str) -> str:
    """What a Python program prints, with this package; asserts that it ends well.

    Args:
        arguments: of the interpreter: ``-c`` and a program, or a file and its arguments.
        environment: variables besides those there are; an empty one is taken away.
    """
    surroundings = {**os.environ, "PYTHONPATH": str(ROOT), **environment}
    surroundings = {name: value for name, value in surroundings.items() if value}
    ended = subprocess.run(
        [sys.executable, *map(str, arguments)],
        env=surroundings,
        capture_output=True,
        text=True,
        timeout=LIMIT,
        check=False,
    )
    assert ended.returncode == 0, ended.stdout[-2000:] + ended.stderr[-4000:]
    return ended.stdout


def run_example(name: str, *arguments: str) -> str:
    """What an example for another trainer prints."""
    return run(ROOT / "examples" / "trainers" / f"{name}.py", *arguments)


ALL_THREADS = {"OMP_NUM_THREADS": "", "NUMBA_NUM_THREADS": ""}
"""Environment of a user, who limits no threads."""
DRIVE_MANY = """
def drive_many():
    import numpy
    from hmi_marl.envs.config import TeamConfig
    from hmi_marl.envs.teaming import Teaming
    from hmi_marl.envs.worlds import make_world

    config = TeamConfig(driver="bart", duration=2.0)
    team = Teaming(config, 512, make_world("batched", config.scene, 512))
    team.reset(numpy.arange(512, dtype=numpy.uint64))
    for _ in range(3):
        team.intend(numpy.full(512, 3))
        team.step(numpy.zeros(512, numpy.int64))
    return float(team.state().sum())
"""
"""Defines a function that drives so many teams that all threads there are have work."""


_EACH = """
import json, os, runpy, sys, traceback

def run(script, arguments):
    sys.argv[:] = [script, *arguments]
    try:
        runpy.run_path(script, run_name="__main__")
    except SystemExit as stop:
        assert not stop.code, stop

def run_in_a_fork(*program):
    if child := os.fork():
        assert os.waitpid(child, 0)[1] == 0, program
        return
    status = 1
    try:
        run(*program)
        sys.stdout.flush()
        status = 0
    except BaseException:
        traceback.print_exc()
    finally:
        os._exit(status)

forked = json.loads(sys.argv.pop())
if forked:
    import highway_env, matplotlib.pyplot, numba, torch
for program in json.loads(sys.argv.pop()):
    (run_in_a_fork if forked else run)(*program)
    print(END, flush=True)
"""
_END = "\f"


def run_each(
    *programs: tuple[Path, list[str]], forked: bool = False, **environment: str
) -> list[str]:
    """What scripts print with their arguments, one after the other in one process.

    Imports torch and highway-env once, which takes longer than what most of them do. ``forked``
    runs each in a fork of that process, where it finds nothing of those before it.
    """
    listed = json.dumps([(str(script), arguments) for script, arguments in programs])
    code = _EACH.replace("END", repr(_END))
    printed = run("-c", code, listed, json.dumps(forked), **environment).split(f"{_END}\n")
    assert len(printed) == len(programs) + 1
    return printed[:-1]
