r"""What it is worth to get to know a driver: gaps, shares of them, and regret by time.

With R_k, R_a and R_h what the HMI that knows the driver, AvgHMI and another HMI earn from the same
driver on the same roads, HMI h closes the share

.. math:: 1 - \frac{E[R_k - R_h]}{E[R_k - R_a]}

of the gap. Intervals of ratios are bootstrapped over drivers, all HMIs together.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hmi_marl.experiments.adaptation.trips import Trips
from hmi_marl.reporting.statistics import CONFIDENCE, Estimate

DRAWS = 2000
"""Of a bootstrap."""


def at_the_wheel(trips: Trips, values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Values by turns at the wheel: what came after a crash is left out, later trips move up.

    Args:
        trips: E drivers, J trips of T steps.
        values: of each step, shape (E, J, T).

    Returns:
        Shape (E, J T), NaN after the last turn.
    """
    driving = trips.driving.reshape(len(values), -1)
    flat = np.where(driving, values.reshape(len(values), -1), np.nan)
    order = np.argsort(~driving, axis=1, kind="stable")
    return np.take_along_axis(flat, order, axis=1)


def earned_between(trips: Trips, first: int, last: int) -> NDArray[np.float64]:
    """Attention reward in turns ``first`` to ``last`` - 1 at the wheel, shape (E,)."""
    rewards: NDArray[np.float64] = np.nansum(
        at_the_wheel(trips, trips.rewards)[:, first:last], axis=1
    )
    return rewards


@dataclass(frozen=True)
class Closed:
    """How much of the gap from AvgHMI to the HMI that knows the driver another one closes."""

    share: Estimate
    """Of the gap; NaN if there is none to close."""
    gap: Estimate
    """What knowing is worth, per driver, over the same turns."""
    regret: Estimate
    """What the knowing HMI earns more."""


def closed(
    knowing: NDArray[np.float64],
    average: NDArray[np.float64],
    own: NDArray[np.float64],
    same_driver: NDArray[np.int64],
    seed: int = 0,
) -> Closed:
    """See :class:`Closed`.

    Args:
        knowing, average, own: what each HMI earned from each of E drivers, shape (E,).
        same_driver: which driver it was, shape (E,): trips of one driver are drawn together.
        seed: of the bootstrap.
    """
    _, driver = np.unique(same_driver, return_inverse=True)
    drivers = int(driver.max()) + 1
    gaps, regrets = (np.bincount(driver, knowing - other, drivers) for other in (average, own))
    each = np.bincount(driver, minlength=drivers)
    weights = _resamples(drivers, seed)
    gap, regret = weights @ gaps, weights @ regrets
    count = weights @ each
    per_gap, per_regret = (
        _interval(gap / count, gaps.sum() / each.sum()),
        _interval(regret / count, regrets.sum() / each.sum()),
    )
    if per_gap.low <= 0:
        return Closed(Estimate(np.nan, np.nan, np.nan), per_gap, per_regret)
    with np.errstate(divide="ignore", invalid="ignore"):  # a few resamples may have no gap
        share = _interval(1.0 - regret / gap, float(1.0 - regrets.sum() / gaps.sum()))
    return Closed(share, per_gap, per_regret)


def ratio(above: NDArray[np.float64], below: NDArray[np.float64], seed: int = 0) -> Estimate:
    """Mean of ``above`` over the size of the mean of ``below``, both of shape (E,), paired.

    Not a number where the latter is 0.
    """
    weights = _resamples(len(above), seed)
    with np.errstate(divide="ignore", invalid="ignore"):
        return _interval(
            (weights @ above) / np.abs(weights @ below), float(above.mean() / abs(below.mean()))
        )


def by_second(
    trips: Trips, values: NDArray[np.float64], steps_per_second: int
) -> NDArray[np.float64]:
    """Mean over drivers of values (E, J, T), by whole seconds at the wheel.

    Seconds that fewer than half of the drivers have seen are left out.
    """
    turns = at_the_wheel(trips, values)
    enough = np.isfinite(turns).mean(axis=0) >= 0.5
    means = np.nanmean(turns[:, enough], axis=0)
    whole = len(means) // steps_per_second * steps_per_second
    seconds: NDArray[np.float64] = means[:whole].reshape(-1, steps_per_second).mean(axis=1)
    return seconds


def _resamples(count: int, seed: int) -> NDArray[np.float64]:
    """How often each of ``count`` is drawn in each bootstrap, shape (DRAWS, count)."""
    rng = np.random.default_rng(seed)
    return rng.multinomial(count, np.full(count, 1 / count), DRAWS).astype(np.float64)


def _interval(draws: NDArray[np.float64], middle: float) -> Estimate:
    low, high = np.quantile(draws, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
    return Estimate(float(middle), float(low), float(high))
