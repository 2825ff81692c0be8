"""Drives with known traits, as the turns that an evidence model reads."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hmi_marl.agents.adaptive.evidence_model import Turns
from hmi_marl.agents.catalogue import make_driver_policy, make_hmi
from hmi_marl.agents.rollout import Observer, begin, play
from hmi_marl.envs.config import VEHICLE_AI, TeamConfig
from hmi_marl.envs.drivers import DRIVERS, DriverList, TraitDistributions, Traits
from hmi_marl.envs.streams import Stream, mix, uniform
from hmi_marl.envs.teaming import Teaming
from hmi_marl.envs.worlds import make_world
from hmi_marl.training.evidence.settings import EvidenceSettings

_AT_ONCE = 1000
"""Drives side by side; bounds memory."""
_WHO = 2**32
"""Of the counter by which it is drawn whether a known driver drives."""


@dataclass(frozen=True)
class Strangers:
    """A population of known drivers and of others, whose traits are drawn evenly."""

    known: float
    """The share, in [0, 1]."""

    def draw(self, seeds: NDArray[np.uint64]) -> Traits:
        """See :meth:`Population.draw`."""
        is_known = uniform(seeds, Stream.TRAITS, _WHO) < self.known
        named = DriverList(tuple(DRIVERS.values())).draw(seeds).as_array()
        others = TraitDistributions().draw(seeds).as_array()
        return Traits.from_array(np.where(is_known[:, None], named, others))


@dataclass(frozen=True, eq=False)
class Drives:
    """M drives of at most T turns."""

    turns: NDArray[np.float32]
    """Shape (M, T, columns)."""
    driving: NDArray[np.bool_]
    """Whether the drive was still going on, shape (M, T)."""
    traits: Traits
    """Who drove, M of them."""


def drive_all(
    settings: EvidenceSettings, progress: Callable[[int], object] = lambda drives: None
) -> Drives:
    """Let many drivers drive, each HMI beside an equal share of them.

    Args:
        settings: how many, and who.
        progress: is called with the number of drives done since.

    Raises:
        ValueError: an unknown HMI or driver policy.
    """
    team = replace(settings.team, driver=Strangers(settings.known))
    number = np.arange(settings.drives, dtype=np.uint64)
    seeds = mix(settings.seed, Stream.TRAINING, number)
    parts = []
    for name, chosen in zip(settings.hmis, np.array_split(seeds, len(settings.hmis)), strict=True):
        for start in range(0, len(chosen), _AT_ONCE):
            part = chosen[start : start + _AT_ONCE]
            parts.append(_drive(team, settings, name, part))
            progress(len(part))
    return Drives(
        np.concatenate([part.turns for part in parts]),
        np.concatenate([part.driving for part in parts]),
        Traits.from_array(np.concatenate([part.traits.as_array() for part in parts])),
    )


def _drive(
    team: TeamConfig, settings: EvidenceSettings, hmi_name: str, seeds: NDArray[np.uint64]
) -> Drives:
    driver, hmi = make_driver_policy(settings.driver_policy, team), make_hmi(hmi_name, team)
    world = make_world("batched", team.scene, len(seeds), settings.threads)
    teaming = begin(team, driver, hmi, seeds, world)
    recorder = _Recorder(Turns(settings.reads, teaming.layouts[VEHICLE_AI]), teaming)
    play(teaming, driver, hmi, [recorder], steps=team.horizon)
    turns, driving = np.stack(recorder.turns, axis=1), np.stack(recorder.driving, axis=1)
    return Drives(turns, driving, teaming.traits)


class _Recorder(Observer):
    """Keep the turns as an evidence model reads them, at the moment the vehicle AI acts."""

    def __init__(self, reader: Turns, teaming: Teaming) -> None:
        self.turns: list[NDArray[np.float32]] = []
        self.driving: list[NDArray[np.bool_]] = []
        self._reader = reader
        reader.reset(teaming.num_teams)

    def seen(self, teaming: Teaming, observations: NDArray[np.float32]) -> None:
        """Read one turn."""
        self.driving.append(~teaming.over)
        self.turns.append(self._reader.read(observations, self.driving[-1]))
