"""Drives of drivers with known traits, as turns for an evidence model."""

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
"""Drives in parallel; bounds the memory."""
_KIND = 2**32
"""Counter of the random number that decides whether a named driver drives."""


@dataclass(frozen=True)
class MixedPopulation:
    """Population of the named drivers and of others with uniformly drawn traits."""

    known: float
    """Share of named drivers, in [0, 1]."""

    def draw(self, seeds: NDArray[np.uint64]) -> Traits:
        """See :meth:`Population.draw`."""
        is_known = uniform(seeds, Stream.TRAITS, _KIND) < self.known
        named = DriverList(tuple(DRIVERS.values())).draw(seeds).as_array()
        others = TraitDistributions().draw(seeds).as_array()
        return Traits.from_array(np.where(is_known[:, None], named, others))


@dataclass(frozen=True, eq=False)
class Drives:
    """M drives of at most T turns."""

    turns: NDArray[np.float32]
    """Shape (M, T, columns)."""
    driving: NDArray[np.bool_]
    """Whether the episode was still running, shape (M, T)."""
    traits: Traits
    """Traits of the M drivers."""


def drive_all(
    settings: EvidenceSettings, progress: Callable[[int], object] = lambda drives: None
) -> Drives:
    """Drive many episodes, each HMI with an equal share of the drivers.

    Args:
        settings: number of drives, policies and population.
        progress: called with the number of drives done since the last call.

    Raises:
        ValueError: an unknown HMI or driver policy.
    """
    team = replace(settings.team, driver=MixedPopulation(settings.known))
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
    """Record the turns for an evidence model, when the vehicle AI acts."""

    def __init__(self, reader: Turns, teaming: Teaming) -> None:
        self.turns: list[NDArray[np.float32]] = []
        self.driving: list[NDArray[np.bool_]] = []
        self._reader = reader
        reader.reset(teaming.num_teams)

    def seen(self, teaming: Teaming, observations: NDArray[np.float32]) -> None:
        """Record one turn."""
        self.driving.append(~teaming.over)
        self.turns.append(self._reader.read(observations, self.driving[-1]))
