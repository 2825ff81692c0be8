"""Points of a run's learning curve: both seats' policies as they were after so many steps."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from hmi_marl.envs.config import AGENTS, DRIVER, VEHICLE_AI
from hmi_marl.training.runs.folder import read_curve

_BEFORE = {DRIVER: "random", VEHICLE_AI: "never"}
"""Policies of seats that have learned nothing yet."""


@dataclass(frozen=True)
class Point:
    """Policies of a run after so many environment steps."""

    steps: int
    driver: str
    """Place of the driver's policy, or a name of the catalogue."""
    hmi: str


def points_of(run: Path, count: int) -> list[Point]:
    """Return ``count`` points of a finished run at even distances, the last at its end.

    Each seat has its last snapshot up to that point. A seat that learns later has none before: no
    HMI, or a driver that acts at random.
    """
    total = int(read_curve(run)[-1]["steps"])
    saved = {
        seat: sorted(
            (int(card.parent.name), str(card.parent))
            for card in run.glob(f"snapshots/*/{seat}.json")
        )
        for seat in AGENTS
    }
    points = []
    for k in range(1, count):
        steps = round(total * k / count)
        seats = {
            seat: next((place for at, place in reversed(those) if at <= steps), _BEFORE[seat])
            for seat, those in saved.items()
        }
        points.append(Point(steps, seats[DRIVER], seats[VEHICLE_AI]))
    return [*points, Point(total, str(run), str(run))]
