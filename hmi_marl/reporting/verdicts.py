"""Verdicts by rule: whether a statement holds, by the numbers of a run.

A verdict consists of **parts**. A part says on which side of a threshold one quantity lies, or
that it lies between two, and names the unit that was repeated, how often, and the test. One rule
decides:

- a part is *supported* if its whole interval lies on the claimed side, *not supported* if its whole
  interval lies on the other side, else *undetermined*. Where a statement is that there is a
  difference, one that is too small to matter counts as none (:attr:`Part.margin`);
- an exact value needs no interval; where there are fewer than two units there is none, and the part
  is undetermined;
- a verdict is supported if all its parts are, not supported if one of them is not, else
  undetermined. Without parts it is undetermined, for the reason that it gives.

Intervals allow for the number of parts that are judged together (:func:`judged_together`), by
Holm's method: those of the first round are of 1 - 5 % / m for m parts that are tested; where k
parts stay open, all are looked at again with 1 - 5 % / k, until no more are decided; parts that
are decided by their margin alone count as open. So in a report the chance of any false decision is
at most 5 %. The thresholds are in
:mod:`hmi_marl.experiments.criteria`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any, Literal

from hmi_marl.checks import shown
from hmi_marl.files import json_value
from hmi_marl.reporting.statistics import (
    CONFIDENCE,
    Estimate,
    cut,
    exp,
    interval_with_luck,
    wilson_interval,
)
from hmi_marl.typed_json import read_as

Test = Literal[
    "exact",
    "t",
    "t of shares",
    "t of values up to 1",
    "paired t",
    "paired t of logarithms",
    "Wilson",
]
EPISODES, SEEDS = "episodes", "training seeds"
"""Units that most parts are repeated over."""
_ENDS: Mapping[str, tuple[float, float]] = {
    "t of shares": (0.0, 1.0),
    "t of values up to 1": (-math.inf, 1.0),
}
"""Ends at which the intervals of these tests are cut off; the others have none."""
_FORM = re.compile(r"[+ -]?z?(\.\d{1,2})?[%efg]?")
_SHOWN = 6
"""Most parts that a verdict tells in one line."""


class Outcome(StrEnum):
    """Result of judging a statement."""

    SUPPORTED = "supported"
    NOT_SUPPORTED = "not supported"
    UNDETERMINED = "undetermined"


@dataclass(frozen=True)
class Part:
    """Statement that one quantity lies above, below or between thresholds."""

    what: str
    """Name of the quantity."""
    value: float | None
    """Estimate, or exact value; None where it is not known."""
    test: Test
    unit: str = ""
    """Unit of replication; empty for exact values."""
    count: int = 0
    """Number of units."""
    error: float | None = None
    """Standard error, of logarithms where these are tested; None for shares, exact values, and
    where it is not known."""
    luck: float = 0.0
    """Part of the standard error that all training seeds share: the luck of their episodes."""
    luck_count: int = 0
    """Units that ``luck`` is over."""
    above: float | None = None
    """Threshold that it lies above; None for none."""
    below: float | None = None
    """Threshold that it lies below; None for none."""
    margin: float = 0.0
    """Distance from the threshold, on the claimed side, up to which an interval that lies there or
    on the other side counts as no difference."""
    seeds: int = 0
    """Training seeds of what was learned; 0 if the quantity depends on nothing learned."""
    form: str = "z.4g"
    """Format in which it is shown."""

    def __post_init__(self) -> None:
        if not _FORM.fullmatch(self.form):
            raise ValueError(f"form is a format of numbers such as z.1f, not {shown(self.form)}")

    @classmethod
    def exact(cls, what: str, value: float, **more: Any) -> Part:
        """State something of an exact value."""
        return cls(what, float(value), "exact", **more)

    @classmethod
    def mean(
        cls, what: str, estimate: Estimate, unit: str, paired: bool = False, **more: Any
    ) -> Part:
        """State something of a mean, by Student's t; ``paired`` for a mean of differences."""
        error = None if math.isnan(estimate.error) else estimate.error
        test: Test = "paired t" if paired else "t"
        over = estimate.count, error, estimate.luck, estimate.luck_count
        return cls(what, _known(estimate.mean), test, unit, *over, **more)

    @classmethod
    def mean_share(cls, what: str, estimate: Estimate, unit: str, **more: Any) -> Part:
        """State something of a mean of shares, by Student's t; its interval ends at 0 and 1."""
        return replace(cls.mean(what, estimate, unit, **more), test="t of shares")

    @classmethod
    def mean_up_to_1(cls, what: str, estimate: Estimate, unit: str, **more: Any) -> Part:
        """State something of a mean of values of at most 1, where its interval ends too."""
        return replace(cls.mean(what, estimate, unit, **more), test="t of values up to 1")

    @classmethod
    def ratio(cls, what: str, estimate: Estimate, unit: str, **more: Any) -> Part:
        """State something of :func:`~hmi_marl.reporting.statistics.geometric_ratio` or the like."""
        found = cls.mean(what, estimate, unit, paired=True, **more)
        return replace(found, test="paired t of logarithms")

    @classmethod
    def share(cls, what: str, estimate: Estimate, unit: str, **more: Any) -> Part:
        """State something of a share of independent trials, by Wilson's score test."""
        return cls(what, _known(estimate.mean), "Wilson", unit, estimate.count, **more)

    @property
    def is_tested(self) -> bool:
        """Whether it has an interval, so that it counts among the parts that are tested."""
        if self.test == "exact" or self.value is None or self.count < 2:
            return False
        return self.test == "Wilson" or self.error is not None

    def interval(self, confidence: float = CONFIDENCE) -> tuple[float, float]:
        """Interval of the quantity; infinite where there is none."""
        if self.test == "exact" and self.value is not None:
            return self.value, self.value
        if not self.is_tested:
            return -math.inf, math.inf
        value, error = self.value or 0.0, self.error or 0.0
        if self.test == "Wilson":
            return wilson_interval(value, self.count, confidence)
        over = error, self.count, self.luck, self.luck_count
        if self.test == "paired t of logarithms":
            low, high = interval_with_luck(math.log(value), *over, confidence)
            return exp(low), exp(high)
        ends = _ENDS.get(self.test, (-math.inf, math.inf))
        return cut(*interval_with_luck(value, *over, confidence), *ends)

    def outcome(self, confidence: float = CONFIDENCE) -> Outcome:
        """Judge it by the rule of this module."""
        low, high = self.interval(confidence)
        above = -math.inf if self.above is None else self.above
        below = math.inf if self.below is None else self.below
        if low > above and high < below:
            return Outcome.SUPPORTED
        if high <= above + self.margin or low >= below - self.margin:
            return Outcome.NOT_SUPPORTED
        return Outcome.UNDETERMINED

    def shown(self, confidence: float = CONFIDENCE) -> str:
        """Write the quantity, its interval and the thresholds, without the outcome."""
        value = "unknown" if self.value is None else format(self.value, self.form)
        text = f"{self.what} {value}"
        if self.is_tested and self.error == 0.0:
            text += " every time"
        elif self.is_tested:
            low, high = (format(end, self.form) for end in self.interval(confidence))
            text += f" [{low}, {high}]"
        wanted = [
            f"{sign} {end:{self.form}}"
            for sign, end in ((">", self.above), ("<", self.below))
            if end is not None
        ]
        small = f"; up to {self.margin:{self.form}} counts as none" if self.margin else ""
        return f"{text} ({' and '.join(wanted)}{small}?)"

    def basis(self) -> str:
        """Write the unit, the number of units and the test."""
        if self.test == "exact":
            return "exact"
        lucky = f" and over what they share, {self.luck_count} units" if self.luck else ""
        return f"{self.test} over {self.count} {self.unit}{lucky}"


@dataclass(frozen=True)
class Correction:
    """Correction for the number of parts judged together, by Holm's method."""

    tested: int = 1
    """Parts that are tested."""
    open: int = 1
    """Parts by which 5 % are divided: those that stay open, at least 1."""

    @property
    def confidence(self) -> float:
        """Confidence of the intervals that decide."""
        return 1.0 - (1.0 - CONFIDENCE) / self.open

    @property
    def shown(self) -> str:
        """Text for a reader."""
        return f"Holm over {self.tested} parts: intervals of {100 * self.confidence:.6g} %"


@dataclass(frozen=True)
class Verdict:
    """A statement, the parts that decide it, and how many were judged together."""

    claim: str
    parts: tuple[Part, ...] = ()
    reason: str = ""
    """What to know beside the parts, or why there are none."""
    where: str = ""
    """Section of the paper that makes the claim; empty for a criterion of our own."""
    correction: Correction = Correction()

    @classmethod
    def from_json(cls, content: Mapping[str, Any]) -> Verdict:
        """Read what :meth:`as_json` wrote, or raise ``ValueError``."""
        derived = ("outcome", "basis", "summary", "outcomes", "intervals", "needs")
        return read_as(cls, {n: value for n, value in content.items() if n not in derived})

    @property
    def outcomes(self) -> tuple[Outcome, ...]:
        """Outcomes of the parts."""
        return tuple(part.outcome(self.correction.confidence) for part in self.parts)

    @property
    def outcome(self) -> Outcome:
        """Supported if all parts are, not supported if one is not, else undetermined."""
        found = self.outcomes
        if Outcome.NOT_SUPPORTED in found:
            return Outcome.NOT_SUPPORTED
        if not found or Outcome.UNDETERMINED in found:
            return Outcome.UNDETERMINED
        return Outcome.SUPPORTED

    @property
    def holds(self) -> bool:
        """Whether it is supported."""
        return self.outcome is Outcome.SUPPORTED

    @property
    def basis(self) -> str:
        """Unit, training seeds, test and correction."""
        if not self.parts:
            return ""
        listed = list(dict.fromkeys(part.basis() for part in self.parts))
        text = ", ".join(listed) if len(listed) <= 3 else f"{', '.join(listed[:2])}, and others"
        seeds = sorted({part.seeds for part in self.parts if part.seeds})
        if seeds:
            number = f"{seeds[0]}" if len(seeds) == 1 else f"{seeds[0]} to {seeds[-1]}"
            plural = "" if seeds == [1] else "s"
            text += f"; {number} training seed{plural}"
            if any(part.seeds and part.unit != SEEDS for part in self.parts):
                text += ": holds of the agents that were learned here"
        tested = any(part.is_tested for part in self.parts)
        return f"{text}; {self.correction.shown}" if tested else text

    @property
    def summary(self) -> str:
        """The parts in one line, those that are not supported first, and the reason."""
        confidence, outcomes = self.correction.confidence, self.outcomes
        listed = sorted(
            zip(outcomes, self.parts, strict=True),
            key=lambda pair: (Outcome.NOT_SUPPORTED, Outcome.UNDETERMINED, Outcome.SUPPORTED).index(
                pair[0]
            ),
        )
        shown = [part.shown(confidence) for _, part in listed[:_SHOWN]]
        if len(listed) > _SHOWN:
            good = outcomes.count(Outcome.SUPPORTED)
            shown.append(f"... {good} of {len(listed)} parts are supported")
        few = [part for part in self.parts if part.seeds == 1 and part.unit == SEEDS]
        alone = ["1 seed: undetermined for training"] if few else []
        return "; ".join([*shown, *alone, *([self.reason] if self.reason else [])])

    def as_json(self) -> dict[str, Any]:
        """JSON content, with what follows from the parts."""
        confidence = self.correction.confidence
        intervals = [list(part.interval(confidence)) for part in self.parts]
        return dict(json_value(self)) | {
            "outcome": str(self.outcome),
            "basis": self.basis,
            "summary": self.summary,
            "outcomes": [str(outcome) for outcome in self.outcomes],
            "intervals": json_value(intervals),
        }


def judged_together(verdicts: Iterable[Verdict]) -> list[Verdict]:
    """Correct verdicts for the number of their parts, all of them together, by Holm's method."""
    listed = list(verdicts)
    tested = [part for verdict in listed for part in verdict.parts if part.is_tested]
    remaining, before = len(tested), math.inf
    while remaining < before:
        before = remaining
        confidence = Correction(open=max(1, remaining)).confidence
        remaining = _open(tested, confidence)
    correction = Correction(len(tested), max(1, remaining))
    return [replace(verdict, correction=correction) for verdict in listed]


def _open(parts: Sequence[Part], confidence: float) -> int:
    """Count the parts that are on neither side of their thresholds.

    Margins do not count. Where there is no difference, most parts would be decided by them at once,
    and what chance has moved furthest would be left alone, to be judged as if it were the only one.
    """
    outcomes = (replace(part, margin=0.0).outcome(confidence) for part in parts)
    return sum(outcome is Outcome.UNDETERMINED for outcome in outcomes)


def _known(value: float) -> float | None:
    return value if math.isfinite(value) else None
