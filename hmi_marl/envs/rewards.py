"""The eight reward terms of the paper's reward table, by name."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hmi_marl.envs.elementwise import choose
from hmi_marl.envs.streams import check_number

DRIVING_TERMS = ("collision", "speed_reward", "right_lane", "merging", "lane_change")
DRIVER_TERMS = (*DRIVING_TERMS, "distraction")
ALERT_TERMS = ("alert", "accept_alert")
ATTENTION_TERMS = ("distraction", *ALERT_TERMS)
TERMS = (*DRIVER_TERMS, *ALERT_TERMS)

Sharing = Literal["team", "individual", "driving", "attention"]


class Weights(NamedTuple):
    """The fields of :class:`RewardWeights` as numbers."""

    collision: float
    speed_reward: float
    right_lane: float
    merging: float
    lane_change: float
    distraction: float
    alert: float
    accept_alert: float
    max_speed: float


@dataclass(frozen=True)
class RewardWeights:
    """The coefficients of the reward table. The defaults are the paper's.

    Raises:
        ValueError, TypeError: a coefficient that is not a finite number, by name.
    """

    collision: float = -5.0
    """Each step in which the car is crashed."""
    speed_reward: float = 5.0
    """Times current speed over ``max_speed``."""
    right_lane: float = 0.1
    """Each step in the rightmost main lane."""
    merging: float = -0.1
    """Times the lack of speed, (target - current) / target, summed over the merging lane."""
    lane_change: float = -0.1
    """Each a^H that is a lane change."""
    distraction: float = -10.0
    """Each step with d_t = 1."""
    alert: float = 10.0
    """No alert while d_{t-1} = 0; an alert of strength s leaves 1 - s of it."""
    accept_alert: float = 30.0
    """An alert that turns d_{t-1} = 1 into d_t = 0."""
    max_speed: float = 30.0
    """Speed that earns the whole speed reward [m/s]."""

    def __post_init__(self) -> None:
        for field in fields(self):
            name = f"reward weight {field.name}"
            value = check_number(name, getattr(self, field.name))
            if not math.isfinite(value):
                raise ValueError(f"{name} is a finite number, not {value}")
            object.__setattr__(self, field.name, value)
        if self.max_speed <= 0:
            raise ValueError(f"max_speed is positive, but got {self.max_speed}")

    @property
    def numbers(self) -> Weights:
        """The coefficients for :func:`driving_values` and :func:`attention_values`."""
        return Weights(*(getattr(self, name) for name in Weights._fields))


def driving_values(
    weights: Weights,
    crashed: Any,
    speed: Any,
    in_right_lane: Any,
    merging_slowness: Any,
    changes_lane: Any,
) -> tuple[Any, Any, Any, Any, Any]:
    """The five terms about the world, in the order of ``DRIVING_TERMS``; see driving_terms."""
    return (
        choose(crashed, weights.collision, 0.0),
        weights.speed_reward * speed / weights.max_speed,
        choose(in_right_lane, weights.right_lane, 0.0),
        weights.merging * merging_slowness + 0.0,  # no -0.0
        choose(changes_lane, weights.lane_change, 0.0),
    )


def attention_values(
    weights: Weights, alert: Any, distracted_before: Any, distracted: Any
) -> tuple[Any, Any, Any]:
    """The three terms about attention, in the order of ``ATTENTION_TERMS``; see attention_terms."""
    helps = (alert > 0) & (distracted_before == 1) & (distracted == 0)
    return (
        choose(distracted == 1, weights.distraction, 0.0),
        choose(distracted_before == 0, weights.alert * (1.0 - alert), 0.0) + 0.0,  # no -0.0
        choose(helps, weights.accept_alert, 0.0),
    )


def driving_terms(
    weights: RewardWeights,
    *,
    crashed: NDArray[np.bool_],
    speed: NDArray[np.float64],
    in_right_lane: NDArray[np.bool_],
    merging_slowness: NDArray[np.float64],
    changes_lane: NDArray[np.bool_],
) -> dict[str, NDArray[np.float64]]:
    """The five terms about the world.

    Args:
        weights: the coefficients.
        crashed: whether the car is crashed after the step. All arrays have shape (N,).
        speed: after the step [m/s].
        in_right_lane: whether the car is in the rightmost main lane after the step.
        merging_slowness: sum of (target - current) / target over vehicles in the merging lane.
        changes_lane: whether a^H_t is move_left or move_right.

    Returns:
        One array of shape (N,) for each of ``DRIVING_TERMS``.
    """
    values = driving_values(
        weights.numbers, crashed, speed, in_right_lane, merging_slowness, changes_lane
    )
    return dict(zip(DRIVING_TERMS, values, strict=True))


def attention_terms(
    weights: RewardWeights, *, alert: ArrayLike, distracted_before: ArrayLike, distracted: ArrayLike
) -> dict[str, NDArray[np.float64]]:
    """The three terms about the driver's attention.

    Args:
        weights: the coefficients.
        alert: strength of the alert in step t, 0 for none: of the paper's alerts a^A_t itself.
            All arrays are broadcast against each other.
        distracted_before: d_{t-1}.
        distracted: d_t.

    Returns:
        One array for each of ``ATTENTION_TERMS``.
    """
    alert, before, now = np.broadcast_arrays(alert, distracted_before, distracted)
    values = attention_values(weights.numbers, alert, before, now)
    return dict(zip(ATTENTION_TERMS, values, strict=True))


SHARES: dict[Sharing, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "team": (TERMS, TERMS),
    "individual": (DRIVER_TERMS, ALERT_TERMS),
    "driving": (DRIVING_TERMS, DRIVING_TERMS),
    "attention": (ATTENTION_TERMS, ATTENTION_TERMS),
}
"""Reward terms of the driver and of the vehicle AI."""


def places(sharing: Sharing) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Places in ``TERMS`` of the terms that the driver gets, and of the vehicle AI's."""
    driver, vehicle_ai = (np.array([TERMS.index(n) for n in names]) for names in SHARES[sharing])
    return driver, vehicle_ai


def add_up(values: tuple[Any, ...], places: NDArray[np.int64]) -> Any:
    """Sum of the values of the terms in these places, from the first to the last."""
    # One after the other: NumPy's sum adds a single team's terms in another order than many teams'.
    total = values[places[0]]
    for k in range(1, len(places)):
        total = total + values[places[k]]
    return total


def share(
    terms: Mapping[str, NDArray[np.float64]], sharing: Sharing
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Rewards of the driver and of the vehicle AI, shapes (N,): sums of the terms in SHARES."""
    values = tuple(terms[name] for name in TERMS)
    driver, vehicle_ai = (add_up(values, which) for which in places(sharing))
    return driver, vehicle_ai
