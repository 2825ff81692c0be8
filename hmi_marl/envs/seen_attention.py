"""Attention of drivers that is seen from outside, such as a person's, in place of the chain's draw.

The rules of a step stay as they are: for one step the driver gets traits with which the chain draws
the d_t that was seen for sure.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hmi_marl.envs.team_step import ALPHA, BETA, ETA

BY_CHANCE = -1
"""In place of a d_t that is seen: the chain draws it."""


def seen_from_outside(
    traits: NDArray[np.float64], looking_away: NDArray[np.int64], over: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """Return traits with which the chain draws the given d_t, whatever d_{t-1} and i_t.

    A driver with β = 1, α = 0 and η = 0 is distracted after every step, one with β = 0, α = 1 and
    η = 0 attentive.

    Args:
        traits: shape (N, 4).
        looking_away: d_t, shape (N,); a driver keeps the traits where it is :data:`BY_CHANCE`.
        over: teams whose d_t is not read, shape (N,).

    Raises:
        ValueError: a d_t that is none.
    """
    seen, away = ~over & (looking_away != BY_CHANCE), looking_away == 1
    wrong = seen & ~away & (looking_away != 0)
    if wrong.any():
        raise ValueError(f"looking_away is 0, 1, or -1 by chance, but got {looking_away[wrong][0]}")
    certain = traits.copy()
    certain[seen, BETA], certain[seen, ALPHA], certain[seen, ETA] = away[seen], ~away[seen], 0.0
    return certain
