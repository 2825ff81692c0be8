"""Demonstrations of drives that were recorded elsewhere, such as of people."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hmi_marl.demonstrations.dataset import (
    MISSING,
    Demonstrations,
    Observed,
    as_array,
    check_layout,
    check_within,
)
from hmi_marl.envs.observations import Layout
from hmi_marl.envs.worlds import VEHICLE_ACTIONS
from hmi_marl.text import listed


@dataclass(frozen=True)
class Recording:
    """One drive of L steps recorded elsewhere, at the environment's policy frequency."""

    parts: Mapping[str, ArrayLike]
    """Each of ``STATE_PARTS``, in the layout's units, shape (L, part's size), or (L,) for 1."""
    actions: ArrayLike
    """Applied actions, 0 to 4, shape (L,)."""
    alerts: ArrayLike
    """Whether the driver was alerted, 0 or 1, shape (L,)."""
    driver: str | None = None
    """Name of the driver, if known."""
    crashed: bool = False
    """Whether the drive ended in a crash."""


def from_recordings(
    recordings: Iterable[Recording], layout: Layout, about: Mapping[str, Any] | None = None
) -> Demonstrations:
    """Make demonstrations without truth from drives, one each episode; lengths may differ.

    ``layout`` is that of :func:`observed_layout` for the scene; ``about`` says, as JSON has it,
    where the recordings come from.

    Raises:
        ValueError: a part is missing, of another shape, or out of its range; the message names the
            recording.
    """
    check_layout(layout)
    recordings = list(recordings)
    if not recordings:
        raise ValueError("there is no recording to make demonstrations of")
    drives = [_drive(number, recording, layout) for number, recording in enumerate(recordings)]
    names = tuple(dict.fromkeys(one.driver for one in recordings if one.driver is not None))
    length = np.array([len(actions) for _, actions, _ in drives])
    shape = len(drives), int(length.max())
    states = np.zeros((*shape, layout.size), np.float32)
    actions, alerts = np.full(shape, MISSING), np.zeros(shape, np.int64)
    for number, (s, v, a) in enumerate(drives):
        states[number, : len(s)], actions[number, : len(s)], alerts[number, : len(s)] = s, v, a
    crashed = np.array([one.crashed for one in recordings], np.bool_)
    index = {name: place for place, name in enumerate(names)} | {None: MISSING}
    crash_step = np.where(crashed, length - 1, MISSING)
    driver = np.array([index[one.driver] for one in recordings])
    arrays = (states, actions, alerts, length, crash_step, driver)
    return Demonstrations(Observed(layout, *arrays, names, about=dict(about or {})))


def _drive(
    number: int, recording: Recording, layout: Layout
) -> tuple[NDArray[np.float32], NDArray[np.int64], NDArray[np.int64]]:
    """Return the recording's states (L, layout.size), actions and alerts (L,)."""
    where = f"recording {number}"
    if set(recording.parts) != set(layout.slices):
        odd = listed(sorted(set(recording.parts) ^ set(layout.slices)))
        raise ValueError(f"{where} has not exactly the parts {listed(layout.slices)}: {odd}")
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
        actions = as_array("actions", recording.actions, np.int64, (steps,))
        alerts = as_array("alerts", recording.alerts, np.int64, (steps,))
        check_within("actions", actions, 0, len(VEHICLE_ACTIONS) - 1)
        check_within("alerts", alerts, 0, 1)
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from None
    return states, actions, alerts
