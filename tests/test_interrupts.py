"""Signals to the command, at its start, in pools and in processes that learn together."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from fresh import ROOT
from process_groups import none_is_left

from hmi_marl import interrupts

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="sends signals as POSIX does")

POOL = """
import sys, time
from hmi_marl import cli, interrupts, workers

def wait(place):
    open(place, "w").close()
    time.sleep(600)

class Command:
    def run(self, command_line):
        for _ in workers.calls(wait, [(place,) for place in sys.argv[1:]], 2):
            pass

if __name__ == "__main__":
    interrupts.is_command = lambda: True
    cli.parse = lambda arguments: Command()
    cli.BY_NAME = {"wait": type("Any", (), {"check": staticmethod(lambda command: None)})}
    sys.exit(cli.main(["wait"]))
"""


def start(*command: str | Path) -> subprocess.Popen[str]:
    """Start a process group, as a shell does."""
    return subprocess.Popen(
        [sys.executable, *map(str, command)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        start_new_session=True,
    )


def wait_for(*places: Path) -> None:
    end = time.monotonic() + 120
    while not all(place.exists() for place in places):
        assert time.monotonic() < end
        time.sleep(0.02)


@pytest.mark.parametrize(
    ("number", "status", "told"),
    [
        (signal.SIGINT, 130, "interrupted"),
        pytest.param(signal.SIGTERM, 143, "terminated", marks=pytest.mark.slow),
    ],
)
def test_a_signal_ends_a_pool_in_one_line(number, status, told, tmp_path):
    program, places = tmp_path / "program.py", [tmp_path / "0", tmp_path / "1"]
    program.write_text(POOL)
    process = start(program, *places)
    wait_for(*places)
    if number == signal.SIGINT:
        os.killpg(process.pid, number)  # Ctrl-C, which the workers get too
    else:
        process.send_signal(number)
    out, err = process.communicate(timeout=60)
    assert (process.returncode, out, err) == (status, "", f"hmi-marl: {told}\n")
    assert none_is_left(process.pid)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_during_the_first_imports_takes_one_line(number):
    program = "import sys, time; print('on', flush=True); import hmi_marl; time.sleep(60)"
    # As the command: the package looks at what the interpreter was given.
    program = f"import sys; sys.orig_argv[:] = ['python', '-m', 'hmi_marl']; {program}"
    process = start("-c", program)
    assert process.stdout is not None
    process.stdout.readline()
    time.sleep(0.15)
    process.send_signal(number)
    _, err = process.communicate(timeout=60)
    told = "interrupted" if number == signal.SIGINT else "terminated"
    assert (process.returncode, err) == (128 + number, f"hmi-marl: {told}\n")


def test_the_package_handles_signals_before_it_imports_anything_else():
    """Until then, Ctrl-C makes Python print a traceback."""
    program = """
import sys, signal
sys.orig_argv[:] = ["python", "-m", "hmi_marl"]
before = set(sys.modules)
def handle(number, handler, original=signal.signal):
    print(*sorted(set(sys.modules) - before))
    original(number, handler)
    raise SystemExit
signal.signal = handle
import hmi_marl
"""
    process = start("-c", program)
    out, err = process.communicate(timeout=60)
    names = [name for name in out.split() if name != "__future__"]  # line counting imports it
    assert (names, err) == (["hmi_marl", "hmi_marl.interrupts"], "")


SWALLOWED = """
import os, signal, sys
from hmi_marl import interrupts
interrupts.is_command = lambda: True

class Finalized:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGINT)
        for _ in range(1000):
            pass

def twice():
    for _ in range(2):
        try:
            os.kill(os.getpid(), signal.SIGTERM)
            for _ in range(1000):
                pass
        except BaseException:
            pass

with interrupts.raised():
    Finalized() if sys.argv[1] == "finalizer" else twice()
    print("still here")
"""


@pytest.mark.parametrize(
    ("where", "status", "told"), [("finalizer", 130, "interrupted"), ("twice", 143, "terminated")]
)
def test_a_signal_that_is_swallowed_ends_it_at_once(where, status, told):
    process = start("-c", SWALLOWED, where)
    out, err = process.communicate(timeout=60)
    assert (process.returncode, out, err) == (status, "", f"hmi-marl: {told}\n")


def test_programs_keep_their_signals():
    before = signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)
    assert not interrupts.is_command()
    interrupts.end_at_once()
    with interrupts.raised():
        assert (signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)) == before
    assert (signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)) == before


@pytest.mark.parametrize(
    ("given", "is_command"),
    [
        (["python", "-m", "hmi_marl", "oracle"], True),
        (["/bin/python3", "-u", "-m", "hmi_marl"], True),
        (["/bin/python3", "/usr/local/bin/hmi-marl", "train"], True),
        (["python.exe", r"hmi-marl.exe"], True),
        (["python", "mine.py", "hmi-marl"], False),
        (["python", "-c", "from multiprocessing.spawn import spawn_main"], False),
    ],
)
def test_the_command_is_known_by_what_the_interpreter_was_given(given, is_command, monkeypatch):
    monkeypatch.setattr(sys, "orig_argv", given)
    assert interrupts.is_command() == is_command
