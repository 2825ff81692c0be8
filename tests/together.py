"""Functions for processes that are started together; these import them from here."""

import json
import os
import signal
import sys
import time
from pathlib import Path


def learn(tasks, memory, rank):
    """Train one run after the other, each a pair of settings and folder."""
    from hmi_marl.training.ppo.run import train_rank

    for settings, folder in tasks:
        train_rank(settings, folder, None, {"quiet": True}, memory, rank)


def learn_until_killed(settings, folder, batches, memory, rank):
    """Train until the first process is killed before it saves so many batches."""
    from hmi_marl.training.runs.checkpoint import Checkpoint

    save = Checkpoint.save

    def kill(self, path):
        if len(self.curve) == batches:
            os.kill(os.getpid(), signal.SIGKILL)
        save(self, path)

    Checkpoint.save = kill
    learn([(settings, folder)], memory, rank)


def know_each_other(folder, memory, rank):
    """Write what this process knows of the others, by shared memory and by torch.distributed."""
    import torch

    from hmi_marl.training.runs.processes import joined

    known = {"pid": os.getpid(), "threads": os.environ["OMP_NUM_THREADS"]}
    for name, on_gpus in (("memory", False), ("torch", True)):
        processes = joined(memory, rank, on_gpus)
        values = processes.gather(torch.tensor([1.5 + rank, -rank]))
        processes.wait()
        known[name] = {
            "place": [processes.count, processes.rank, processes.local_rank],
            "first": processes.is_first,
            "gathered": [part.tolist() for part in values],
            "waited": processes.seconds_waited > 0,
        }
    Path(folder, f"{rank}.json").write_text(json.dumps(known))


def know_each_other_and_learn(folder, tasks, memory, rank):
    """Both, in processes that are started once."""
    know_each_other(folder, memory, rank)
    learn(tasks, memory, rank)


def fail(memory, rank):
    """Raise in the second process, while the first would go on for long."""
    if rank == 1:
        raise FileNotFoundError("no such driver")
    time.sleep(600)


def kill_second(memory, rank):
    """Kill the second process, while the first would go on for long."""
    if rank == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(600)


def wait_for_long(folder, memory, rank):
    """Tell who this is, and go on for long."""
    Path(folder, str(rank)).write_text(str(os.getpid()))
    time.sleep(600)


def wait_for_long_watching(folder, memory, rank):
    """The same, as where the system does not kill it with its parent: a thread watches that."""
    import ctypes
    import threading

    from hmi_marl import workers

    if sys.platform.startswith("linux"):
        assert ctypes.CDLL(None).prctl(workers._PR_SET_PDEATHSIG, 0) == 0
        threading.Thread(target=workers._end_with_parent, daemon=True).start()
    wait_for_long(folder, memory, rank)
