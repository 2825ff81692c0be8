"""The eight reward terms of the paper's reward table, by name."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hmi_marl.checks import Checked, Real
from hmi_marl.envs.elementwise import choose

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


Coefficient = Annotated[float, Real(-1e6, 1e6)]


@dataclass(frozen=True)
class RewardWeights(Checked):
    """The coefficients of the reward table. The defaults are the paper's.

    Each lies in [-1,000,000, 1,000,000].

    Raises:
        ValueError, TypeError: a coefficient out of its range, by name.
    """

    collision: Coefficient = -5.0
    """Each step in which the car is crashed."""
    speed_reward: Coefficient = 5.0
    """Times current speed over ``max_speed``."""
    right_lane: Coefficient = 0.1
    """Each step in the rightmost main lane."""
    merging: Coefficient = -0.1
    """Times the lack of speed, (target - current) / target, summed over the merging lane."""
    lane_change: Coefficient = -0.1
    """Each a^H that is a lane change."""
    distraction: Coefficient = -10.0
    """Each step with d_t = 1."""
    alert: Coefficient = 10.0
    """No alert while d_{t-1} = 0; an alert of strength s leaves 1 - s of it."""
    accept_alert: Coefficient = 30.0
    """An alert that turns d_{t-1} = 1 into d_t = 0."""
    max_speed: Annotated[float, Real(0.1, 1000.0, "m/s")] = 30.0
    """Speed that earns the whole speed reward [m/s], 0.1 to 1000."""

    def _named(self, field: str) -> str:
        return f"reward weight {field}"

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
