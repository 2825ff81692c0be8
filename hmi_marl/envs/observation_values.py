"""The values of observations: the meaning of each part of a layout, in numbers.

:mod:`hmi_marl.envs.observations` names the parts and orders them; :func:`write` fills them in, for
all teams at once in NumPy, or for one after the other where it is compiled.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hmi_marl.envs import team_step
from hmi_marl.envs.config import DRIVER, VEHICLE_AI, TeamConfig
from hmi_marl.envs.drivers import MAX_INFLATION, TRAIT_NAMES
from hmi_marl.envs.elementwise import choose, put, put_one_hot, put_scaled
from hmi_marl.envs.observations import FASTEST, TRAITS_LAYOUT, Layout, lidar_bound, state_layout
from hmi_marl.envs.scene import LANE_WIDTH
from hmi_marl.envs.worlds import VEHICLE_ACTIONS, base

_ACTIONS = len(VEHICLE_ACTIONS)

PARTS = (
    "true_lidar",
    "perceived_lidar",
    "speed",
    "target_speed",
    "heading",
    "lateral",
    "lane",
    "position",
    "intended_action",
    "previous_intended_action",
    "applied_action",
    "alerted",
    "time",
    "distracted",
    "accepted",
    "counter",
    "fatigue",
    "traits",
    *TRAIT_NAMES,
)
"""All parts that :func:`write` knows, in its order. A driver's ``lidar`` is the perceived one; the
names of traits stand for them as they are."""
(
    TRUE_LIDAR, PERCEIVED_LIDAR, SPEED, TARGET_SPEED, HEADING, LATERAL, LANE, POSITION, INTENDED,
    PREVIOUS, APPLIED, ALERTED, TIME, DISTRACTED, ACCEPTED, COUNTER, FATIGUE, TRAITS, *_,
) = range(len(PARTS))  # fmt: skip
_UNSCALED, _TRAITS = PARTS.index(TRAIT_NAMES[0]), len(TRAIT_NAMES)


def first_columns(
    layout: Layout, agent: str, names: Iterable[str] | None = None
) -> NDArray[np.int64]:
    """First column of each of :data:`PARTS` for :func:`write`, -1 for those not to be written.

    Args:
        layout: of an agent's observation, or of the team's state.
        agent: whose layout it is; a driver's lidar is the perceived one.
        names: parts to write; all by default. The other columns are left as they are. The name of
            a single column stands for its whole part.

    Raises:
        KeyError: the layout has no such part.
    """
    names = layout.slices if names is None else names
    first = np.full(len(PARTS), -1)
    for name in map(layout.part_with, names):
        first[PARTS.index(_known_as(name, agent))] = layout[name].start
    return first


def _known_as(name: str, agent: str) -> str:
    """Name among :data:`PARTS` of a part of an agent's layout."""
    if name == "lidar":
        return "perceived_lidar" if agent == DRIVER else "true_lidar"
    return name


class Shown(NamedTuple):
    """Everything about N teams that observations show; for the columns see :mod:`team_step`."""

    true_lidar: NDArray[np.float32]
    """As :meth:`World.lidar` gives it, (N, cells, 2); not read if no column shows it."""
    perceived_lidar: NDArray[np.float32]
    numbers: NDArray[np.float64]
    """Readings of the driven cars."""
    flags: NDArray[np.int64]
    state: NDArray[np.int64]
    intent_given: NDArray[np.bool_]
    """Teams in which the driver has acted and the vehicle AI has not, shape (N,)."""
    traits: NDArray[np.float64]


class Scales(NamedTuple):
    """Constants of a team's settings that scale what observations show."""

    lidar_range: np.float32
    lidar_bound: np.float32
    length: float
    """Length of the road [m]."""
    lanes: int
    """Main lanes and the ramp."""
    horizon: int
    window: int
    levels: int
    """Highest level of fatigue, 1 without fatigue."""
    strengths: NDArray[np.float64]
    """Strength of each alert."""
    low: NDArray[np.float32]
    """Least value of each of :data:`PARTS`."""
    high: NDArray[np.float32]
    """Largest value of each of :data:`PARTS`."""


def scales_of(config: TeamConfig) -> Scales:
    """Constants of these settings."""
    scene, effects = config.scene, config.alerts.effects
    return Scales(
        np.float32(scene.lidar_range),
        np.float32(lidar_bound(scene)),
        float(scene.length),
        scene.lanes + 1,
        config.horizon,
        config.alert_window,
        effects.scale,
        effects.strengths.copy(),
        *_bounds(config),
    )


def _bounds(config: TeamConfig) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Least and largest value of each of :data:`PARTS`, which are the same in every layout."""
    bounds = np.zeros((2, len(PARTS)), np.float32)
    for part in (*state_layout(config).parts, *TRAITS_LAYOUT.parts):
        bounds[:, PARTS.index(_known_as(part.name, VEHICLE_AI))] = part.low, part.high
    low, high = bounds
    return low, high


def write(
    rows: NDArray[np.float32],
    row: Any,
    first: NDArray[np.int64],
    k: Any,
    shown: Shown,
    scales: Scales,
) -> None:
    """Write the observation of team k into a row; the meaning of each :class:`Part` in numbers.

    Args:
        rows: shape (M, D), written in place.
        row: number of the row, or a slice of all of them.
        first: first column of each part, see :func:`first_columns`.
        k: number of the team, or numbers of M teams.
        shown: what is shown, of all teams.
        scales: constants of the settings.
    """
    low, high = scales.low, scales.high
    numbers, state, traits = shown.numbers, shown.state, shown.traits
    strengths = scales.strengths
    reach, bound = scales.lidar_range, scales.lidar_bound  # over its range, as highway-env does
    if first[TRUE_LIDAR] >= 0:
        put_scaled(rows, row, first[TRUE_LIDAR], shown.true_lidar[k], reach, bound)
    if first[PERCEIVED_LIDAR] >= 0:
        put_scaled(rows, row, first[PERCEIVED_LIDAR], shown.perceived_lidar[k], reach, bound)
    put(rows, row, first[SPEED], low[SPEED], high[SPEED], numbers[k, base.SPEED] / FASTEST)
    put(
        rows,
        row,
        first[TARGET_SPEED],
        low[TARGET_SPEED],
        high[TARGET_SPEED],
        numbers[k, base.TARGET_SPEED] / FASTEST,
    )
    put(rows, row, first[HEADING], low[HEADING], high[HEADING], numbers[k, base.HEADING] / np.pi)
    put(
        rows,
        row,
        first[LATERAL],
        low[LATERAL],
        high[LATERAL],
        numbers[k, base.LATERAL] / LANE_WIDTH,
    )
    put_one_hot(rows, row, first[LANE], shown.flags[k, base.LANE], scales.lanes)
    put(
        rows,
        row,
        first[POSITION],
        low[POSITION],
        high[POSITION],
        numbers[k, base.X] / scales.length,
    )
    # Before the driver acts, the latest a^H already is the last step's.
    latest = state[k, team_step.INTENDED]
    previous = choose(shown.intent_given[k], state[k, team_step.PREVIOUS], latest)
    put_one_hot(rows, row, first[INTENDED], latest, _ACTIONS)
    put_one_hot(rows, row, first[PREVIOUS], previous, _ACTIONS)
    put_one_hot(rows, row, first[APPLIED], state[k, team_step.APPLIED], _ACTIONS)
    put(
        rows,
        row,
        first[ALERTED],
        low[ALERTED],
        high[ALERTED],
        strengths[state[k, team_step.ALERTED]],
    )
    put(rows, row, first[TIME], low[TIME], high[TIME], state[k, team_step.STEPS] / scales.horizon)
    put(
        rows,
        row,
        first[DISTRACTED],
        low[DISTRACTED],
        high[DISTRACTED],
        state[k, team_step.DISTRACTED],
    )
    put(
        rows,
        row,
        first[ACCEPTED],
        low[ACCEPTED],
        high[ACCEPTED],
        strengths[state[k, team_step.ACCEPTED]],
    )
    put(
        rows,
        row,
        first[COUNTER],
        low[COUNTER],
        high[COUNTER],
        state[k, team_step.COUNTER] / scales.window,
    )
    put(
        rows,
        row,
        first[FATIGUE],
        low[FATIGUE],
        high[FATIGUE],
        state[k, team_step.FATIGUE] / scales.levels,
    )
    start = first[TRAITS]
    if start >= 0:
        put(rows, row, start, low[TRAITS], high[TRAITS], traits[k, team_step.BETA])
        put(rows, row, start + 1, low[TRAITS], high[TRAITS], traits[k, team_step.ALPHA])
        put(rows, row, start + 2, low[TRAITS], high[TRAITS], traits[k, team_step.ETA])
        put(
            rows,
            row,
            start + 3,
            low[TRAITS],
            high[TRAITS],
            traits[k, team_step.INFLATION] / MAX_INFLATION,
        )
    for trait in range(_TRAITS):
        part = _UNSCALED + trait
        put(rows, row, first[part], low[part], high[part], traits[k, trait])
