"""Programs in processes of their own, for what changes a process or leaves marks in it."""

from __future__ import annotations

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
