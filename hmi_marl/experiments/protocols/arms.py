"""Arms of a comparison: kinds of runs, each a protocol with its settings, and their runs.

Some arms need what others have learned, so runs are trained in waves: first those that start from
nothing, then those that are anchored to a driver or meet a mixture of drivers. Arms that fill one
seat only are partners for the others: a driver that does not see its traits, and an HMI that has
met several drivers.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hmi_marl.envs.config import AGENTS, DRIVER, VEHICLE_AI

TWO_STAGE, JOINT, SIMULTANEOUS = "two-stage", "joint", "simultaneous"
MAIN = (TWO_STAGE, JOINT, SIMULTANEOUS)
"""Protocols that get all seeds."""
ANCHORED = "anchored-{:g}"
"""Name of simultaneous learning with the driver anchored to the two-stage one, {} for λ."""
TEAM_ALONE = "two-stage-team"
"""Two-stage with the reward of the team in both stages."""
NO_TRAITS, ROBUST = "no-traits", "robust"
"""The driver that does not see its traits, and the HMI for a mixture of drivers."""
RULE = "rule"
"""Driver policy of the catalogue that is not trained."""
AT_SHARE = "{}-share-{:g}"
"""Name of a protocol with a share of the driver's stage that is tried out."""
AT_BUDGET = "{}-budget-{}"
"""Name of a protocol with fewer steps."""


@dataclass(frozen=True)
class Arm:
    """One kind of run."""

    name: str
    protocol: str
    """Name in :func:`compared`."""
    steps: int
    """Environment steps of a run, about."""
    seeds: int
    """Number of runs."""
    seats: tuple[str, ...] = AGENTS
    """Seats that its policies fill."""
    driver_share: float | None = None
    """Share of the steps in which the driver learns; None for that of the comparison."""
    anchor_kl: float | None = None
    """λ of an arm that is anchored to the two-stage driver of the same number."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """Further settings of the protocol."""
    partners: tuple[str, ...] = ()
    """Arms whose drivers of the same number its HMI learns with, as a mixture."""
    crossed: bool = False
    """Whether it is a protocol that is compared: it has snapshots and is in cross-play."""

    @property
    def wave(self) -> int:
        """Place in the order of training: 1 for an arm that needs what others have learned."""
        return int(self.anchor_kl is not None or bool(self.partners))

    @property
    def whole(self) -> bool:
        """Whether it fills both seats."""
        return set(self.seats) == {DRIVER, VEHICLE_AI}

    @property
    def in_cross_play(self) -> bool:
        """Whether its policies play with those of every other such arm: crossed, or a partner."""
        return self.crossed or not self.whole


@dataclass(frozen=True)
class PlannedRun:
    """One training run."""

    task: str
    arm: str
    number: int
    """Number of the run among those of its arm, 0 for the first."""
    standing: bool = False
    """Whether it is trained with ``end_at_crash=False``: a crashed car stands until the end."""

    @property
    def name(self) -> str:
        """Name of the run: the path of its folder in that of the comparison."""
        return f"{self.task}/{self.arm}-run{self.number}" + ("-standing" if self.standing else "")

    def folder(self, comparison: Path) -> Path:
        """Folder of the run in the folder of a comparison."""
        return comparison / self.name


def is_run(task: str, name: str) -> bool:
    """Whether a policy's name is that of a run of this task, rather than one of the catalogue."""
    return name.startswith(f"{task}/")
