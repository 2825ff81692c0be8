"""Seats of a vector environment, and groups of its observations."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from hmi_marl.checks import check_choice
from hmi_marl.envs.config import DRIVER, VEHICLE_AI
from hmi_marl.envs.seats import Policy, check_policy
from hmi_marl.envs.teaming import STATE, TRAITS

Seat = Literal["driver", "vehicle_ai", "team"]
TEAM = "team"
CRITIC = "critic"
GROUPS = (DRIVER, VEHICLE_AI, TRAITS, CRITIC)
"""Groups of observations."""

VIEW = {DRIVER: DRIVER, VEHICLE_AI: VEHICLE_AI, TRAITS: TRAITS, CRITIC: STATE}
"""Names of groups among the views that a Teaming gives."""


def check_seat(seat: str, partner: Policy | None) -> None:
    """Raise unless there is such a seat, and a partner just where the other seat needs one."""
    check_choice("seat=", seat, get_args(Seat))
    if seat == TEAM:
        if partner is not None:
            raise ValueError('seat="team" acts for both seats and has no partner')
    elif partner is None:
        raise ValueError(f"seat={seat!r} needs a partner in the other seat")
    else:
        check_policy(partner)


def checked_groups(groups: Collection[str]) -> tuple[str, ...]:
    """Return the groups in the order of GROUPS, or raise ``ValueError``."""
    if isinstance(groups, str) or not groups:
        raise ValueError(f"groups= are one or more of {', '.join(GROUPS)}, not {groups!r}")
    for group in groups:
        check_choice("groups=", group, GROUPS)
    return tuple(group for group in GROUPS if group in groups)


def whole_steps(steps: NDArray[Any], count: int, last: int) -> NDArray[np.int64]:
    """Return steps of episodes as int64, shape (count,).

    Raises:
        ValueError: another shape, or numbers that are not whole and from 0 to ``last``.
    """
    if steps.shape != (count,):
        raise ValueError(f"episode lengths have shape ({count},), not {steps.shape}")
    whole = steps.dtype.kind in "iu" or (steps.dtype.kind == "f" and (steps % 1 == 0).all())
    if not (whole and ((steps >= 0) & (steps <= last)).all()):
        raise ValueError(f"episode lengths are whole numbers from 0 to {last}")
    return steps.astype(np.int64)
