"""Demonstrations: what could be observed of people who drive, and apart from it the hidden truth.

:class:`Observed` is what code that learns is handed; nothing leads from it to :class:`Truth`. In
arrays, E episodes lie side by side, T steps long at most; in a dataset's folder
(:mod:`hmi_marl.demonstrations.parquet`) they are two parquet files, one row for each step,
sorted by episode and step, where a part of n > 1 columns is ``name_0`` to ``name_{n-1}``.

``observed.parquet``:

==================  ============================  ==============================================
column              type                          meaning
==================  ============================  ==============================================
``episode``         int32                         0, 1, 2, ... without a gap
``step``            int32                         0 to the episode's length - 1
``driver``          dictionary of strings         who drove; null if not known
``seed``            uint64                        of the episode, to play it again; null if none
``crashed``         bool                          the car has crashed by the end of the step
``action``          int8, 0 to 4                  v_t, as applied: ``VEHICLE_ACTIONS``
``alert``           int8, 0 or 1                  a^A_t
``lidar_*``         float32                       s_t before the step, with others in true size
``speed``           float32                       in 40 m/s
``target_speed``    float32                       in 40 m/s
``heading``         float32                       in π
``lateral``         float32                       in widths of the lane
``lane_*``          float32                       one-hot: main lanes from the left, then the ramp
``position``        float32                       in lengths of the road
==================  ============================  ==============================================

``truth.parquet``, if there is any: ``episode``, ``step``, ``distracted`` (d_t), ``accepted`` (i_t),
``counter`` (c_t), ``intended_action`` (a^H_t) and the traits ``beta``, ``alpha``, ``eta``,
``inflation``.

The states are those columns of the vehicle AI's observation, in its units and within its bounds.
The step from row t leads to row t + 1, so an episode of T rows holds T - 1 whole transitions.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import TRAIT_NAMES, Traits, check_traits
from hmi_marl.envs.observations import Layout, vehicle_ai_layout
from hmi_marl.envs.worlds import VEHICLE_ACTIONS

STATE_PARTS = ("lidar", "speed", "target_speed", "heading", "lateral", "lane", "position")
"""What is observed of a state, by the names of the vehicle AI's observation."""
NOBODY = -1
"""A driver who is not known, an action after the end, the step of a crash that never came."""


def observed_layout(config: TeamConfig) -> Layout:
    """Which columns of an observed state are what, in teams set up by ``config``."""
    parts = vehicle_ai_layout(config).parts
    return Layout(tuple(part for part in parts if part.name in STATE_PARTS))


def column_names(layout: Layout) -> list[str]:
    """A name for every column: the part's own, or name_0, name_1, ... if it has several."""
    return [
        part.name if part.size == 1 else f"{part.name}_{k}"
        for part in layout.parts
        for k in range(part.size)
    ]


@dataclass(frozen=True, eq=False)
class Observed:
    """What could be observed of E episodes, T steps long at most. All of it is checked.

    Raises:
        ValueError: arrays that do not fit together, numbers that are not finite or out of their
            range, or parts that cannot be observed of a person; the message says which.
    """

    layout: Layout
    """Which columns of ``states`` are what; the parts are ``STATE_PARTS``."""
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
    """Who drove, an index of ``names``, shape (E,); -1 if that is not known."""
    names: tuple[str, ...] = ()
    """Of the drivers who are known."""
    seeds: NDArray[np.uint64] | None = None
    """Of the episodes, shape (E,), to play them again, never to learn from; None if recorded."""
    about: Mapping[str, Any] = field(default_factory=dict)
    """How it was made, as JSON has it, without anybody's traits."""

    def __post_init__(self) -> None:
        _check_layout(self.layout)
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
        _check_within("length", self.length, 1, shape[1])
        _check_within("driver", self.driver, NOBODY, len(self.names) - 1)
        if (self.crash_step < NOBODY).any() or (self.crash_step >= self.length).any():
            raise ValueError("crash_step is a step of its episode, or -1 where there was no crash")
        self._check_count()
        _check_tells_no_traits(self.about)

    def _check_count(self) -> None:
        real = self.steps_taken
        _check_within("actions", self.actions[real], 0, len(VEHICLE_ACTIONS) - 1)
        _check_within("alerts", self.alerts[real], 0, 1)
        after = ~real
        if (
            (self.actions[after] != NOBODY).any()
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
        """Which steps there were, shape (E, T)."""
        return np.arange(self.actions.shape[1]) < self.length[:, None]

    @property
    def crashed(self) -> NDArray[np.bool_]:
        """Whether the car crashed, shape (E,)."""
        return self.crash_step != NOBODY

    @property
    def driven(self) -> NDArray[np.int64]:
        """Steps up to the crash and with it, shape (E,); after them a crashed car stands."""
        return np.where(self.crashed, self.crash_step + 1, self.length)

    @property
    def number(self) -> NDArray[np.int64]:
        """Place of each among its driver's episodes here, shape (E,), to split a dataset by."""
        number = np.zeros(len(self), np.int64)
        for who in np.unique(self.driver):
            theirs = self.driver == who
            number[theirs] = np.arange(theirs.sum())
        return number

    def labels(self) -> list[str | None]:
        """The drivers' names, an entry for each episode, None if not known."""
        return [None if who == NOBODY else self.names[who] for who in self.driver]

    def take(self, which: ArrayLike) -> Observed:
        """Some of the episodes: a mask of shape (E,) or their places."""
        index = np.arange(len(self))[np.asarray(which)]
        names = ("states", "actions", "alerts", "length", "crash_step", "driver")
        taken: dict[str, Any] = {name: getattr(self, name)[index] for name in names}
        return replace(self, seeds=None if self.seeds is None else self.seeds[index], **taken)


@dataclass(frozen=True, eq=False)
class Truth:
    """What nobody could observe of the same E episodes; for evaluation alone.

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
    """How it was made, the drivers' traits included."""

    def __post_init__(self) -> None:
        shape = np.shape(self.intended)
        if len(shape) != 2:
            raise ValueError(f"intended has shape (E, T), not {shape}")
        for name in ("distracted", "accepted", "counter", "intended"):
            _put(self, name, np.int64, shape)
        _put(self, "traits", np.float64, (shape[0], len(TRAIT_NAMES)))
        for name in ("distracted", "accepted"):
            _check_within(name, getattr(self, name), 0, 1)
        _check_within("counter", self.counter, 0, np.iinfo(np.int32).max)
        _check_within("intended", self.intended, NOBODY, len(VEHICLE_ACTIONS) - 1)
        check_traits(Traits.from_array(self.traits), shape[0])
        over = self.intended == NOBODY
        if any(getattr(self, name)[over].any() for name in ("distracted", "accepted", "counter")):
            raise ValueError("after an episode's end d, i and c are 0")

    def take(self, which: ArrayLike) -> Truth:
        """Some of the episodes: a mask of shape (E,) or their places."""
        index = np.arange(len(self.traits))[np.asarray(which)]
        names = ("distracted", "accepted", "counter", "intended", "traits")
        return replace(self, **{name: getattr(self, name)[index] for name in names})


@dataclass(frozen=True, eq=False)
class Demonstrations:
    """Episodes as observed, with the hidden truth beside them where it is known.

    Raises:
        ValueError: the two are of other episodes.
    """

    observed: Observed
    """All that may be learned from."""
    truth: Truth | None = None
    """For evaluation alone; None of people."""

    def __post_init__(self) -> None:
        if self.truth is None:
            return
        steps = self.observed.steps_taken
        if not np.array_equal(self.truth.intended != NOBODY, steps):
            raise ValueError("the truth is of other episodes than what was observed")

    def __len__(self) -> int:
        return len(self.observed)

    def take(self, which: ArrayLike) -> Demonstrations:
        """Some of the episodes: a mask of shape (E,) or their places."""
        truth = None if self.truth is None else self.truth.take(which)
        return Demonstrations(self.observed.take(which), truth)


@dataclass(frozen=True)
class Recording:
    """One recorded drive of L steps, at the environment's policy frequency."""

    parts: Mapping[str, ArrayLike]
    """Each of ``STATE_PARTS``, in the layout's units, shape (L, part's size), or (L,) for 1."""
    actions: ArrayLike
    """What the car did, 0 to 4, shape (L,)."""
    alerts: ArrayLike
    """Whether the driver was alerted, 0 or 1, shape (L,)."""
    driver: str | None = None
    """Who drove, if that is known."""
    crashed: bool = False
    """Whether the drive ended by a crash."""


def from_recordings(
    recordings: Iterable[Recording], layout: Layout, about: Mapping[str, Any] | None = None
) -> Demonstrations:
    """Recorded drives as demonstrations without truth; they may differ in length.

    Args:
        recordings: an episode each.
        layout: as :func:`observed_layout` gives it for the scene that the data are to fit.
        about: where they are from, as JSON has it.

    Raises:
        ValueError: something is missing, of another shape, or out of its range; the message says
            in which recording.
    """
    _check_layout(layout)
    drives = [_drive(number, recording, layout) for number, recording in enumerate(recordings)]
    if not drives:
        raise ValueError("there is no recording to make demonstrations of")
    names = tuple(dict.fromkeys(one.driver for one, *_ in drives if one.driver is not None))
    length = np.array([len(states) for _, states, _, _ in drives])
    shape = len(drives), int(length.max())
    states = np.zeros((*shape, layout.size), np.float32)
    actions, alerts = np.full(shape, NOBODY), np.zeros(shape, np.int64)
    for number, (_, s, v, a) in enumerate(drives):
        states[number, : len(s)], actions[number, : len(s)], alerts[number, : len(s)] = s, v, a
    crashed = np.array([one.crashed for one, *_ in drives], np.bool_)
    index = {name: place for place, name in enumerate(names)} | {None: NOBODY}
    observed = Observed(
        layout,
        states,
        actions,
        alerts,
        length,
        crash_step=np.where(crashed, length - 1, NOBODY),
        driver=np.array([index[one.driver] for one, *_ in drives]),
        names=names,
        about=dict(about or {}),
    )
    return Demonstrations(observed)


_Drive = tuple[Recording, NDArray[np.float32], NDArray[np.int64], NDArray[np.int64]]


def _drive(number: int, recording: Recording, layout: Layout) -> _Drive:
    """The recording's states (L, layout.size), actions and alerts (L,)."""
    where = f"recording {number}"
    if set(recording.parts) != set(layout.slices):
        odd = ", ".join(sorted(set(recording.parts) ^ set(layout.slices)))
        raise ValueError(f"{where} has not exactly the parts {', '.join(layout.slices)}: {odd}")
    steps = len(np.atleast_1d(recording.actions))
    if steps == 0:
        raise ValueError(f"{where} has no steps")
    states = np.zeros((steps, layout.size), np.float32)
    for part in layout.parts:
        values = np.asarray(recording.parts[part.name], np.float32)
        values = values[:, None] if values.ndim == 1 and part.size == 1 else values
        if values.shape != (steps, part.size):
            raise ValueError(
                f"{where}: {part.name} has shape ({steps}, {part.size}), not {values.shape}"
            )
        states[:, layout[part.name]] = values
    try:
        actions = _whole("actions", recording.actions, np.int64, (steps,))
        alerts = _whole("alerts", recording.alerts, np.int64, (steps,))
        _check_within("actions", actions, 0, len(VEHICLE_ACTIONS) - 1)
        _check_within("alerts", alerts, 0, 1)
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from None
    return recording, states, actions, alerts


def _check_layout(layout: Layout) -> None:
    names = tuple(part.name for part in layout.parts)
    if names != STATE_PARTS:
        raise ValueError(
            f"an observed state has the parts {', '.join(STATE_PARTS)}, in this order and no "
            f"others, but got {', '.join(names)}"
        )


def _check_names(names: Sequence[str]) -> None:
    if not all(isinstance(name, str) and name for name in names) or len(set(names)) < len(names):
        raise ValueError(f"drivers' names are different non-empty strings, not {names!r}")


def _check_tells_no_traits(about: Any) -> None:
    if isinstance(about, Mapping):
        told = [name for name in TRAIT_NAMES if name in about]
        if told:
            raise ValueError(f"what is told about observed data holds no traits, but {told[0]}")
        for value in about.values():
            _check_tells_no_traits(value)
    elif isinstance(about, (list, tuple)):
        for value in about:
            _check_tells_no_traits(value)


def _put(owner: object, name: str, dtype: Any, shape: tuple[int, ...]) -> None:
    """Let the owner's field be an array of this type and shape, or raise."""
    object.__setattr__(owner, name, _whole(name, getattr(owner, name), dtype, shape))


def _whole(name: str, value: ArrayLike, dtype: Any, shape: tuple[int, ...]) -> NDArray[Any]:
    given = np.asarray(value)
    if given.shape != shape:
        raise ValueError(f"{name} has shape {shape}, not {given.shape}")
    kinds = "fiu" if np.dtype(dtype).kind == "f" else "iub"
    if given.dtype.kind not in kinds:
        kind = "numbers" if "f" in kinds else "whole numbers"
        raise ValueError(f"{name} are {kind}, not {given.dtype}")
    return given.astype(dtype, copy=False)


def _check_within(name: str, values: NDArray[Any], low: int, high: int) -> None:
    wrong = (values < low) | (values > high)
    if wrong.any():
        raise ValueError(f"{name} lies in {low} to {high}, but got {values[wrong][0]}")
