import os
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest
import together
import torch

from hmi_marl.training.protocols.settings import PPOSettings
from hmi_marl.training.protocols.two_stage import TwoStage
from hmi_marl.training.runs import start
from hmi_marl.training.runs.start import (
    check_processes,
    check_start,
    default_processes,
    default_threads,
    start_together,
)

SETTINGS = TwoStage(num_teams=32, shards=4, ppo=PPOSettings(num_mini_batches=4), device="cpu")


def gone(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    status = Path(f"/proc/{pid}/stat")
    return status.is_file() and status.read_text().split()[2] == "Z"


def wait_until(condition, seconds=60.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)


@pytest.mark.parametrize("cores", [1, 2, 3, 4, 64])
def test_as_many_processes_as_cores_but_no_more_than_shards(cores, monkeypatch):
    monkeypatch.setattr(start, "cores", lambda: cores)
    expected = {1: 1, 2: 2, 3: 2, 4: 4, 64: 4}[cores]
    assert default_processes(SETTINGS) == expected
    assert default_processes(SETTINGS, limit=2) == 2
    assert default_threads("cpu") == 1


def test_one_process_with_many_threads_if_a_gpu_learns(monkeypatch):
    monkeypatch.setattr(start, "cores", lambda: 16)
    monkeypatch.setattr(start, "_GPU_DRIVERS", (__file__,))
    monkeypatch.delenv("NUMBA_NUM_THREADS", raising=False)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    on_gpu = TwoStage(num_teams=32, ppo=PPOSettings(num_mini_batches=4))
    assert default_processes(on_gpu) == 1
    assert default_threads("auto") == default_threads("cuda:1") == 16
    monkeypatch.setenv("NUMBA_NUM_THREADS", "3")
    assert default_threads("cuda") == 3
    assert default_threads("cpu") == 1
    assert check_processes(8, on_gpu) == 8  # one for each GPU
    for count in (3, 16):
        with pytest.raises(ValueError, match=f"^{count} processes cannot share 32 teams evenly"):
            check_processes(count, on_gpu)


def test_processes_that_cannot_share_the_shards_are_refused():
    assert [check_processes(count, SETTINGS) for count in (1, 2, 4)] == [1, 2, 4]
    for count in (3, 8):
        with pytest.raises(ValueError, match=f"processes is one of 1, 2, 4, .* but got {count}"):
            check_processes(count, SETTINGS)
    with pytest.raises(ValueError, match=r"processes lies in 1 to .*, but got 0"):
        check_processes(0, SETTINGS)


def test_a_partner_that_is_not_there_is_refused_with_its_mixture():
    check_start(replace(SETTINGS, driver_policy="mixture:rule,random"))
    with pytest.raises(ValueError, match="'hal' in 'mixture:rule,hal': unknown driver policy"):
        check_start(replace(SETTINGS, driver_policy="mixture:rule,hal"))
    with pytest.raises(FileNotFoundError, match="'runs/no' in 'mixture:runs/no,rule': no policy"):
        check_start(replace(SETTINGS, driver_policy="mixture:runs/no,rule"))


def test_a_killed_one_ends_the_others_and_is_named():
    with pytest.raises(
        ChildProcessError, match=r"process 1 of those .* ended by SIGKILL; the same"
    ):
        start_together(2, together.kill_second)


def test_an_error_in_one_of_them_ends_the_others_and_is_raised():
    began = time.monotonic()
    with pytest.raises(FileNotFoundError, match="no such driver"):
        start_together(2, together.fail)
    assert time.monotonic() - began < 300  # the other would go on for 600 s


KILLED = """
import sys
import together
from hmi_marl.training.runs.start import start_together

if __name__ == "__main__":
    start_together(2, getattr(together, sys.argv[2]), sys.argv[1])
"""


@pytest.mark.skipif(sys.platform == "win32", reason="asks for processes as POSIX does")
@pytest.mark.parametrize("waiting", ["wait_for_long", "wait_for_long_watching"])
def test_none_is_left_when_the_process_that_started_them_is_killed(waiting, tmp_path):
    program = tmp_path / "program.py"
    program.write_text(KILLED)
    path = os.pathsep.join([*sys.path, os.environ.get("PYTHONPATH", "")])
    env = os.environ | {"PYTHONPATH": path}
    parent = subprocess.Popen([sys.executable, str(program), str(tmp_path), waiting], env=env)
    places = [tmp_path / "0", tmp_path / "1"]
    wait_until(lambda: all(place.is_file() and place.read_text() for place in places))
    pids = [int(place.read_text()) for place in places]
    assert not any(map(gone, pids))
    parent.kill()
    parent.wait()
    wait_until(lambda: all(map(gone, pids)))
