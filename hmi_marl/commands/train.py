"""``hmi-marl train``."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Union

import tyro

from hmi_marl.training.jobs import train_together
from hmi_marl.training.protocols.registry import PROTOCOLS, name_of
from hmi_marl.training.protocols.settings import TrainSettings
from hmi_marl.training.runs.start import check_processes, default_processes

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
    processes: int | None = None
    """Processes on this machine that share the teams, with one thread each: by default as many as
    cores, or as shards if these are fewer; one with a GPU. Weights do not depend on it (on the
    CPU). For several machines use torchrun -m hmi_marl train ..."""

    def run(self, command_line: str) -> None:
        """Learn, and print the commands that use the result."""
        use_quiet_threads()
        out = self.out or Path("runs") / name_of(type(self.protocol))
        if self._processes() > 1:
            train_together(self.protocol, out, self._processes(), command_line=command_line)
        else:
            from hmi_marl.training.ppo.run import train

            train(self.protocol, out, command_line=command_line)
        if os.environ.get("RANK", "0") == "0":
            print(f"learned: {out}; curves: tensorboard --logdir {out}")
            partner = getattr(self.protocol, "driver_policy", None) or "rule"
            driver = out if (out / "driver.json").is_file() else partner
            hmi = out if (out / "vehicle_ai.json").is_file() else "never"
            print(f"see it: hmi-marl watch --hmi {hmi} --policy {driver} --out clip.gif")
            print(
                f"        hmi-marl table --hmis own {hmi} --driver-policy {driver} --world batched"
            )

    def _processes(self) -> int:
        """Processes to start."""
        if "WORLD_SIZE" in os.environ:  # torchrun has started them
            return 1
        if self.processes is None:
            return default_processes(self.protocol)
        return check_processes(self.processes, self.protocol)


def use_quiet_threads() -> None:
    """Let OpenMP's idle threads sleep instead of spin; to be called before torch is imported.

    Spinning threads slow down the world's threads.
    """
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
