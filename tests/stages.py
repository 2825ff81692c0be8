"""An experiment for the tests, which takes its time in small steps."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from hmi_marl.experiments.experiment import Experiment, Place
from hmi_marl.files import write_bytes
from hmi_marl.reporting.blocks import Block, Table


@dataclass(frozen=True)
class Counting(Experiment[int]):
    """Learn to count, and go on where it was cut off."""

    name: str = "counting"  # type: ignore[misc]
    steps: int = 3
    pause: float = 0.0
    seed: int = 0
    title = "Counting <to some number>"
    paper = "The paper does not count."

    @classmethod
    def quick(cls) -> Counting:
        return cls(steps=1)

    def settings(self) -> dict[str, Any]:
        return {"steps": self.steps}

    def run(self, place: Place) -> int:
        learned = place.folder / "count.safetensors"
        with place.watch.timing("counting"):
            while (count := len(learned.read_bytes()) if learned.is_file() else 0) < self.steps:
                write_bytes(learned, bytes(count + 1))
                time.sleep(self.pause)
            time.sleep(self.pause)
        return count

    def numbers(self, results: int) -> dict[str, Any]:
        return {"count": results, "pair": (1, 2)}

    def blocks(self, results: int) -> Sequence[Block]:
        rows = ((self.name, str(results)),)
        return [Table("Counted", ("name", "count"), rows, sources=("/count",))]
