"""``hmi-marl train``."""

from __future__ import annotations

import os
import shlex
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Union

import tyro

from hmi_marl.checks import check_count
from hmi_marl.training.protocols.registry import PROTOCOLS, name_of
from hmi_marl.training.protocols.settings import TrainSettings

if TYPE_CHECKING:
    Protocol = TrainSettings
else:
    Protocol = Union[  # noqa: UP007  # made at run time
        tuple(
            Annotated[entry.value, tyro.conf.subcommand(name)] for name, entry in PROTOCOLS.items()
        )
    ]


@dataclass(frozen=True)
class Train:
    """Learn the driver's and the HMI's policies, by one of several protocols.

    Resumes a run that was cut off in the same folder.

    Example: hmi-marl train two-stage --hmi-for homer --out runs/homer
    """

    protocol: Annotated[
        tyro.conf.OmitSubcommandPrefixes[Protocol], tyro.conf.arg(prefix_name=False)
    ]
    """Protocol: which policy learns when."""
    out: Path | None = None
    """Folder of the run, which watch and table take as an HMI or a driver; by default
    runs/ and the protocol's name."""
    processes: int = 1
    """Processes on this machine that train together, each with its own teams and one thread: with N
    of them a batch is N times as large. For several machines use torchrun -m hmi_marl train ..."""

    def run(self, command_line: str) -> None:
        """Learn, and print the commands that use the result."""
        use_quiet_threads()
        check_count("processes", self.processes)
        if self.processes > 1 and "WORLD_SIZE" not in os.environ:
            start_again_in_processes(self.processes, command_line)
        from hmi_marl.training.ppo.run import train

        out = self.out or Path("runs") / name_of(type(self.protocol))
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
    """Replace this process by torchrun, which runs the same command in several processes."""
    launcher = ("-m", "torch.distributed.run", "--standalone", f"--nproc-per-node={count}")
    os.environ |= dict.fromkeys(("OMP_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
    arguments = [sys.executable, *launcher, "-m", "hmi_marl", *shlex.split(command_line)[1:]]
    os.execv(sys.executable, arguments)


def use_quiet_threads() -> None:
    """Let OpenMP's idle threads sleep instead of spin; to be called before torch is imported.

    Spinning threads slow down the world's threads.
    """
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
