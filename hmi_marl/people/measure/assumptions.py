r"""Tests of what the model assumes of a person: memoryless dwell times, and a constant effect.

The model says that every step outside windows from d = 0 ends in d = 1 with one probability, β,
however long d has been 0; so dwell times are geometric. The same holds for d = 1 and 1 - α. Within
a window it says that the probabilities do not depend on the step since the alert, and that one η
moves both of them. Each is tested against its own alternative:

- Dwell times: the probability of a change depends on the time t in the state, by a logistic
  regression on log t and its square (rising, falling, or both in turn). Steps within windows are
  left out, but the time goes on.
- Effect: it depends on the step since the alert, c, by the same on c and its square, in both
  states. So an effect that fades or comes late is found.
- One η: four probabilities of their own, instead of three traits.

The first two are score tests, whose distribution if the model holds is drawn: the same number of
changes is distributed at random over the same steps. That of the third is drawn from the traits
that fit best. All p-values are then corrected for the number of tests (Holm, 1979), so that a
person who fulfils the model is called different in one of them at most in 5 % of recordings.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hmi_marl.people.measure.likelihood import Likelihood
from hmi_marl.people.measure.steps import ChainCounts, ChainSteps

LEVEL = 0.05
"""Share of recordings of persons who fulfil the model in which any test may reject it."""
_DRAWS = 1999
"""Draws of a statistic's distribution."""
_ONE_ETA_DRAWS = 999


@dataclass(frozen=True)
class AssumptionTest:
    """Result of one test."""

    name: str
    """dwell_attentive, dwell_away, constant_effect or one_effect."""
    p: float | None
    """Probability of such a deviation, or a larger one, if the model holds; corrected for the
    number of tests. None where too little was seen to test it."""
    trend: float | None
    """Mean of what the changes depend on (log of the time in the state, or step since the alert)
    where d changed, less that of all steps. Above 0, a change becomes likelier with time. For the
    effect: above 0, it grows within the window. None for one_effect."""

    @property
    def rejected(self) -> bool:
        """Whether the assumption does not hold for this person."""
        return self.p is not None and self.p < LEVEL


@dataclass(frozen=True, eq=False)
class _Rows:
    """Steps at risk of a change, grouped by a covariate that takes G values."""

    value: NDArray[np.float64]
    """The covariate, shape (G,)."""
    steps: NDArray[np.int64]
    """Steps with it, shape (G,)."""
    changes: NDArray[np.int64]
    """Changes in these, shape (G,)."""

    @classmethod
    def of(cls, covariate: NDArray[np.int64], changed: NDArray[np.bool_]) -> _Rows:
        value, where, steps = np.unique(covariate, return_inverse=True, return_counts=True)
        changes = np.bincount(where.reshape(-1), changed, len(value)).astype(np.int64)
        return cls(value.astype(np.float64), steps, changes)

    @property
    def varies(self) -> bool:
        """Whether changes could depend on the covariate here."""
        return len(self.value) > 1 and 0 < self.changes.sum() < self.steps.sum()

    def drawn(self, rng: np.random.Generator, count: int) -> NDArray[np.int64]:
        """Changes distributed at random over the same steps, shape (count, G)."""
        total = int(self.changes.sum())
        return rng.multivariate_hypergeometric(self.steps, total, count, method="marginals")

    def apart(self, value: NDArray[np.float64]) -> NDArray[np.float64]:
        """A function of the covariate less its mean over all steps."""
        return value - (self.steps @ value) / self.steps.sum()

    def trend(self, value: NDArray[np.float64]) -> float:
        """Mean of a function of the covariate where d changed, less that over all steps."""
        return float(self.changes @ self.apart(value) / self.changes.sum())

    def scores(self, value: NDArray[np.float64], changes: NDArray[np.int64]) -> NDArray[np.float64]:
        """Score statistic of a quadratic dependence, shape (...); changes have shape (..., G)."""
        first = self.apart(value)
        second = self.apart(first**2)
        features = np.stack([first, second], axis=1)  # (G, 2)
        share = self.changes.sum() / self.steps.sum()
        spread = share * (1 - share) * (features * self.steps[:, None]).T @ features
        scores = changes @ features
        return np.einsum("...i,ij,...j->...", scores, np.linalg.pinv(spread), scores)


def check_assumptions(steps: ChainSteps, seed: int = 0) -> tuple[AssumptionTest, ...]:
    """Test the four assumptions on the steps of one person.

    Args:
        steps: of recorded trips.
        seed: of the draws.
    """
    rng = np.random.default_rng(seed)
    raw = [
        _dwell("dwell_attentive", steps, 0, rng),
        _dwell("dwell_away", steps, 1, rng),
        _constant_effect(steps, rng),
        _one_effect(ChainCounts.of(steps), rng),
    ]
    corrected = holm([test.p for test in raw])
    return tuple(
        AssumptionTest(test.name, p, test.trend) for test, p in zip(raw, corrected, strict=True)
    )


def dwell_rows(steps: ChainSteps, state: int) -> tuple[NDArray[np.float64], ...]:
    """Times in a state, and how many steps outside windows and changes there were at each.

    Returns:
        Times in steps, numbers of steps, numbers of changes; each of shape (G,).
    """
    rows = _dwell_rows(steps, state)
    return rows.value, rows.steps.astype(np.float64), rows.changes.astype(np.float64)


def effect_rows(steps: ChainSteps, state: int) -> tuple[NDArray[np.float64], ...]:
    """Steps since the alert, and how many steps and changes from a state there were at each."""
    rows = _effect_rows(steps, state)
    return rows.value, rows.steps.astype(np.float64), rows.changes.astype(np.float64)


def _dwell_rows(steps: ChainSteps, state: int) -> _Rows:
    where = (steps.before == state) & (steps.accepted == 0)
    return _Rows.of(steps.age[where], steps.changes[where])


def _effect_rows(steps: ChainSteps, state: int) -> _Rows:
    where = (steps.before == state) & (steps.accepted == 1)
    return _Rows.of(steps.counter[where], steps.changes[where])


def _dwell(name: str, steps: ChainSteps, state: int, rng: np.random.Generator) -> AssumptionTest:
    rows = _dwell_rows(steps, state)
    if not rows.varies:
        return AssumptionTest(name, None, None)
    value = np.log(rows.value)
    drawn = rows.scores(value, rows.drawn(rng, _DRAWS))
    p = _share_as_large(drawn, float(rows.scores(value, rows.changes)))
    return AssumptionTest(name, p, rows.trend(value))


def _constant_effect(steps: ChainSteps, rng: np.random.Generator) -> AssumptionTest:
    """Sum of both states' statistics; an effect grows where openings fall or closings rise."""
    found, drawn, trend = 0.0, np.zeros(_DRAWS), 0.0
    tested = False
    for state, sign in ((0, -1.0), (1, 1.0)):
        rows = _effect_rows(steps, state)
        if not rows.varies:
            continue
        tested = True
        found += float(rows.scores(rows.value, rows.changes))
        drawn += rows.scores(rows.value, rows.drawn(rng, _DRAWS))
        trend += sign * rows.trend(rows.value)
    if not tested:
        return AssumptionTest("constant_effect", None, None)
    return AssumptionTest("constant_effect", _share_as_large(drawn, found), trend)


def _one_effect(counts: ChainCounts, rng: np.random.Generator) -> AssumptionTest:
    """Likelihood ratio of four probabilities against three traits."""
    name = "one_effect"
    if min(float(counts.helped_attentive), float(counts.helped_away)) == 0:
        return AssumptionTest(name, None, None)
    likelihood = Likelihood.of(counts)
    eta, highest = likelihood.maximum()
    found = float(likelihood.saturated() - highest)
    states = {}
    for which in ("attentive", "away"):
        state = getattr(likelihood, which)
        p = float(state.best(eta)[0])
        states[which] = [
            (rng.binomial(int(n), min(1.0, max(0.0, share)), _ONE_ETA_DRAWS), n)
            for n, share in ((state.steps, p), (state.helped_steps, p - float(eta)))
        ]
    (k, n), (helped_k, helped_n) = states["attentive"]
    (stays, away), (helped_stays, helped_away) = states["away"]
    numbers = (
        *(k, n, helped_k, helped_n),
        *(away - stays, away, helped_away - helped_stays, helped_away),
    )
    drawn = Likelihood.of(
        ChainCounts(*(np.full(_ONE_ETA_DRAWS, each, np.float64) for each in numbers))
    )
    p = _share_as_large(drawn.saturated() - drawn.maximum()[1], found)
    return AssumptionTest(name, p, None)


def _share_as_large(drawn: NDArray[np.float64], found: float) -> float:
    """Monte Carlo p-value, which is never 0."""
    tolerance = 1e-6 * max(1.0, abs(found))  # draws that are the same but for rounding
    return float((1 + (drawn >= found - tolerance).sum()) / (1 + len(drawn)))


def holm(values: list[float | None]) -> list[float | None]:
    """Correct p-values for their number (Holm, 1979); None stays None and is not counted."""
    known = sorted((p, place) for place, p in enumerate(values) if p is not None)
    corrected: list[float | None] = [None] * len(values)
    largest = 0.0
    for rank, (p, place) in enumerate(known):
        largest = max(largest, min(1.0, p * (len(known) - rank)))
        corrected[place] = largest
    return corrected
