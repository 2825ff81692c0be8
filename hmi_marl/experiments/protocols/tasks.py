"""Tasks that protocols are compared on: what the vehicle AI sees, and which alerts it can give.

A task is a name with settings of a training run, of its teams as of its networks; one line
registers one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from types import MappingProxyType
from typing import Any

from hmi_marl.envs.config import TeamConfig, TeamSettings
from hmi_marl.experiments.graded_alerts import GRADES, WEARY
from hmi_marl.registry import Registry
from hmi_marl.training.conditioned.settings import HMI_READS
from hmi_marl.training.protocols.settings import PPOSettings

_TEAM = {field.name for field in fields(TeamSettings)}


@dataclass(frozen=True)
class Task:
    """One task."""

    name: str
    steps: int
    """Environment steps of a run by default."""
    options: Mapping[str, Any]
    """Settings of :class:`TrainSettings` that make it."""
    main: bool = False
    """Whether all protocols are compared on it, with all seeds and budgets. On the others only
    two-stage, joint and simultaneous are, with few seeds."""

    @property
    def hidden(self) -> bool:
        """Whether the vehicle AI does not see attention, so that a driver can signal."""
        return not self.options.get("ai_sees_attention", True)

    @property
    def sequential(self) -> bool:
        """Whether the vehicle AI sees a^H_t rather than a^H_{t-1}."""
        return bool(self.options.get("sequential", True))

    def team(self, drivers: tuple[str, ...], **others: Any) -> TeamConfig:
        """Settings of the teams; ``others`` are settings of :class:`TeamSettings`."""
        own = {name: value for name, value in self.options.items() if name in _TEAM}
        return TeamSettings(**own | others).team(drivers)


TASKS: Registry[Task] = Registry("task", "hmi-marl compare --help")


def register(
    name: str,
    help: str,  # noqa: A002
    steps: int,
    main: bool = False,
    **options: Any,
) -> None:
    """Register a task: its line of help, its steps by default, and the settings that make it."""
    TASKS.register(name, help, Task(name, steps, MappingProxyType(options), main))


_HIDDEN: dict[str, Any] = {
    "ai_sees_attention": False,
    "rnn_hidden_dim": 32,
    "hmi_reads": ("traits", *HMI_READS),
    "ppo": PPOSettings(num_mini_batches=8),  # a GRU goes through whole episodes: fewer, longer
}
register("seen", "the vehicle AI sees attention", 4_000_000, main=True)
register("hidden", "it does not, and has a memory", 8_000_000, main=True, **_HIDDEN)
register(
    "hidden-parallel",
    "hidden, with both agents moving at the same time: it sees a^H one step late",
    8_000_000,
    **_HIDDEN,
    sequential=False,
)
register("graded", "seen, with alerts of four strengths", 4_000_000, alert_strengths=GRADES)
register(
    "fatigue", "seen, with alerts that lose their effect as they pile up", 4_000_000, fatigue=WEARY
)
