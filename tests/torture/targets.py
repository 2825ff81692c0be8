"""Commands to attack, at tiny sizes, and what an undisturbed run of each leaves behind."""

import json
import os
import re
import resource
import shutil
import signal
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

# Everything that the commands import, once; every try is a fork of this process.
import pyarrow.parquet  # noqa: F401
import safetensors.torch
from process_groups import none_is_left

import hmi_marl.experiments.protocols.experiment
import hmi_marl.training.ppo.run
import hmi_marl.training.traits.run  # noqa: F401
from hmi_marl import interrupts
from hmi_marl.cli import main
from hmi_marl.ownership import OWNER
from hmi_marl.training.runs.folder import CHECKPOINT

_SMALL = "--num-teams 16 --duration 1 --vehicles 1 2 --device cpu --checkpoint-every 0"
_TRAIN = f"{_SMALL} --ppo.num-mini-batches 4 --network.hidden-dims 8 8"
TARGETS = {
    "train two-stage": f"train two-stage {_TRAIN} --driver-steps 800 --hmi-steps 800 --processes 1",
    "train alternating": (
        f"train alternating {_TRAIN} --rounds 2 --driver-steps 800 --hmi-steps 800 --processes 1"
    ),
    "train fine-tune": (
        f"train fine-tune {_TRAIN} --driver-steps 480 --hmi-steps 480 --together-steps 640 "
        "--anchor first-stage --anchor-kl 0.1 --processes 1"
    ),
    "train joint": f"train joint {_TRAIN} --steps 1600 --processes 1",
    "train simultaneous": f"train simultaneous {_TRAIN} --steps 1600 --processes 1",
    "train, 2 processes": f"train two-stage {_TRAIN} --driver-steps 800 --hmi-steps 800 "
    "--processes 2",
    "traits train": (
        "traits train --demonstrations ../data --steps 80 --num-teams 4 --pool 2 --expert-pools 2 "
        "--encoder.features 6 --average-updates 5 --encoder-updates 10 --imitation-updates 10 "
        "--ppo.num-mini-batches 2 --checkpoint-every 0 --device cpu"
    ),
    "collect": "collect --steps 3000 --duration 1 --vehicles 1 2 --num-teams 16",
    "compare": (
        "compare --tasks seen --protocols two-stage joint --steps 320 --budgets 160 --rounds 1 "
        "--seeds 1 --driver-shares 0.5 --snapshots 1 --episodes 32 --cross-episodes 32 "
        "--num-teams 16 --duration 1 --vehicles 1 2 --workers 2 --no-crash-check"
    ),
    "reproduce": (
        "reproduce hidden --driver-run ../driver --hmi-steps 16 --episodes 4 --num-teams 16 "
        "--rnn-hidden-dim 4 --seeds 2 --workers 2"
    ),
}
"""Commands by name; each gets --out."""
_BEFORE = {
    "data": "collect --steps 300 --duration 1 --vehicles 1 2 --num-teams 16",
    "driver": "train two-stage --num-teams 16 --vehicles 1 2 --driver-steps 16 --hmi-steps 0 "
    "--device cpu --processes 1",
}
"""Commands whose results the others read."""
_DURATIONS = re.compile(r".*(seconds|share_of_time|steps_per_second|timings).*")
_TEXTS = (".html", ".txt", ".png", ".gif")
"""Reports, which show durations; the JSON next to them is compared."""
LONGEST = 300.0


@dataclass
class Outcome:
    """How a command ended."""

    status: int
    errors: str
    alone: bool
    """Whether no process that it started outlived it."""

    @property
    def line(self) -> str:
        """Last line on stderr, after a progress bar that may stand there."""
        last = (self.errors.strip().replace("\r", "\n").splitlines() or [""])[-1]
        return last[max(0, last.find("hmi-marl: ")) :]


class Bench:
    """Run commands in a folder of their own, and know what each leaves behind undisturbed."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._whole: dict[str, tuple[dict[str, Any], float]] = {}
        for name, command in _BEFORE.items():
            outcome = self.run(f"{command} --out {name}", self.folder)
            assert outcome.status == 0, outcome.errors

    def undisturbed(self, target: str) -> tuple[dict[str, Any], float]:
        """What is left behind, and the seconds that it takes."""
        if target not in self._whole:
            out, began = self.fresh(), time.monotonic()
            outcome = self.run(f"{TARGETS[target]} --out {out.name}", out.parent)
            assert outcome.status == 0, outcome.errors
            self._whole[target] = content(out), time.monotonic() - began
        return self._whole[target]

    def fresh(self) -> Path:
        """An output folder that does not exist; its command has the same text in every try."""
        tries = self.folder / "tries"
        shutil.rmtree(tries, ignore_errors=True)
        tries.mkdir()
        return tries / "out"

    def run(
        self,
        command: str,
        cwd: Path,
        disturb: Callable[[int], object] = lambda pid: None,
        prepare: Callable[[], object] = lambda: None,
    ) -> Outcome:
        """Run a command in a process group of its own.

        Args:
            disturb: called with its process id once it runs.
            prepare: called in the new process first.
        """
        errors = self.folder / "errors"
        pid = os.fork()
        if not pid:
            _become(command, cwd, errors, prepare)
        disturb(pid)
        status = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
        return Outcome(status, errors.read_text("utf-8", "replace"), _is_gone(pid))


def _become(command: str, cwd: Path, errors: Path, prepare: Callable[[], object]) -> None:
    """Be the command, as a shell would start it."""
    status = 70
    try:
        os.setsid()
        os.chdir(cwd)
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        os.dup2(os.open(errors, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), 2)
        sys.stdout = os.fdopen(1, "w", closefd=False)
        sys.stderr = os.fdopen(2, "w", closefd=False)
        interrupts.is_command = lambda: True
        prepare()
        try:
            status = main(command.split())
        except SystemExit as stop:
            status = int(stop.code or 0)
    except BaseException as error:
        os.write(2, f"Traceback: {error!r}\n".encode())
    finally:
        sys.stderr.flush()
        os._exit(status)


def _is_gone(group: int) -> bool:
    if none_is_left(group, within=10.0):
        return True
    os.killpg(group, signal.SIGKILL)
    return False


def full_after(size: int) -> Callable[[], None]:
    """Let no file of a process grow beyond so many bytes, as a disk does that is full by then."""

    def prepare() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))

    return prepare


def content(folder: Path) -> dict[str, Any]:
    """What a command has left in its folder, without durations; byte by byte where it has none."""
    found: dict[str, Any] = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.is_dir() or "tensorboard" in name or path.suffix in _TEXTS or path.name == OWNER:
            continue
        if path.name.startswith("."):
            found[name] = "a file that was left behind"
        elif path.name == CHECKPOINT:
            tensors = safetensors.torch.load_file(path)
            found[name] = {key: value.numpy().tobytes() for key, value in tensors.items()}
        elif path.suffix == ".json":
            found[name] = _without_durations(json.loads(path.read_text("utf-8")))
        else:
            found[name] = path.read_bytes()
    return found


def _without_durations(value: Any) -> Any:
    if isinstance(value, dict):
        pairs = value.items()
        return {k: _without_durations(v) for k, v in pairs if not _DURATIONS.fullmatch(k)}
    return [_without_durations(each) for each in value] if isinstance(value, list) else value


def difference(one: dict[str, Any], other: dict[str, Any]) -> str:
    """Names of the files that differ."""
    return ", ".join(sorted(k for k in one.keys() | other.keys() if one.get(k) != other.get(k)))
