"""What to measure in a bench; apart from it, so that the command line need not import numba."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class BenchConfig:
    """What to measure."""

    teams: tuple[int, ...] = (1, 64, 1024, 4096)
    """Sizes of the batches."""
    threads: tuple[int, ...] = ()
    """Thread counts; one and all cores by default."""
    vehicles: int = 20
    """In every scene, besides the driver's car and the one on the ramp."""
    scaling: tuple[int, ...] = (5, 10, 20, 40)
    """Numbers of vehicles to show the growth of the cost with."""
    seconds: float = 1.0
    """For each measurement."""
    rounds: int = 3
    """Turns that everybody takes."""

    def check(self) -> None:
        """Raise ValueError where a number is not positive."""
        numbers = (*self.teams, *self.threads, self.vehicles, *self.scaling, self.seconds)
        if min(*numbers, self.rounds) <= 0 or not self.teams:
            raise ValueError("everything that a bench counts is positive")
