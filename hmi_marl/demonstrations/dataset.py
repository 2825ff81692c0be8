"""Demonstrations: observable data of drivers and, separate from them, the hidden truth.

Code that learns gets :class:`Observed` alone, which holds no reference to :class:`Truth`. Arrays
hold E episodes of at most T steps. The folder of a dataset
(:mod:`hmi_marl.demonstrations.parquet`) holds two parquet files with one row for each step, sorted
by episode and step, where a part of n > 1 columns is ``name_0`` to ``name_{n-1}``.

``observed.parquet``:

==================  ============================  ==============================================
column              type                          meaning
==================  ============================  ==============================================
``episode``         int32                         0, 1, 2, ... without a gap
``step``            int32                         0 to the episode's length - 1
``driver``          dictionary of strings         the driver's name; null if not known
``seed``            uint64                        seed of the episode; null if recorded
``crashed``         bool                          the car has crashed by the end of the step
``action``          int8, 0 to 4                  v_t, as applied: ``VEHICLE_ACTIONS``
``alert``           int8, 0 or 1                  a^A_t
``lidar_*``         float32                       s_t before the step, other vehicles in true size
``speed``           float32                       in 40 m/s
``target_speed``    float32                       in 40 m/s
``heading``         float32                       in π
``lateral``         float32                       in widths of the lane
``lane_*``          float32                       one-hot: main lanes from the left, then the ramp
``position``        float32                       in lengths of the road
==================  ============================  ==============================================

``truth.parquet``, if known: ``episode``, ``step``, ``distracted`` (d_t), ``accepted`` (i_t),
``counter`` (c_t), ``intended_action`` (a^H_t) and the traits ``beta``, ``alpha``, ``eta``,
``inflation``.

The states are columns of the vehicle AI's observation, in its units and within its bounds. The
step of row t leads to row t + 1, so an episode of T rows holds T - 1 complete transitions.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import TRAIT_NAMES, Traits, check_traits
from hmi_marl.envs.observations import Layout, vehicle_ai_layout
from hmi_marl.envs.worlds import VEHICLE_ACTIONS
from hmi_marl.text import listed

T = TypeVar("T")
STATE_PARTS = ("lidar", "speed", "target_speed", "heading", "lateral", "lane", "position")
"""Parts of the vehicle AI's observation that make up an observed state."""
MISSING = -1
"""An unknown driver, an action after the end, the crash step of an episode without a crash."""


def observed_layout(config: TeamConfig) -> Layout:
    """Return the layout of observed states in teams set up by ``config``."""
    parts = vehicle_ai_layout(config).parts
    return Layout(tuple(part for part in parts if part.name in STATE_PARTS))


@dataclass(frozen=True, eq=False)
class Observed:
    """Observable data of E episodes of at most T steps, checked.

    Raises:
        ValueError: arrays that do not fit together, numbers that are not finite or out of their
            range, or parts that cannot be observed of a person; the message says which.
    """

    layout: Layout
    """Layout of ``states``; the parts are ``STATE_PARTS``."""
    states: NDArray[np.float32]
    """s_t before step t, shape (E, T, layout.size); zeros after an episode's end."""
    actions: NDArray[np.int64]
    """v_t as applied, 0 to 4, shape (E, T); -1 after the end."""
    alerts: NDArray[np.int64]
    """a^A_t, 0 or 1, shape (E, T); 0 after the end."""
    length: NDArray[np.int64]
    """Steps of each episode, shape (E,)."""
    crash_step: NDArray[np.int64]
    """The step in which the car crashed, shape (E,); -1 if it did not."""
    driver: NDArray[np.int64]
    """Driver of each episode, an index of ``names``, shape (E,); -1 if not known."""
    names: tuple[str, ...] = ()
    """Names of the known drivers."""
    seeds: NDArray[np.uint64] | None = None
    """Seeds that replay the episodes, shape (E,), not for learning; None if recorded elsewhere."""
    about: Mapping[str, Any] = field(default_factory=dict)
    """How the data were made, as JSON has it, without traits."""

    def __post_init__(self) -> None:
        check_layout(self.layout)
        shape = np.shape(self.actions)
        if len(shape) != 2 or 0 in shape:
            raise ValueError(f"actions have shape (E, T) with at least one step, not {shape}")
        count, columns = shape[:1], (*shape, self.layout.size)
        _put(self, "states", np.float32, columns)
        for name in ("actions", "alerts"):
            _put(self, name, np.int64, shape)
        for name in ("length", "crash_step", "driver"):
            _put(self, name, np.int64, count)
        if self.seeds is not None:
            _put(self, "seeds", np.uint64, count)
        object.__setattr__(self, "names", tuple(self.names))
        _check_names(self.names)
        check_within("length", self.length, 1, shape[1])
        check_within("driver", self.driver, MISSING, len(self.names) - 1)
        if (self.crash_step < MISSING).any() or (self.crash_step >= self.length).any():
            raise ValueError("crash_step is a step of its episode, or -1 where there was no crash")
        self._check_count()
        _check_no_traits(self.about)

    def _check_count(self) -> None:
        real = self.steps_taken
        check_within("actions", self.actions[real], 0, len(VEHICLE_ACTIONS) - 1)
        check_within("alerts", self.alerts[real], 0, 1)
        after = ~real
        if (
            (self.actions[after] != MISSING).any()
            or self.alerts[after].any()
            or self.states[after].any()
        ):
            raise ValueError(
                "after an episode's end actions are -1, and alerts and states are zeros"
            )
        low, high = self.layout.space().low, self.layout.space().high
        for name, where in self.layout.slices.items():
            values = self.states[..., where]
            if not np.isfinite(values).all():
                raise ValueError(f"{name} is not finite everywhere")
            least, most = low[where][0], high[where][0]
            if (values < least).any() or (values > most).any():
                raise ValueError(
                    f"{name} lies in [{least:g}, {most:g}], but reaches from {values.min():g} to "
                    f"{values.max():g}; see the units in the layout"
                )
        lane = self.layout.get(self.states, "lane")[real]
        if ((lane != 0) & (lane != 1)).any() or (lane.sum(axis=1) != 1).any():
            raise ValueError("lane is one-hot: a single 1, and zeros, in every step")

    def __len__(self) -> int:
        return len(self.length)

    @property
    def steps_taken(self) -> NDArray[np.bool_]:
        """Whether each step is part of its episode, shape (E, T)."""
        return np.arange(self.actions.shape[1]) < self.length[:, None]

    @property
    def crashed(self) -> NDArray[np.bool_]:
        """Whether the car crashed, shape (E,)."""
        return self.crash_step != MISSING

    @property
    def driven(self) -> NDArray[np.int64]:
        """Steps up to and including the crash, shape (E,); after it the crashed car stands."""
        return np.where(self.crashed, self.crash_step + 1, self.length)

    @property
    def number(self) -> NDArray[np.int64]:
        """Number of each episode among those of its driver, shape (E,), to split a dataset by."""
        return numbers(self.driver)

    def labels(self) -> list[str | None]:
        """Return the driver's name of each episode, None if not known."""
        return [None if who == MISSING else self.names[who] for who in self.driver]

    def take(self, which: ArrayLike) -> Observed:
        """Select episodes by a mask of shape (E,) or by their indices."""
        names = ["states", "actions", "alerts", "length", "crash_step", "driver"]
        return _taken(self, names + ["seeds"] * (self.seeds is not None), len(self), which)


@dataclass(frozen=True, eq=False)
class Truth:
    """Hidden variables of the same E episodes; for evaluation alone.

    Raises:
        ValueError: arrays that do not fit together, or numbers out of their range.
    """

    distracted: NDArray[np.int64]
    """d_t, shape (E, T); this, i and c are 0 after an episode's end."""
    accepted: NDArray[np.int64]
    """i_t, shape (E, T)."""
    counter: NDArray[np.int64]
    """c_t, shape (E, T)."""
    intended: NDArray[np.int64]
    """a^H_t, shape (E, T); -1 after the end."""
    traits: NDArray[np.float64]
    """Columns as in ``TRAIT_NAMES``, shape (E, 4)."""
    about: Mapping[str, Any] = field(default_factory=dict)
    """How the data were made, including the drivers' traits."""

    def __post_init__(self) -> None:
        shape = np.shape(self.intended)
        if len(shape) != 2:
            raise ValueError(f"intended has shape (E, T), not {shape}")
        for name in ("distracted", "accepted", "counter", "intended"):
            _put(self, name, np.int64, shape)
        _put(self, "traits", np.float64, (shape[0], len(TRAIT_NAMES)))
        for name in ("distracted", "accepted"):
            check_within(name, getattr(self, name), 0, 1)
        check_within("counter", self.counter, 0, np.iinfo(np.int32).max)
        check_within("intended", self.intended, MISSING, len(VEHICLE_ACTIONS) - 1)
        check_traits(Traits.from_array(self.traits), shape[0])
        over = self.intended == MISSING
        if any(getattr(self, name)[over].any() for name in ("distracted", "accepted", "counter")):
            raise ValueError("after an episode's end d, i and c are 0")

    def traits_of(self, pools: ArrayLike) -> NDArray[np.float64]:
        """Return the traits of pools of windows, (P, n), as their means if they drift, (P, 4)."""
        own = self.traits[np.asarray(pools)]
        same = (own == own[:, :1]).all(axis=1)  # whose mean may be rounded
        return np.where(same, own[:, 0], own.mean(axis=1))

    def take(self, which: ArrayLike) -> Truth:
        """Select episodes by a mask of shape (E,) or by their indices."""
        names = ("distracted", "accepted", "counter", "intended", "traits")
        return _taken(self, names, len(self.traits), which)


@dataclass(frozen=True, eq=False)
class Demonstrations:
    """Observed episodes and, if known, their hidden truth.

    Raises:
        ValueError: the truth is of other episodes.
    """

    observed: Observed
    """Data to learn from."""
    truth: Truth | None = None
    """For evaluation alone; None for people."""

    def __post_init__(self) -> None:
        if self.truth is None:
            return
        if not np.array_equal(self.truth.intended != MISSING, self.observed.steps_taken):
            raise ValueError("the truth is of other episodes than what was observed")

    def __len__(self) -> int:
        return len(self.observed)

    def take(self, which: ArrayLike) -> Demonstrations:
        """Select episodes by a mask of shape (E,) or by their indices."""
        truth = None if self.truth is None else self.truth.take(which)
        return Demonstrations(self.observed.take(which), truth)


def numbers(driver: NDArray[np.int64]) -> NDArray[np.int64]:
    """Number each episode among those of its driver, given the drivers (E,)."""
    order = np.argsort(driver, kind="stable")
    by_driver = driver[order]
    number = np.empty(len(driver), np.int64)
    number[order] = np.arange(len(driver)) - np.searchsorted(by_driver, by_driver)
    return number


def alert_rate(observed: Observed) -> float:
    """Return the mean number of alerts per step."""
    return float(observed.alerts[observed.steps_taken].mean())


def held_out(driver: NDArray[np.int64], share: float) -> NDArray[np.bool_]:
    """Mark the last share of every driver's episodes, which are never learned from; shape (E,).

    ``driver`` is that of each episode, shape (E,); -1 if not known.
    """
    count = np.bincount(driver - MISSING)  # the unknown driver's first
    kept = np.round((1.0 - share) * count[driver - MISSING])
    return numbers(driver) >= kept


def disjoint_pools(driver: NDArray[np.int64], size: int) -> NDArray[np.int64]:
    """Make pools of ``size`` windows of one known driver each, in order, no window in two.

    Windows have drivers (E,), -1 if not known. Returns indices of windows, shape (P, size); windows
    that are left over are left out.
    """
    pools = [np.zeros((0, size), np.int64)]
    for who in np.unique(driver[driver != MISSING]):
        own = np.flatnonzero(driver == who)
        whole = len(own) // size * size
        pools.append(own[:whole].reshape(-1, size))
    return np.concatenate(pools)


@dataclass(frozen=True)
class Split:
    """Demonstrations as a model's run divided them."""

    learned: Demonstrations
    """Windows that it learned from."""
    unseen: Demonstrations
    """Windows that it held out."""

    @classmethod
    def of(cls, demonstrations: Demonstrations, share: float, most: int) -> Split:
        """Split them as a run does that holds out ``share`` of each driver's windows, the last.

        At most ``most`` windows of each driver are kept on either side.

        Raises:
            ValueError: nothing was held out.
        """
        out = held_out(demonstrations.observed.driver, share)
        if not out.any():
            raise ValueError("no window was held out of training, so there is nothing to judge by")
        parts = (demonstrations.take(~out), demonstrations.take(out))
        return cls(*(part.take(part.observed.number < most) for part in parts))


def check_layout(layout: Layout) -> None:
    """Check that a layout is that of observed states, or raise ValueError."""
    names = tuple(part.name for part in layout.parts)
    if names != STATE_PARTS:
        raise ValueError(
            f"an observed state has the parts {', '.join(STATE_PARTS)}, in this order and no "
            f"others, but got {listed(names)}"
        )


def _check_names(names: Sequence[str]) -> None:
    if not all(isinstance(name, str) and name for name in names) or len(set(names)) < len(names):
        raise ValueError(f"drivers' names are different non-empty strings, not {names!r}")


def _check_no_traits(about: Any) -> None:
    if isinstance(about, Mapping):
        if found := [name for name in TRAIT_NAMES if name in about]:
            raise ValueError(f"about of observed data may hold no traits, but holds {found[0]}")
        for value in about.values():
            _check_no_traits(value)
    elif isinstance(about, (list, tuple)):
        for value in about:
            _check_no_traits(value)


def _taken(whole: T, names: Iterable[str], count: int, which: ArrayLike) -> T:
    """Return a copy with these of its arrays cut down from ``count`` episodes to some of them.

    They need no new check.
    """
    taken, index = copy(whole), np.arange(count)[np.asarray(which)]
    for name in names:
        object.__setattr__(taken, name, getattr(whole, name)[index])
    return taken


def _put(owner: object, name: str, dtype: Any, shape: tuple[int, ...]) -> None:
    """Convert the owner's field to an array of this type and shape, or raise."""
    object.__setattr__(owner, name, as_array(name, getattr(owner, name), dtype, shape))


def as_array(name: str, value: ArrayLike, dtype: Any, shape: tuple[int, ...]) -> NDArray[Any]:
    """Convert a value, by its name, to an array of this type and shape, or raise ValueError."""
    given = np.asarray(value)
    if given.shape != shape:
        raise ValueError(f"{name} has shape {shape}, not {given.shape}")
    kinds = "fiu" if np.dtype(dtype).kind == "f" else "iub"
    if given.dtype.kind not in kinds:
        kind = "numbers" if "f" in kinds else "whole numbers"
        raise ValueError(f"{name} are {kind}, not {given.dtype}")
    return given.astype(dtype, copy=False)


def check_within(name: str, values: NDArray[Any], low: int, high: int) -> None:
    """Check that all values lie in [low, high], or raise ValueError."""
    wrong = (values < low) | (values > high)
    if wrong.any():
        raise ValueError(f"{name} lies in {low} to {high}, but got {values[wrong][0]}")
