r"""Estimates and 95 % intervals of β, α and η of a person, from openings, closings and alerts.

An interval holds the values that a likelihood ratio test does not reject at 5 %: those whose
profile (:mod:`~hmi_marl.people.measure.likelihood`) is less than 1.92 below the maximum, half of
the 95 % quantile of χ² with one degree of freedom. So a value that fits as well as the best is
always in it. Above all, where η exceeds both β and 1 - α, all larger η are one and the same to
this model, and the interval ends at 1; the estimate is then the least of them.

From few events the χ² quantile is too small: with about two openings in all, 95 % becomes 85 %.
With fewer than 10 openings outside windows, the interval of β therefore covers that of Clopper and
Pearson, which is exact, and the same holds for α and closings, and for β near 1 and α near 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hmi_marl.checks import Real
from hmi_marl.people.measure.likelihood import Likelihood
from hmi_marl.people.measure.steps import ChainCounts, ChainSteps, Trip, chain_steps
from hmi_marl.reporting.statistics import CONFIDENCE, Estimate

ATTENTION_TRAITS = ("beta", "alpha", "eta")
FEW = 10
"""Fewer events than these, outside windows, and an interval is widened to the exact one."""
_DROP = 1.920729
"""Half of the 95 % quantile of χ² with one degree of freedom."""
_TIED = 1e-6
"""Difference of log likelihoods that counts as none."""
_ROOM = 17
_ZOOMS = 5
"""An end is searched for among ``_ROOM`` places, ``_ZOOMS`` times over."""


@dataclass(frozen=True, eq=False)
class MeasuredAttention:
    """β, α and η of one person."""

    beta: Estimate
    alpha: Estimate
    eta: Estimate
    counts: ChainCounts
    """Counts that they follow from."""
    steps: ChainSteps
    """Steps that were counted."""


@dataclass(frozen=True, eq=False)
class Intervals:
    """Estimates and 95 % intervals of one trait of several persons, arrays of one shape."""

    estimate: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]

    @property
    def width(self) -> NDArray[np.float64]:
        """Distance between the ends."""
        return self.high - self.low

    def covers(self, value: NDArray[np.float64] | float) -> NDArray[np.bool_]:
        """Whether the intervals hold a value."""
        return (self.low <= value) & (value <= self.high)


def measure_attention(trips: Sequence[Trip], window: int, delay: int = 0) -> MeasuredAttention:
    """Measure β, α and η of one person.

    Args:
        trips: d_t and a^A_t of each trip, arrays of 0 and 1.
        window: N, in steps.
        delay: steps after which an alert begins to count; :data:`SEEN_AFTER` for people.

    Raises:
        ValueError: see :func:`chain_steps`.
    """
    steps = chain_steps(trips, window, delay)
    counts = ChainCounts.of(steps)
    found = {
        name: Estimate(float(each.estimate), float(each.low), float(each.high))
        for name, each in intervals(counts).items()
    }
    return MeasuredAttention(**found, counts=counts, steps=steps)


def intervals(counts: ChainCounts) -> dict[str, Intervals]:
    """Estimate β, α and η of several persons at once, from counts of any one shape.

    Of a state that was never seen nothing is known: its trait is estimated as 0.5, in [0, 1].
    """
    likelihood = Likelihood.of(counts)
    best_eta, highest = likelihood.maximum()
    best = {
        "beta": likelihood.attentive.best(best_eta)[0],
        "alpha": 1.0 - likelihood.away.best(best_eta)[0],
        "eta": best_eta,
    }
    found = {}
    for name, place in best.items():
        low, high = _ends(likelihood, name, place, highest - _DROP)
        if name == "eta":
            place = _ends(likelihood, name, place, highest - _TIED)[0]
        else:
            state = likelihood.attentive if name == "beta" else likelihood.away
            place = np.where(state.steps + state.helped_steps > 0, place, 0.5)
            events, at_risk = _OUTSIDE[name]
            low, high = _widened(low, high, getattr(counts, events), getattr(counts, at_risk))
        found[name] = Intervals(place, low, high)
    return found


_OUTSIDE = {"beta": ("openings", "attentive"), "alpha": ("closings", "away")}
"""Counts of the events outside windows, and of the steps in which they may happen."""


def _ends(
    likelihood: Likelihood, trait: str, best: NDArray[np.float64], least: NDArray[np.float64]
) -> NDArray[np.float64]:
    """First and last value at which the profile reaches ``least``, on a new first axis."""
    inner = np.stack([best, best])
    outer = np.stack([np.zeros(best.shape), np.ones(best.shape)])
    shares = np.linspace(0.0, 1.0, _ROOM).reshape(-1, *[1] * inner.ndim)
    for _ in range(_ZOOMS):
        places = outer + (inner - outer) * shares
        reaches = likelihood.profile(trait, places) >= least
        reaches[-1] = True
        first = reaches.argmax(axis=0)[None]  # 0 where the end of [0, 1] reaches it
        inner = np.take_along_axis(places, first, 0)[0]
        outer = np.take_along_axis(places, np.maximum(first - 1, 0), 0)[0]
    return inner


def _widened(
    low: NDArray[np.float64],
    high: NDArray[np.float64],
    events: NDArray[np.float64],
    steps: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Widen intervals to those of Clopper and Pearson where there are few events."""
    from scipy import stats  # takes half a second

    others = steps - events
    few = np.minimum(events, others) < FEW
    tail = (1.0 - CONFIDENCE) / 2
    with np.errstate(invalid="ignore"):  # no events, or no others: the ends are 0 and 1
        exact_low = np.where(events > 0, stats.beta.ppf(tail, events, others + 1), 0.0)
        exact_high = np.where(others > 0, stats.beta.ppf(1 - tail, events + 1, others), 1.0)
    return (
        np.where(few, np.minimum(low, exact_low), low),
        np.where(few, np.maximum(high, exact_high), high),
    )


_WIDTH = Real(0.0, 1.0, above=True, below=True)


def check_width(width: float) -> float:
    """Return the width of an interval, or raise if it is not in (0, 1)."""
    return _WIDTH("the width of an interval", width)


_FACTORS = np.geomspace(0.02, 200.0, 41)
"""Lengths for which widths are expected, as multiples of the recorded one."""


def minutes_needed(counts: ChainCounts, minutes: float, width: float) -> dict[str, float | None]:
    """Minutes of calibration after which each interval is expected to be this wide.

    By the width from counts in the proportions of those seen. None where even 200 times as many
    minutes are too few: the interval of η can stay wide for ever, since all η above β and 1 - α
    are the same to the model.

    Args:
        counts: of one person.
        minutes: length of what was counted.
        width: of the interval, from its lower to its upper end.

    Raises:
        ValueError, TypeError: a width that is not in (0, 1).
    """
    check_width(width)
    needed: dict[str, float | None] = {}
    for name, found in intervals(counts.times(_FACTORS)).items():
        enough = found.width <= width
        # The last length that is too short: near it the width falls as a power of the length.
        last = -1 if not (~enough).any() else int(np.flatnonzero(~enough)[-1])
        if last == len(_FACTORS) - 1:
            needed[name] = None
            continue
        if last == -1:
            needed[name] = float(minutes * _FACTORS[0])
            continue
        sizes = np.log(_FACTORS[last : last + 2])
        widths = np.log(np.maximum(found.width[last : last + 2], 1e-12))
        share = (widths[0] - np.log(width)) / max(widths[0] - widths[1], 1e-12)
        needed[name] = float(minutes * np.exp(sizes[0] + share * (sizes[1] - sizes[0])))
    return needed
