"""Observations of each seat: flat float32 boxes with named parts.

>>> from hmi_marl.envs.config import TeamConfig
>>> layout = vehicle_ai_layout(TeamConfig(driver="bart"))
>>> layout["distracted"]
slice(58, 59, None)
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import MAX_INFLATION, TRAIT_NAMES, Traits
from hmi_marl.envs.scene import Scene
from hmi_marl.envs.worlds.base import VEHICLE_ACTIONS

COLUMN_NAMES: Mapping[str, tuple[str, ...]] = MappingProxyType({"traits": TRAIT_NAMES})
"""Names of the columns of a part that can also be read one by one, by the name of the part."""
FASTEST = 40.0
"""Speed above which highway-env brakes every vehicle [m/s]; scales all speeds."""


@dataclass(frozen=True)
class Part:
    """One named part of an observation."""

    name: str
    size: int
    low: float
    high: float
    meaning: str


@dataclass(frozen=True)
class Layout:
    """The named parts of an observation, in the order of its columns.

    Columns of a part in :data:`COLUMN_NAMES` also have names of their own: ``layout["inflation"]``
    is the last column of ``layout["traits"]``.
    """

    parts: tuple[Part, ...]

    @cached_property
    def slices(self) -> Mapping[str, slice]:
        """Columns of each part, by name."""
        ends = np.cumsum([part.size for part in self.parts])
        return {
            part.name: slice(int(end) - part.size, int(end))
            for part, end in zip(self.parts, ends, strict=True)
        }

    @cached_property
    def named(self) -> Mapping[str, slice]:
        """Columns of each part, and single columns that have names of their own, by name."""
        single = {
            name: slice(self.slices[part].start + k, self.slices[part].start + k + 1)
            for part, names in COLUMN_NAMES.items()
            if part in self.slices
            for k, name in enumerate(names)
        }
        return single | dict(self.slices)

    @cached_property
    def size(self) -> int:
        """Number of columns."""
        return sum(part.size for part in self.parts)

    def __contains__(self, name: object) -> bool:
        return name in self.named

    def __getitem__(self, name: str) -> slice:
        if name not in self.named:
            raise KeyError(f"no part {name!r} in this observation; it has {', '.join(self.slices)}")
        return self.named[name]

    def part_with(self, name: str) -> str:
        """Name of the part that has a column of this name; a part's own name stays as it is."""
        if name in self.slices:
            return name
        return next((part for part, names in COLUMN_NAMES.items() if name in names), name)

    def columns(self, names: Iterable[str]) -> NDArray[np.int64]:
        """Indices of the columns of the named parts, or single columns, in the order of names."""
        every = np.arange(self.size)
        return np.concatenate([every[self[name]] for name in names])

    def columns_of(self, other: Layout) -> NDArray[np.int64]:
        """Indices of the columns that hold another layout's parts, in that layout's order."""
        return self.columns(part.name for part in other.parts)

    def get(self, observation: NDArray[np.float32], name: str) -> NDArray[np.float32]:
        """The named part of observations of shape (..., size): shape (..., part's size)."""
        return observation[..., self[name]]

    def scalar(self, observation: NDArray[np.float32], name: str) -> NDArray[np.float32]:
        """The named part of size 1, without its own axis: shape (...)."""
        return observation[..., self[name].start]

    def chosen(self, observation: NDArray[np.float32], name: str) -> NDArray[np.int64]:
        """Index of the 1 in the named one-hot part, -1 where there is none: shape (...)."""
        one_hot = self.get(observation, name)
        return np.where(one_hot.any(axis=-1), one_hot.argmax(axis=-1), -1)

    @cached_property
    def bounds(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Least and largest value of each column."""
        bounds = np.array([(part.low, part.high) for part in self.parts], np.float32).T
        low, high = np.repeat(bounds, [part.size for part in self.parts], axis=1)
        return low, high

    def space(self) -> spaces.Box:
        """The box of all observations."""
        return spaces.Box(*self.bounds, dtype=np.float32)

    def table(self) -> str:
        """The layout as text, a line for each part."""
        return "\n".join(
            f"{where.start:>4}:{where.stop:<4} {part.name:<26} {part.meaning}"
            for part, where in zip(self.parts, self.slices.values(), strict=True)
        )


def lidar_bound(scene: Scene) -> float:
    """Largest absolute value that a lidar part shows."""
    return max(1.0, 2 * FASTEST * 1.05 / scene.lidar_range)


def _lidar(name: str, scene: Scene, sizes: str) -> Part:
    bound = lidar_bound(scene)
    meaning = f"(distance, relative radial speed) per ray over {scene.lidar_range:g}, {sizes}"
    return Part(name, 2 * scene.lidar_cells, -bound, bound, meaning)


def _motion(scene: Scene) -> tuple[Part, ...]:
    return (
        Part("speed", 1, -2.0, 2.0, f"speed over {FASTEST:g} m/s"),
        Part("target_speed", 1, 0.0, 1.0, f"speed being brought to, over {FASTEST:g} m/s"),
        Part("heading", 1, -1.0, 1.0, "heading over π"),
        Part("lateral", 1, -5.0, 5.0, "distance from the middle of the lane over its width"),
        Part("lane", scene.lanes + 1, 0.0, 1.0, "one-hot: main lanes from the left, then the ramp"),
        Part("position", 1, -1.0, 2.0, "x over the length of the road"),
    )


_ACTIONS = len(VEHICLE_ACTIONS)
_INTENDED = Part(
    "intended_action",
    _ACTIONS,
    0.0,
    1.0,
    "one-hot a^H: of this step with sequential moves, else of the last; zeros if none yet",
)
_PREVIOUS = Part("previous_intended_action", _ACTIONS, 0.0, 1.0, "one-hot a^H of the last step")
_APPLIED = Part("applied_action", _ACTIONS, 0.0, 1.0, "one-hot v of the last step")
_ALERTED = Part("alerted", 1, 0.0, 1.0, "strength of the alert in the last step, 0 if none")
_ACTION_PARTS = (_INTENDED, _PREVIOUS, _APPLIED, _ALERTED)
_TIME = Part("time", 1, 0.0, 1.0, "share of the episode's steps that are over")
_ATTENTION = (
    Part("distracted", 1, 0.0, 1.0, "d of the last step"),
    Part("accepted", 1, 0.0, 1.0, "i of the last step: strength of the alert in effect, or 0"),
    Part("counter", 1, 0.0, 1.0, "c of the last step over the alert window"),
)
_FATIGUE = Part("fatigue", 1, 0.0, 1.0, "f of the last step over its levels")
_TRAITS = Part("traits", 4, 0.0, 1.0, f"β, α, η, inflation over {MAX_INFLATION:g}")


def _attention(config: TeamConfig) -> tuple[Part, ...]:
    return _ATTENTION if config.fatigue is None else (*_ATTENTION, _FATIGUE)


def driver_layout(config: TeamConfig) -> Layout:
    """The driver's observation: perceived lidar, own motion, applied action, last alert."""
    traits = (_TRAITS,) if config.observe_traits else ()
    lidar = _lidar("lidar", config.scene, "others inflated")
    return Layout((lidar, *_motion(config.scene), _APPLIED, _ALERTED, _TIME, *traits))


def vehicle_ai_layout(config: TeamConfig) -> Layout:
    """The vehicle AI's observation: true lidar, motion, a^H and v, attention if it is seen."""
    lidar = _lidar("lidar", config.scene, "true sizes")
    attention = _attention(config) if config.ai_sees_attention else ()
    traits = (_TRAITS,) if config.observe_traits else ()
    return Layout((lidar, *_motion(config.scene), *_ACTION_PARTS, _TIME, *attention, *traits))


def state_layout(config: TeamConfig) -> Layout:
    """The whole team's state: both lidars and everything that either seat could see."""
    true_lidar = _lidar("lidar", config.scene, "true sizes")
    perceived = _lidar("perceived_lidar", config.scene, "others inflated")
    own = _motion(config.scene)
    return Layout(
        (true_lidar, perceived, *own, *_ACTION_PARTS, _TIME, *_attention(config), _TRAITS)
    )


TRAITS_LAYOUT = Layout(
    tuple(Part(name, 1, 0.0, np.inf, f"the driver's {name}, unscaled") for name in TRAIT_NAMES)
)
"""Columns of the drivers' traits as they are."""


def traits_part(traits: Traits) -> NDArray[np.float64]:
    """Traits of N drivers as observed: shape (N, 4), inflation over its maximum."""
    shown = traits.as_array()
    shown[:, TRAIT_NAMES.index("inflation")] /= MAX_INFLATION
    return shown


def one_hot(index: NDArray[np.int64], size: int) -> NDArray[np.float64]:
    """Shape (N, size); a row of zeros where the index is -1."""
    return (index[:, None] == np.arange(size)).astype(np.float64)
