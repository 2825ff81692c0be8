"""Verdicts: whether a statement holds, by the numbers of a run.

Every experiment judges its own results, and the reproduction judges the paper's claims, by the same
:class:`Verdict`. The thresholds are in :mod:`hmi_marl.experiments.criteria`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any


class Outcome(StrEnum):
    """Result of judging a statement."""

    SUPPORTED = "supported"
    PARTLY = "partly supported"
    NOT_SUPPORTED = "not supported"
    UNTESTABLE = "cannot be tested here"
    NOT_RUN = "not run"


@dataclass(frozen=True)
class Verdict:
    """A statement, whether it holds, and the numbers that decide it."""

    claim: str
    outcome: Outcome
    reason: str = ""
    """Numbers that decide it."""
    where: str = ""
    """Section of the paper that makes the claim; empty for a criterion of our own."""

    @classmethod
    def of_parts(
        cls, claim: str, held: Sequence[bool], reason: str = "", where: str = ""
    ) -> Verdict:
        """Judge a statement of several parts: supported if all hold, partly if some do."""
        outcome = Outcome.SUPPORTED if all(held) else Outcome.NOT_SUPPORTED
        if any(held) and not all(held):
            outcome = Outcome.PARTLY
        return cls(claim, outcome, reason, where)

    @property
    def holds(self) -> bool:
        """Whether all parts of it hold."""
        return self.outcome is Outcome.SUPPORTED

    def as_json(self) -> dict[str, Any]:
        """JSON content."""
        return vars(self) | {"outcome": str(self.outcome)}
