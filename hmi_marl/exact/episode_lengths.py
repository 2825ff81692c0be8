r"""Sum exact expected rewards over the lengths that episodes had.

An episode that a crash ends after L of at most T steps has fewer rewards than one of the whole
time. So that what is played is compared with an exact value of the same length, the exact value of
E episodes of lengths L_e is

.. math:: \frac{1}{E} \sum_e \sum_{t < L_e} E[r_t]

with E[r_t] the expected reward of step t. This is the expectation of what is played if the length
of an episode is independent of the driver's attention: then E[r_t | L > t] = E[r_t]. If episodes
tend to end while the driver is distracted, those that go on are of drivers less distracted than
E[r_t] says, and the two differ by it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray


def sum_first(rewards: NDArray[np.float64], steps: ArrayLike) -> NDArray[np.float64]:
    """Expected sum of the first ``steps`` steps.

    Args:
        rewards: expected reward of each step, shape (horizon,).
        steps: from 0 to the horizon, of any shape.

    Returns:
        Sums, of the shape of ``steps``.

    Raises:
        ValueError: not whole numbers from 0 to the horizon.
    """
    count, horizon = np.asarray(steps), len(rewards)
    whole = np.issubdtype(count.dtype, np.integer)
    if not whole or np.any((count < 0) | (count > horizon)):
        raise ValueError(f"steps are whole numbers from 0 to {horizon}, but got {steps!r}")
    return np.concatenate(([0.0], np.cumsum(rewards)))[count]
