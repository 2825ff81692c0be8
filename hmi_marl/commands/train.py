"""``hmi-marl train``."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from hmi_marl.training.alternating import Alternating
from hmi_marl.training.joint import Joint
from hmi_marl.training.settings import TrainSettings
from hmi_marl.training.simultaneous import Simultaneous
from hmi_marl.training.two_stage import TwoStage

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

    Goes on by itself where a run in the same folder was cut off. Several processes:
    torchrun --nproc-per-node 2 -m hmi_marl train ...

    Example: hmi-marl train two-stage --hmi-for homer --out runs/homer
    """

    protocol: Annotated[
        tyro.conf.OmitSubcommandPrefixes[Protocol], tyro.conf.arg(prefix_name=False)
    ]
    """Who learns when."""
    out: Path | None = None
    """Folder of the run, which watch and table take as an HMI or a driver; by default
    runs/ and the protocol's name."""

    def run(self, typed: str) -> None:
        """Learn, and say what can be done with it."""
        use_quiet_threads()
        try:
            from hmi_marl.training.run import train
        except ModuleNotFoundError as error:
            raise ModuleNotFoundError(
                f"training needs {error.name}: pip install 'hmi-marl[train]'", name=error.name
            ) from error
        out = Path("runs") / _NAMES[type(self.protocol)] if self.out is None else self.out
        train(self.protocol, out, typed=typed)
        print(f"learnt: {out}; curves: tensorboard --logdir {out}")
        print(f"see it: hmi-marl watch --hmi {out} --policy {out} --out clip.gif")
        print(
            f"        hmi-marl table --hmis NoHMI own {out} --driver-policy {out} --world batched"
        )


def use_quiet_threads() -> None:
    """Let idle threads sleep, before torch is imported.

    OpenMP's threads otherwise spin while the world moves, which makes both slower.
    """
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
