"""A Python that has started: runs programs in forks, each as in a process of its own.

Importing NumPy, numba and torch takes longer than most of what is tried of the wheel. One process
imports what is installed of them, and nothing of the package; each program is run in a fork of it.
"""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path

IMPORTED = ("numpy", "scipy", "gymnasium", "numba", "pettingzoo", "tyro", "torch")
"""What is imported once, where it is installed. All of it is imported by many commands."""

_PROGRAM = """
import importlib, json, os, runpy, sys

replies = os.fdopen(os.dup(1), "w")
os.dup2(2, 1)
for name in sys.argv[1:]:
    try:
        importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name != name:
            raise
for request in sys.stdin:
    child = os.fork()
    if not child:
        break
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), file=replies, flush=True)
else:
    sys.exit()
replies.close()
folder, printed, words = json.loads(request)
os.chdir(folder)
for number, place in enumerate((os.devnull, printed + ".out", printed + ".err")):
    opened = os.open(place, os.O_CREAT | os.O_TRUNC | (os.O_WRONLY if number else os.O_RDONLY))
    os.dup2(opened, number)
    os.close(opened)
sys.argv[:] = words
del child, folder, importlib, json, name, number, opened, os, place, printed, replies, request
runpy.run_path(words[0], run_name="__main__")  # and the fork ends as any process does
"""


class Started:
    """A Python process whose forks run programs, one at a time.

    Args:
        python: the interpreter.
        folder: where what a program prints is kept until it is read.
        variables: the environment's variables.
        limit: longest that a program may take [s].
    """

    def __init__(
        self, python: Path, folder: Path, variables: Mapping[str, str], limit: float
    ) -> None:
        self._printed, self._limit = folder / "printed", limit
        with Path(f"{self._printed}.started").open("wb") as said:
            self._process = subprocess.Popen(
                [python, "-c", _PROGRAM, *IMPORTED],
                env=dict(variables),
                cwd=folder,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=said,
                text=True,
                start_new_session=True,
            )

    def run(self, words: Sequence[str | Path], folder: Path) -> subprocess.CompletedProcess[str]:
        """Run a script with its arguments in a folder, with nothing on its standard input.

        Raises:
            subprocess.TimeoutExpired: it takes too long; it was killed.
            RuntimeError: the process that forks has ended; the message holds what it said.
        """
        listed = [str(word) for word in words]
        requests, replies = self._process.stdin, self._process.stdout
        assert requests is not None
        assert replies is not None
        with suppress(BrokenPipeError):  # said below
            print(json.dumps([str(folder), str(self._printed), listed]), file=requests, flush=True)
        if not select.select([replies], [], [], self._limit)[0]:
            self.close()
            raise subprocess.TimeoutExpired(listed, self._limit)
        status = replies.readline()
        if not status:
            said = Path(f"{self._printed}.started").read_text("utf-8", "replace")
            raise RuntimeError(f"Python could not be started:\n{said}")
        out, err = (Path(f"{self._printed}.{kind}").read_text("utf-8") for kind in ("out", "err"))
        return subprocess.CompletedProcess(listed, int(status), out, err)

    def close(self) -> None:
        """End it, and what its forks have left."""
        with suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        with suppress(BrokenPipeError):
            self._process.communicate()
