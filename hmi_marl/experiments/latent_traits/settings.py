"""Sizes of the evaluation of trait models; importable without what the evaluation needs."""

from __future__ import annotations

from dataclasses import dataclass

from hmi_marl.checks import check_count

MIN_UNSEEN_DRIVERS = 4
"""Least drivers to regress traits over: two fit the regression, and two judge it."""


@dataclass(frozen=True)
class AssessSettings:
    """Size of the evaluation of each model.

    Raises:
        ValueError: a size below its least.
    """

    windows: int = 800
    """Most windows of each driver, learned from or held out, that are encoded."""
    episodes: int = 200
    """Episodes that the policy drives with each driver's z."""
    ranked: int = 100
    """Held-out windows of each driver by which the recovered reward is judged."""
    seed: int = 1_000_000
    """Seed of those episodes and of all other draws."""

    def __post_init__(self) -> None:
        for name in ("windows", "episodes", "ranked"):
            check_count(name, getattr(self, name))
        if self.ranked < 2:
            raise ValueError("ranking takes two windows: ranked is at least 2, but got 1")
