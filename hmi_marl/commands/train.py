"""``hmi-marl train``."""

from __future__ import annotations

import os
import shlex
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from hmi_marl.training.protocols.alternating import Alternating
from hmi_marl.training.protocols.joint import Joint
from hmi_marl.training.protocols.settings import TrainSettings
from hmi_marl.training.protocols.simultaneous import Simultaneous
from hmi_marl.training.protocols.two_stage import TwoStage

_NAMES: dict[type[TrainSettings], str] = {
    TwoStage: "two-stage",
    Joint: "joint",
    Simultaneous: "simultaneous",
    Alternating: "alternating",
}
Protocol = (
    Annotated[TwoStage, tyro.conf.subcommand(_NAMES[TwoStage])]
    | Annotated[Joint, tyro.conf.subcommand(_NAMES[Joint])]
    | Annotated[Simultaneous, tyro.conf.subcommand(_NAMES[Simultaneous])]
    | Annotated[Alternating, tyro.conf.subcommand(_NAMES[Alternating])]
)


@dataclass(frozen=True)
class Train:
    """Learn the driver's and the HMI's policies, by one of four protocols.

    Goes on by itself where a run in the same folder was cut off.

    Example: hmi-marl train two-stage --hmi-for homer --out runs/homer
    """

    protocol: Annotated[
        tyro.conf.OmitSubcommandPrefixes[Protocol], tyro.conf.arg(prefix_name=False)
    ]
    """Who learns when."""
    out: Path | None = None
    """Folder of the run, which watch and table take as an HMI or a driver; by default
    runs/ and the protocol's name."""

    processes: int = 1
    """That learn as one on this machine, each with teams of its own and a thread: with N of them
    a batch is N times as large. Over several machines use torchrun -m hmi_marl train ..."""

    def run(self, command_line: str) -> None:
        """Learn, and say what can be done with it."""
        use_quiet_threads()
        if self.processes < 1:
            raise ValueError(f"there is at least one process, but got {self.processes}")
        if self.processes > 1 and "WORLD_SIZE" not in os.environ:
            start_again_in_processes(self.processes, command_line)
        from hmi_marl.training.ppo.run import train

        out = Path("runs") / _NAMES[type(self.protocol)] if self.out is None else self.out
        train(self.protocol, out, command_line=command_line)
        if os.environ.get("RANK", "0") == "0":
            print(f"learned: {out}; curves: tensorboard --logdir {out}")
            driver = out if (out / "driver.json").is_file() else "rule"
            hmi = out if (out / "vehicle_ai.json").is_file() else "never"
            print(f"see it: hmi-marl watch --hmi {hmi} --policy {driver} --out clip.gif")
            print(
                f"        hmi-marl table --hmis own {hmi} --driver-policy {driver} --world batched"
            )


def start_again_in_processes(count: int, command_line: str) -> None:
    """Run this very command in several processes instead, as torchrun does; never comes back."""
    launcher = ("-m", "torch.distributed.run", "--standalone", f"--nproc-per-node={count}")
    os.environ |= dict.fromkeys(("OMP_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
    arguments = [sys.executable, *launcher, "-m", "hmi_marl", *shlex.split(command_line)[1:]]
    os.execv(sys.executable, arguments)


def use_quiet_threads() -> None:
    """Let idle threads sleep, before torch is imported.

    OpenMP's threads otherwise spin while the world moves, which makes both slower.
    """
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
