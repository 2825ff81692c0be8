"""Steps of the attention chain in recorded trips, where it is seen when the driver looks away.

The state (d, i, c) and its order of updates are those of :mod:`hmi_marl.envs.attention`: every trip
begins with d = i = c = 0, and i_t and c_t follow from the alerts alone.

A person in the driver's seat sees the alert of a step when that step has been taken, so that it can
change nothing before the next one: for people the window begins a step later
(:data:`SEEN_AFTER`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hmi_marl.checks import Whole, shown
from hmi_marl.envs.attention import check_window, next_acceptance

_DELAY = Whole(0, 1000, "steps")
SEEN_AFTER = 1
"""Steps after which an alert can change what a person does."""
Trip = tuple[ArrayLike, ArrayLike]
"""d_t and a^A_t of one trip, two arrays of one length, of 0 and 1."""


@dataclass(frozen=True, eq=False)
class ChainSteps:
    """All S steps of some trips, one after the other. Each field has shape (S,)."""

    before: NDArray[np.int64]
    """d_{t-1}."""
    after: NDArray[np.int64]
    """d_t."""
    accepted: NDArray[np.int64]
    """i_t: 1 within the window after an alert."""
    counter: NDArray[np.int64]
    """c_t: steps since that alert."""
    age: NDArray[np.int64]
    """Number of steps for which d had been d_{t-1} when step t began, at least 1."""

    @property
    def changes(self) -> NDArray[np.bool_]:
        """Whether d_t differs from d_{t-1}: the second task is opened or closed."""
        return self.before != self.after


@dataclass(frozen=True, eq=False)
class ChainCounts:
    """Four numbers of steps, and in how many of these d was 1: all that the traits depend on.

    Whole numbers, or expected ones, all of one shape.
    """

    openings: NDArray[np.float64]
    """Steps from d = 0 to d = 1 outside windows."""
    attentive: NDArray[np.float64]
    """Steps from d = 0 outside windows."""
    helped_openings: NDArray[np.float64]
    """Steps from d = 0 to d = 1 within windows."""
    helped_attentive: NDArray[np.float64]
    """Steps from d = 0 within windows."""
    closings: NDArray[np.float64]
    """Steps from d = 1 to d = 0 outside windows."""
    away: NDArray[np.float64]
    """Steps from d = 1 outside windows."""
    helped_closings: NDArray[np.float64]
    """Steps from d = 1 to d = 0 within windows."""
    helped_away: NDArray[np.float64]
    """Steps from d = 1 within windows."""

    @classmethod
    def of(cls, steps: ChainSteps) -> ChainCounts:
        """Count the steps of one person."""
        numbers = []
        for state in (0, 1):
            for accepted in (0, 1):
                at_risk = (steps.before == state) & (steps.accepted == accepted)
                numbers += [float((at_risk & steps.changes).sum()), float(at_risk.sum())]
        return cls(*map(np.asarray, numbers))

    @classmethod
    def stack(cls, counts: Sequence[ChainCounts]) -> ChainCounts:
        """Stack the counts of several persons along a new first axis."""
        return cls(*(np.stack([vars(each)[name] for each in counts]) for name in vars(counts[0])))

    def times(self, factor: ArrayLike) -> ChainCounts:
        """Multiply all numbers, as trips that are so many times longer are expected to have."""
        return ChainCounts(*(number * np.asarray(factor) for number in vars(self).values()))

    def as_dict(self) -> dict[str, float]:
        """Numbers of one person by name."""
        return {name: float(number) for name, number in vars(self).items()}


def chain_steps(trips: Sequence[Trip], window: int, delay: int = 0) -> ChainSteps:
    """Find (d, i, c) before and after each step of some trips.

    Args:
        trips: d_t and a^A_t of each trip; trips may differ in length.
        window: N, in steps.
        delay: steps after which an alert begins to count; 0 in the model.

    Raises:
        ValueError: no trips, arrays that do not fit together, or numbers other than 0 and 1.
    """
    check_window(window)
    _DELAY("delay", delay)
    if not trips:
        raise ValueError("traits are measured from at least one trip")
    parts = [_checked(place, *trip) for place, trip in enumerate(trips)]
    length = np.array([len(away) for away, _ in parts])
    shape = len(parts), int(length.max())
    away, alerts = np.zeros((2, *shape), np.int64)
    for row, (own_away, own_alerts) in enumerate(parts):
        away[row, : length[row]] = own_away
        late = own_alerts[: max(0, len(own_alerts) - delay)]
        alerts[row, delay : delay + len(late)] = late
    before = np.concatenate([np.zeros((shape[0], 1), np.int64), away[:, :-1]], axis=1)
    accepted, counter, age = np.zeros((3, *shape), np.int64)
    now, since, lasted = np.zeros((3, shape[0]), np.int64)
    for t in range(shape[1]):
        now, since = next_acceptance(now, since, alerts[:, t], window)
        lasted = lasted + 1
        accepted[:, t], counter[:, t], age[:, t] = now, since, lasted
        lasted = np.where(away[:, t] != before[:, t], 0, lasted)
    within = np.arange(shape[1]) < length[:, None]
    return ChainSteps(*(each[within] for each in (before, away, accepted, counter, age)))


def chain_counts(trips: Sequence[Trip], window: int, delay: int = 0) -> ChainCounts:
    """Count the steps of some trips of one person; see :func:`chain_steps` for the arguments."""
    return ChainCounts.of(chain_steps(trips, window, delay))


def _checked(place: int, away: ArrayLike, alerts: ArrayLike) -> tuple[NDArray[np.int64], ...]:
    arrays = np.asarray(away), np.asarray(alerts)
    for name, values in zip(("looking_away", "alerts"), arrays, strict=True):
        if values.ndim != 1 or values.shape != arrays[0].shape or not len(values):
            raise ValueError(
                f"trip {place}: looking_away and alerts have one number for each step, but their "
                f"shapes are {arrays[0].shape} and {arrays[1].shape}"
            )
        if values.dtype.kind not in "biu" or not np.isin(values, (0, 1)).all():
            raise ValueError(f"trip {place}: {name} holds 0 and 1 alone, but got {shown(values)}")
    return tuple(values.astype(np.int64) for values in arrays)
